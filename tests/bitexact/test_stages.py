"""Each stage of the core against the numpy mirror, bit for bit, on random, rendered and extreme inputs."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
import numpy.typing as npt
import pytest
from core_stages import CoreStages
from marker_twins import NOTHING, MarkerTwins
from mirror.board import Board, center_q16, depth_grid, observed_nodes
from mirror.displacement import displacement, filled
from mirror.dot_templates import DotTemplates
from mirror.dots import detect_dots
from mirror.fixed import Saturations
from mirror.light import difference, grey, reciprocal, rest_image, without_ambient
from mirror.markers import ABSENT, DX, DY, LOST, Lattice
from mirror.photometric import Bend, cell_depth, cell_slope, marker_mask, unmix_of_cells
from mirror.poisson import cos_pi_q30, poisson
from odd_boards import board_text, small_board

from ruffini.bench.markers import fill_lost
from ruffini.boards import parse_board
from ruffini.estimators.operator.marker_lattice import NodesOnLattice

OpenStages = Callable[[str], tuple[CoreStages, Board]]

SIZES = [
    small_board(),
    small_board(width=63, height=41, step=1, gauge="mean"),
    small_board(width=64, height=44, step=4, polarity="light"),
]


def frame_shape(board: Board) -> tuple[int, int, int]:
    return board["camera"]["height_px"], board["camera"]["width_px"], 3


def render(
    board: Board, rng: np.random.Generator, moved_px: float, hidden: Collection[int] = ()
) -> npt.NDArray[np.uint8]:
    """A noisy frame with the board's dots but the hidden ones, each moved by up to `moved_px` along each axis."""
    height, width, _ = frame_shape(board)
    camera, m = board["camera"], board["markers"]
    y, x = np.mgrid[:height, :width]
    px_per_um = camera["focal_mpx"] / 1000 / camera["standoff_um"]
    level = 130.0 + 30 * x / width - 20 * y / height
    depth = -80 if m["polarity"] == "dark" else 80
    radius = m["diameter_um"] / 2 * px_per_um
    for j in range(m["n_y"]):
        for i in range(m["n_x"]):
            place = [
                center_q16(board, a) / 65536
                + (m[f"first_{a}_um"] + n * m[f"pitch_{a}_um"] - board["pad"][f"size_{a}_um"] / 2) * px_per_um
                + rng.uniform(-moved_px, moved_px)
                for a, n in (("x", i), ("y", j))
            ]
            if j * m["n_x"] + i in hidden:
                continue
            distance = np.hypot(x - place[0], y - place[1])
            level = level + depth * np.clip(radius + 0.5 - distance, 0, 1)
    noisy = level[..., None] + rng.normal(0, 2, frame_shape(board))
    return np.asarray(np.clip(np.round(noisy), 0, 255), np.uint8)


