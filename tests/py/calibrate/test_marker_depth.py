"""Depth from the markers' motion alone, held against the twin's pad, which it was not fitted on."""

from __future__ import annotations

import numpy as np
import pytest
from kept import kept
from test_gauge import smaller_gelslim

from ruffini.bench.states import FRESH, State, make_states
from ruffini.boards import Board, find_board, parse_board
from ruffini.errors import InputError
from ruffini.estimators.operator.fit import OperatorKind, board_slab, make_operator, second_pass
from ruffini.estimators.operator.marker_depth import MarkerDepth, fit_marker_depth
from ruffini.fem.operators import Noise

NOISE = Noise((5e-6, 5e-6, 20e-6))
N_ERROR_TOUCHES = 120
STAGES = '["difference", "markers", "displacement", "operator", "support", "wrench", "contacts"]'


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Board:
    return smaller_gelslim(tmp_path_factory.mktemp("boards"))


@pytest.fixture(scope="module")
def board(lit: Board) -> Board:
    text = lit.text
    text = text[: text.index("stages = ")] + f"stages = {STAGES}\n"
    return parse_board(text.replace("[depth]\n", '[depth]\nsource = "markers"\n'), "test")


@pytest.fixture(scope="module")
def kind(board: Board) -> OperatorKind:
    return kept(make_operator, board, method="support", noise=NOISE, n_touches=N_ERROR_TOUCHES)


@pytest.fixture(scope="module")
def depth(kind: OperatorKind) -> MarkerDepth:
    assert kind.marker_depth is not None
    return kind.marker_depth


@pytest.fixture(scope="module")
def states(lit: Board) -> list[State]:
    return kept(make_states, lit, FRESH, (0.4, 0.8))


def test_it_is_off_by_what_it_says(board: Board, depth: MarkerDepth, states: list[State]) -> None:
    rng, threshold_n = np.random.default_rng(1), board.contact.threshold_un * 1e-6
    off, mean, deep, sideways, flat = [], [], [], [], []
    for state in states:
        u, pressed = depth.observe(state.displacement, rng), state.force[..., 2] < -threshold_n
        error = u - state.displacement
        off.append(error[..., 2][pressed])
        deep.append(state.displacement[..., 2][pressed])
        mean.append(error[..., 2].mean())
        sideways.append(error[..., :2][pressed])
        seen = depth.view.seen(state.displacement[None])[0]
        flat.append((seen - state.displacement[..., :2])[pressed])
    over = np.abs(np.concatenate(off)) / depth.sigma_m
    rms = [float(np.sqrt(np.mean(np.square(np.concatenate(v))))) for v in (off, deep, sideways, flat)]
    assert 0.7 < rms[0] / depth.sigma_m < 1.15, (rms[0], depth.sigma_m)
    assert 0.6 < np.mean(over < 1) < 0.85, over
    assert np.mean(over < 2) > 0.9, over
    assert 0.3 < np.sqrt(np.mean(np.square(mean))) / depth.gauge_m < 2.0
    assert rms[0] < 0.6 * rms[1], rms  # about half of the depth is told; see the README
    assert rms[2] < 0.6 * rms[3], rms  # and so is most of what perspective hides of the sideways motion


def test_force_is_told_within_what_a_spread_of_touches_leaves(
    board: Board, kind: OperatorKind, states: list[State]
) -> None:
    assert kind.support is not None
    assert kind.marker_depth is not None
    assert kind.errors is not None
    estimate, rng = second_pass(board, kind.matrix, kind.support), np.random.default_rng(2)
    stated, ratio, over_stated = kind.errors.wrench, [], []
    for state in states:
        force, _ = estimate(kind.marker_depth.observe(state.displacement, rng))
        found, true = force[..., 2].sum(), state.force[..., 2].sum()
        ratio.append(found / true)
        if len(state.recipe.touches) == 1:
            over_stated.append((found - true) / np.hypot(stated.force_n[1], stated.factor[1] * found))
    assert 0.8 < np.mean(ratio) < 1.2, ratio
    assert 0.05 < np.std(ratio) < 0.35, ratio
    assert 0.5 < np.sqrt(np.mean(np.square(over_stated))) < 1.6, over_stated


def test_untouched_is_untouched(depth: MarkerDepth) -> None:
    rng = np.random.default_rng(3)
    u = depth.observe(np.zeros((*depth.view.place_m.shape[:2], 3)), rng)
    assert np.sqrt(np.mean(u[..., 2] ** 2)) < 0.3 * depth.sigma_m


def test_scattered_markers_are_refused() -> None:
    text = find_board("gelslim").text.replace("[markers]\n", '[markers]\nlayout = "scattered"\n')
    board = parse_board(text, "test")
    with pytest.raises(InputError, match="scattered"):
        fit_marker_depth(board, board_slab(board), NOISE)
