"""Depth from the markers' motion alone, held against the twin's pad, which it was not fitted on."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.bench.states import FRESH, State, make_states
from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.marker_depth import MarkerDepth, fit_marker_depth
from ruffini.calibrate.operator import board_slab, make_operator, second_pass
from ruffini.errors import InputError
from ruffini.fem.operators import Noise

NOISE = Noise((5e-6, 5e-6, 20e-6))
STAGES = '["difference", "markers", "displacement", "operator", "support", "wrench", "contacts"]'


@pytest.fixture(scope="module")
def board() -> Board:
    text = find_board("gelslim").text
    text = text[: text.index("stages = ")] + f"stages = {STAGES}\n"
    return parse_board(text.replace("[depth]\n", '[depth]\nsource = "markers"\n'), "test")


@pytest.fixture(scope="module")
def depth(board: Board) -> MarkerDepth:
    return fit_marker_depth(board, board_slab(board), NOISE)


@pytest.fixture(scope="module")
def states(board: Board) -> list[State]:
    return make_states(find_board("gelslim"), FRESH, (0.4, 0.8))


def found(depth: MarkerDepth, state: State, rng: np.random.Generator) -> np.ndarray:
    white = rng.normal(size=depth.view.marker_m.shape) * NOISE.sigma_m[:2]
    return depth.displacement(depth.view.seen(state.displacement[None], white)[0])


def test_it_is_off_by_what_it_says(board: Board, depth: MarkerDepth, states: list[State]) -> None:
    rng, threshold_n = np.random.default_rng(1), board.contact.threshold_un * 1e-6
    off, mean, deep, sideways, flat = [], [], [], [], []
    for state in states:
        u, pressed = found(depth, state, rng), state.force[..., 2] < -threshold_n
        error = u - state.displacement
        off.append(error[..., 2][pressed])
        deep.append(state.displacement[..., 2][pressed])
        mean.append(error[..., 2].mean())
        sideways.append(error[..., :2][pressed])
        seen = depth.view.seen(state.displacement[None])[0]
        flat.append((seen - state.displacement[..., :2])[pressed])
    rms = [float(np.sqrt(np.mean(np.square(np.concatenate(v))))) for v in (off, deep, sideways, flat)]
    assert 0.6 < rms[0] / depth.sigma_m < 1.5, (rms[0], depth.sigma_m)
    assert 0.3 < np.sqrt(np.mean(np.square(mean))) / depth.gauge_m < 2.0
    assert rms[0] < 0.6 * rms[1], rms  # about half of the depth is told; see the README
    assert rms[2] < 0.6 * rms[3], rms  # and so is most of what perspective hides of the sideways motion


def test_force_is_told_within_what_a_spread_of_touches_leaves(board: Board, states: list[State]) -> None:
    kind = make_operator(board, method="support", noise=NOISE)
    assert kind.support is not None
    assert kind.marker_depth is not None
    estimate, rng = second_pass(board, kind.matrix, kind.support), np.random.default_rng(2)
    ratio = []
    for state in states:
        force, _ = estimate(found(kind.marker_depth, state, rng))
        ratio.append(force[..., 2].sum() / state.force[..., 2].sum())
    assert 0.8 < np.mean(ratio) < 1.2, ratio
    assert 0.05 < np.std(ratio) < 0.35, ratio


def test_untouched_is_untouched(depth: MarkerDepth) -> None:
    rng = np.random.default_rng(3)
    nothing = np.zeros((1, *depth.view.place_m.shape[:2], 3))
    white = rng.normal(size=depth.view.marker_m.shape) * NOISE.sigma_m[:2]
    u = depth.displacement(depth.view.seen(nothing, white)[0])
    assert np.sqrt(np.mean(u[..., 2] ** 2)) < 0.3 * depth.sigma_m


def test_scattered_markers_are_refused() -> None:
    text = find_board("gelslim").text.replace("[markers]\n", '[markers]\nlayout = "scattered"\n')
    board = parse_board(text, "test")
    with pytest.raises(InputError, match="scattered"):
        fit_marker_depth(board, board_slab(board), NOISE)