def random_frame(board: Board, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    return rng.integers(0, 256, frame_shape(board), dtype=np.uint8)


def test_cosines_are_the_nearest_integers(open_stages: OpenStages) -> None:
    core, _ = open_stages(SIZES[0])
    for denominator in (1, 2, 3, 4, 5, 160, 320, 631, 1280):
        numerators = np.arange(-7, 4 * denominator + 9, dtype=np.int64)
        expected = cos_pi_q30(numerators, denominator)
        assert [core.cos_pi_q30(int(n), denominator) for n in numerators] == expected.tolist()


def test_without_ambient(open_stages: OpenStages) -> None:
    core, _ = open_stages(SIZES[0])
    every = np.arange(256, dtype=np.uint8)
    lit, dark = np.repeat(every, 256), np.tile(every, 256)  # each value with each
    assert np.array_equal(core.without_ambient(lit, dark), without_ambient(lit, dark))
    for n in (1, 15, 16, 17, 63):  # round the widths of vectors
        assert np.array_equal(core.without_ambient(lit[-n:], dark[-n:]), without_ambient(lit[-n:], dark[-n:]))


@pytest.mark.parametrize("text", SIZES)
def test_rest_and_difference(open_stages: OpenStages, text: str) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(1)
    frames = np.stack([random_frame(board, rng) // 2 for _ in range(5)])
    frames[:, :4] = 0  # rest black: the reciprocal's floor
    rest, reciprocal_q24 = core.rest(frames)
    assert np.array_equal(rest, rest_image(frames))
    assert np.array_equal(reciprocal_q24, reciprocal(rest_image(frames)))
    frame = random_frame(board, rng)
    frame[:9] = 255
    frame[9:14] = 3
    change, grey_levels, counts = core.difference(frame)
    mirrored = rest_image(frames)
    expected, expected_counts = difference(frame, mirrored, reciprocal(mirrored))
    assert np.array_equal(change, expected)
    assert np.array_equal(grey_levels, grey(frame))
    assert counts == expected_counts


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim")])
def test_dots(open_stages: OpenStages, text: str) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(2)
    picture = grey(render(board, rng, 1.0))
    dots = core.dots(picture.astype(np.uint16))
    assert len(dots) > board["markers"]["n_x"]
    assert np.array_equal(dots, detect_dots(board, picture))
    noise = grey(random_frame(board, rng))
    assert np.array_equal(core.dots(noise.astype(np.uint16)), detect_dots(board, noise))


@pytest.mark.parametrize("text", [SIZES[0], SIZES[2], board_text("gelslim")])
def test_markers_over_a_sequence_with_losses_and_dust(open_stages: OpenStages, text: str) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(3)
    lattice = Lattice(board)
    place = lattice.nominal + rng.integers(-90_000, 90_000, lattice.nominal.shape) + np.array([130_000, -70_000])
    twins = MarkerTwins(core, lattice, place, 4, rng)
    twins.learn(twins.dots(0, 0.96))
    speed = rng.integers(-120_000, 120_000, 2)
    for t in range(1, 12):
        twins.follow(twins.dots(t * speed, 0.8))
    twins.follow_jumps(12, int(np.abs(np.diff(lattice.nominal[:2, 0]))[0]))
    twins.follow(NOTHING)


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim"), board_text("gelsight-mini")])
def test_printed_markers_by_all_their_ink(open_stages: OpenStages, text: str) -> None:
    """A still picture, then one whose dots moved, with other light, a few of them gone and noise over all."""
    core, board = open_stages(text)
    rng = np.random.default_rng(12)
    still = render(board, rng, 0.3)
    grey_still, rest = grey(still), still.astype(np.uint16) * 16
    moved = np.clip(render(board, rng, 1.2, hidden={3, 7}) * rng.uniform(0.8, 1.1, 3), 0, 255).astype(np.uint8)
    lattice = Lattice(board)
    lattice.learn(detect_dots(board, grey_still))
    templates = DotTemplates(board, rest.astype(np.int64), lattice.rows)
    assert templates.templates
    for frame in (still, moved, random_frame(board, rng)):
        lattice.rows[:, [DX, DY]] = 0
        lattice.assign(detect_dots(board, grey(frame)))
        before = lattice.rows[:, [DX, DY]].copy()
        error2 = templates.refine(frame, lattice.rows)
        is_refined = (before != lattice.rows[:, [DX, DY]]).any()
        n_lost = lattice.finish(error2)
        rows, quality, lost = core.printed(
            (grey_still.astype(np.uint16), rest), (grey(frame).astype(np.uint16), frame), len(lattice.rows)
        )
        assert np.array_equal(rows, lattice.rows)
        assert np.array_equal(quality, lattice.quality)
        assert lost == n_lost
        assert is_refined or frame is not moved


def test_a_rest_image_without_dots(open_stages: OpenStages) -> None:
    core, board = open_stages(SIZES[0])
    lattice = Lattice(board)
    nothing = np.zeros((0, 3), np.int32)
    rows, n_found = core.learn_markers(nothing, len(lattice.rows))
    assert n_found == lattice.learn(nothing) == 0
    assert np.array_equal(rows, lattice.rows)
    assert rows[:, ABSENT].all()


def random_markers(board: Board, rng: np.random.Generator, moved_q16: int) -> npt.NDArray[np.int32]:
    rows = Lattice(board).rows
    rows[:, :2] = Lattice(board).nominal
    rows[:, [DX, DY]] = rng.integers(-moved_q16, moved_q16 + 1, (len(rows), 2))
    return rows.astype(np.int32)


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim")])
@pytest.mark.parametrize("limit", [500, 32767])
def test_photometric(open_stages: OpenStages, text: str, limit: int) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(4)
    height, width, _ = frame_shape(board)
    unmix = rng.integers(-limit, limit + 1, (5, 7, 2, 3)).astype(np.int16)
    table = rng.integers(-32768, 32768, (65, 65, 2)).astype(np.int16)
    change = rng.integers(-32768, 32768, (height, width, 3)).astype(np.int16)
    markers = random_markers(board, rng, 200_000)
    core.set_photometric(unmix, table)
    mask = marker_mask(board, markers)
    assert 0 < mask.mean() < 1
    expected = cell_slope(board, change.astype(np.int64), mask, unmix_of_cells(board, unmix), table)
    assert np.array_equal(core.photometric(change, markers, depth_grid(board)), expected)


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim")])
@pytest.mark.parametrize("shift", [6, 9, 11])
@pytest.mark.parametrize("limit", [500, 32767])
def test_photometric_with_bend_under_another_light(open_stages: OpenStages, text: str, shift: int, limit: int) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(shift)
    height, width, _ = frame_shape(board)
    unmix = rng.integers(-limit, limit + 1, (4, 3, 2, 3)).astype(np.int16)
    table = rng.integers(-32768, 32768, (65, 65, 2)).astype(np.int16)
    bend = Bend(
        rng.integers(-limit - 1, limit + 1, (9, 9, 9, 2)).astype(np.int16),
        np.array([rng.integers(-4000, 200, 3), [shift, 12 - shift // 2, 8]], np.int32),
    )
    change = np.clip(rng.normal(0, 900, (height, width, 3)), -32768, 32767).astype(np.int16)
    change[:4] = rng.integers(-32768, 32768, (4, width, 3))
    level = np.array([-16384, 16384, rng.integers(-3000, 3000)], np.int32)
    markers = random_markers(board, rng, 200_000)
    core.set_photometric(unmix, table, bend.lattice, bend.axis)
    mask = marker_mask(board, markers)
    expected = cell_slope(
        board, change.astype(np.int64), mask, unmix_of_cells(board, unmix), table, bend, level.astype(np.int64)
    )
    assert np.array_equal(core.photometric(change, markers, depth_grid(board), level), expected)


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim")])
def test_depth_of_a_skin_that_darkens(open_stages: OpenStages, text: str) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(6)
    height, width, _ = frame_shape(board)
    table = rng.integers(-32768, 32768, 257).astype(np.int16)
    change = np.clip(rng.normal(0, 3000, (height, width, 3)), -32768, 32767).astype(np.int16)
    level = np.array([-16384, 16384, 1234], np.int32)
    expected = cell_depth(board, change.astype(np.int64), table, level.astype(np.int64))
    assert np.array_equal(core.intensity(table, change, depth_grid(board), level), expected)


def test_photometric_with_every_pixel_masked(open_stages: OpenStages) -> None:
    text = small_board().replace("diameter_um = 301", "diameter_um = 730")
    core, board = open_stages(text)
    rng = np.random.default_rng(5)
    height, width, _ = frame_shape(board)
    core.set_photometric(
        rng.integers(-4096, 4096, (2, 2, 2, 3)).astype(np.int16),
        rng.integers(-4096, 4096, (65, 65, 2)).astype(np.int16),
    )
    # 15 rest places over the upper half, moved to the lower half: 30 discs of 11 px radius.
    markers = random_markers(board, rng, 0)
    markers[:, 0] = (np.tile(np.arange(5), 3) * 15 + 3) << 16
    markers[:, 1] = (np.repeat(np.arange(3), 5) * 8 + 2) << 16
    markers[:, DY] = 20 << 16
    change = rng.integers(-4096, 4096, (height, width, 3)).astype(np.int16)
    assert marker_mask(board, markers).all()
    assert not core.photometric(change, markers, depth_grid(board)).any()


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim")])
@pytest.mark.parametrize("limit", [300, 4096, 32767])
def test_poisson(open_stages: OpenStages, text: str, limit: int) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(limit)
    slope = rng.integers(-limit - 1, limit + 1, (*depth_grid(board), 2)).astype(np.int16)
    depth, n_saturated = core.poisson(slope)
    saturations = Saturations()
    assert np.array_equal(depth, poisson(board, slope.astype(np.int64), saturations))
    assert n_saturated == saturations.count


@pytest.mark.parametrize("sign", [-1, 1])
def test_poisson_of_one_steep_plane_saturates_alike(open_stages: OpenStages, sign: int) -> None:
    core, board = open_stages(board_text("gelslim"))
    slope = np.full((*depth_grid(board), 2), sign * 32767, np.int16)
    depth, n_saturated = core.poisson(slope)
    saturations = Saturations()
    assert np.array_equal(depth, poisson(board, slope.astype(np.int64), saturations))
    assert n_saturated == saturations.count > 0


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim"), board_text("gelsight-mini")])
@pytest.mark.parametrize("has_depth", [False, True])
@pytest.mark.parametrize("moved_q16", [150_000, 40_000_000])
def test_displacement(open_stages: OpenStages, text: str, has_depth: bool, moved_q16: int) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(6)
    markers = random_markers(board, rng, moved_q16)
    nodes = (len(observed_nodes(board, "y")), len(observed_nodes(board, "x")))
    deepest = board["pad"]["thickness_um"] * 4
    depth = rng.integers(-deepest, deepest, depth_grid(board)).astype(np.int16)
    saturations = Saturations()
    expected = displacement(board, markers, depth.astype(np.int64) if has_depth else None, saturations)
    out, n_saturated = core.displacement(markers, depth if has_depth else None, nodes)
    assert np.array_equal(out, expected)
    assert n_saturated == saturations.count


@pytest.mark.parametrize("n_wrong", [0, 3, 9, 30])
@pytest.mark.parametrize("n_lost", [0, 12, 90])
def test_displacement_with_wrong_and_lost_markers(open_stages: OpenStages, n_wrong: int, n_lost: int) -> None:
    """A smooth field in which some markers are off by 0.2 mm: the mirror's integers, and they are found."""
    core, board = open_stages(board_text("gelslim"))
    rng = np.random.default_rng(100 * n_wrong + n_lost)
    markers = random_markers(board, rng, 0)
    markers[:, [LOST, ABSENT]] = 0
    y, x = np.mgrid[-1:1:15j, -1:1:19j]
    smooth = 100_000 * np.stack([np.sin(3 * x + y), np.cos(2 * y - x)], axis=-1).reshape(-1, 2)
    markers[:, [DX, DY]] = np.round(smooth + rng.normal(size=smooth.shape) * 3_000)
    wrong, lost = np.split(rng.permutation(len(markers))[: n_wrong + n_lost], [n_wrong])
    markers[wrong, DX] += rng.choice([-1, 1], n_wrong).astype(np.int32) * 196_608  # 3 px, 0.2 mm
    markers[lost, DX] += 400_000
    markers[lost, LOST] = 1
    nodes = (board["grid"]["n_y"], board["grid"]["n_x"])
    out, _ = core.displacement(markers, None, nodes)
    assert np.array_equal(out, displacement(board, markers, None, Saturations()))
    if n_wrong <= 9 and n_lost <= 12:
        right = markers.copy()
        right[:, [DX, DY]] = np.round(smooth)
        inside = (slice(4, -4), slice(4, -4))
        apart = np.abs(out - core.displacement(right, None, nodes)[0])[inside][..., :2] / 8
        assert apart.max() < 60, apart.max()  # of 200 um; noise 3 um


@pytest.mark.parametrize("text", [*SIZES, board_text("gelslim"), board_text("gelsight-mini")])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 1.0])
def test_nodes_that_rest_on_lost_markers(open_stages: OpenStages, text: str, share: float) -> None:
    core, board = open_stages(text)
    rng = np.random.default_rng(8)
    markers = random_markers(board, rng, 150_000)
    markers[:, LOST] = rng.permutation(len(markers)) < share * len(markers)
    nodes = (len(observed_nodes(board, "y")), len(observed_nodes(board, "x")))
    out = core.filled(markers, nodes)
    assert np.array_equal(out, filled(board, markers))
    assert out.all() if share == 1 else (out.any() == (share > 0) and not out.all())


def test_the_benchmarks_float_twin_fills_and_interpolates_like_the_core(open_stages: OpenStages) -> None:
    core, board = open_stages(board_text("gelslim"))
    typed = parse_board(board_text("gelslim").encode(), "gelslim")
    assert typed.markers is not None
    m = board["markers"]
    rng = np.random.default_rng(12)
    n = m["n_x"] * m["n_y"]
    rest = Lattice(board).nominal
    moved = rng.integers(-40_000, 40_000, (n, 2))
    is_lost = rng.permutation(n) < n // 4
    dots = np.hstack([rest, np.full((n, 1), 30)]).astype(np.int32)
    assert core.learn_markers(dots, n)[1] == n
    dots[:, :2] += moved.astype(np.int32)
    rows, n_lost = core.track_markers(dots[~is_lost], np.zeros(n, np.int64))
    assert n_lost == is_lost.sum()
    out, _ = core.displacement(rows, None, (board["grid"]["n_y"], board["grid"]["n_x"]))
    um_per_px = board["camera"]["standoff_um"] / (board["camera"]["focal_mpx"] / 1000)
    u = fill_lost(moved.reshape(m["n_y"], m["n_x"], 2) / 65536 * um_per_px, is_lost.reshape(m["n_y"], m["n_x"]))
    expected = NodesOnLattice(typed, typed.markers).interpolate(u)
    np.testing.assert_allclose(out[..., :2] / 8, expected, atol=0.3)  # of 150 um
