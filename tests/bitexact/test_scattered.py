"""Scattered markers, listed and learned, against the numpy mirror: identity over a sequence, and nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from core_stages import CoreStages
from marker_twins import NOTHING, MarkerTwins
from mirror.board import Board, depth_grid, length_q16
from mirror.displacement import displacement, filled
from mirror.fixed import Saturations
from mirror.markers import ABSENT, DX, DY, LOST, Lattice
from odd_boards import board_text, small_board

OpenStages = Callable[[str], tuple[CoreStages, Board]]
Places = npt.NDArray[np.int64]


def scattered(text: str, rng: np.random.Generator, *, is_listed: bool) -> tuple[str, int]:
    """The board with as many markers anywhere on its pad, no two nearer than 0.6 pitch."""
    size = [int(text.split(f"size_{a}_um = ")[1].split()[0]) for a in "xy"]
    n_x, n_y = (int(text.split("[markers]")[1].split(f"{a} = ")[1].split()[0]) for a in ("n_x", "n_y"))
    pitch = int(text.split("pitch_x_um = ")[1].split()[0])
    places: list[list[int]] = []
    while len(places) < n_x * n_y:
        at = rng.integers(0, size).tolist()
        if all(np.hypot(at[0] - x, at[1] - y) > 0.6 * pitch for x, y in places):
            places.append(at)
    listed = f"\nplaces_um = {places}" if is_listed else ""
    return text.replace('polarity = "dark"', f'polarity = "dark"\nlayout = "scattered"{listed}'), n_x * n_y


BOARDS = [small_board(), board_text("gelslim")]


@pytest.mark.parametrize("is_listed", [True, False])
@pytest.mark.parametrize("text", BOARDS)
def test_markers_over_a_sequence_with_losses_and_dust(open_stages: OpenStages, text: str, is_listed: bool) -> None:
    rng = np.random.default_rng(11)
    text, n = scattered(text, rng, is_listed=is_listed)
    core, board = open_stages(text)
    lattice = Lattice(board)
    pitch = length_q16(board, board["markers"]["pitch_x_um"])
    view = np.array([board["camera"]["width_px"], board["camera"]["height_px"]]) << 16
    place = lattice.nominal + rng.integers(-pitch // 5, pitch // 5, 2)
    if not is_listed:
        place = rng.integers(0, view, (n, 2))
    twins = MarkerTwins(core, lattice, place, 3, rng)
    assert n // 2 < twins.learn(twins.dots(0, 0.9))
    twins.follow_jumps(8, pitch)
    twins.follow(NOTHING)
    assert twins.learn(NOTHING) == 0


@pytest.mark.parametrize("n_there", [0, 1, 2, 3, 9, 15])
def test_nodes_among_few_markers(open_stages: OpenStages, n_there: int) -> None:
    rng = np.random.default_rng(n_there)
    text, n = scattered(small_board(), rng, is_listed=True)
    core, board = open_stages(text)
    rows = Lattice(board).rows
    rows[:, :2] = Lattice(board).nominal + rng.integers(-200_000, 200_000, (n, 2))
    rows[:, [DX, DY]] = rng.integers(-300_000, 300_000, (n, 2))
    rows[:, ABSENT] = rows[:, LOST] = rng.permutation(n) >= n_there
    _compare(core, board, rows.astype(np.int32), rng)


def test_nodes_among_many_markers(open_stages: OpenStages) -> None:
    rng = np.random.default_rng(5)
    text, n = scattered(board_text("gelslim"), rng, is_listed=True)
    core, board = open_stages(text)
    rows = Lattice(board).rows
    rows[:, :2] = Lattice(board).nominal
    rows[:, [DX, DY]] = rng.integers(-300_000, 300_000, (n, 2))
    rows[:, ABSENT] = 0
    rows[:, LOST] = rng.random(n) < 0.3
    _compare(core, board, rows.astype(np.int32), rng)


def test_nodes_where_all_markers_stand_in_a_row(open_stages: OpenStages) -> None:
    """Nothing tells the slope across the row: it is taken as zero, and no weight runs away."""
    rng = np.random.default_rng(6)
    text, n = scattered(small_board(), rng, is_listed=True)
    core, board = open_stages(text)
    rows = Lattice(board).rows
    rows[:, 0], rows[:, 1] = np.linspace(5, 60, n) * 65536, 20 << 16
    rows[:, [LOST, ABSENT]] = 0
    rows[:, DX], rows[:, DY] = 3 << 16, rng.integers(-65536, 65536, n)
    nodes = _compare(core, board, rows.astype(np.int32), rng)
    um_per_px = board["camera"]["standoff_um"] / (board["camera"]["focal_mpx"] / 1000)
    np.testing.assert_allclose(nodes[..., 0] / 8, 3 * um_per_px, atol=1)
    assert np.abs(nodes[..., 1] / 8).max() < 8 * um_per_px


def _compare(
    core: CoreStages, board: Board, rows: npt.NDArray[np.int32], rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Displacement with and without depth, and what is filled; the displacement without."""
    shape = filled(board, rows).shape
    assert np.array_equal(core.filled(rows, shape), filled(board, rows))
    depth = rng.integers(-8_000, 8_000, depth_grid(board)).astype(np.int64)
    for z in (depth, None):
        saturations = Saturations()
        out, n_saturated = core.displacement(rows, None if z is None else z.astype(np.int16), shape)
        assert np.array_equal(out, displacement(board, rows, z, saturations))
        assert n_saturated == saturations.count
    return np.asarray(out, np.int64)
