"""The stage of a glowing skin against the mirror, bit for bit, and what it flags."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import Board, read_board
from mirror.fixed import Saturations
from mirror.skin import Taxels, TaxelTouches, base_of, glow_of, image_force, smoothed
from odd_boards import small_board

from ruffini.boards import parse_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError

Picture = npt.NDArray[np.uint8]
WIDTH, HEIGHT, N_X, N_Y = 150, 70, 8, 5
PITCH_UM = 500  # 8 of them go round the board's pad of 4 mm
DARK, LIGHT = 64, 1024
VALID, INVALID, NOT_MEASURED = 1, 3, 0
N_REST = 3


def skin_text(shape: str = "tube", mode: str = "auto") -> str:
    text = small_board(width=WIDTH, height=HEIGHT, step=1)
    radius = 0 if shape == "plane" else 637
    section = (
        f'[skin]\nshape = "{shape}"\nradius_um = {radius}\nn_panels = 1\nmode = "{mode}"\nweight_b = 1\nweight_g = 2\n'
        "weight_r = 0\nlevel = 40\nmin_area_px = 20\naveraged_frames = 1\n\n"
    )
    return text[: text.index("[pipeline]")] + section + '[pipeline]\nn_rest_frames = 3\nstages = ["skin"]\n'


def openings() -> npt.NDArray[np.int64]:
    """Number of each pixel's opening, n of patch pixels, -1 elsewhere."""
    number = np.full((HEIGHT, WIDTH), -1)
    for row in range(N_Y):
        for column in range(N_X):
            number[4 + 12 * row : 11 + 12 * row, 14 + 16 * column : 24 + 16 * column] = row * N_X + column
    number[:, :10] = N_X * N_Y
    return number


def runs() -> npt.NDArray[np.int32]:
    return runs_of(openings())


def runs_of(number: npt.NDArray[np.int64]) -> npt.NDArray[np.int32]:
    """Runs of pixels with the same number, row by row; none where it is -1."""
    flat, rows = number.ravel(), []
    starts = np.flatnonzero(np.append(True, flat[1:] != flat[:-1]))
    for start, end in zip(starts, np.append(starts[1:], flat.size), strict=True):
        if flat[start] >= 0:
            rows.append((start, end - start, flat[start]))
    return np.array(rows, np.int32)


def calibration(board: Board, text: str, rng: np.random.Generator) -> CalibrationFile:
    n, table = N_X * N_Y, np.arange(577) * 64 / 4096 - 1
    u = np.log1p(np.maximum(table, -0.95))
    x, y = (np.arange(k) - (k - 1) / 2 for k in (N_X, N_Y))
    place = np.stack(np.meshgrid(x * PITCH_UM, y * PITCH_UM), axis=-1).reshape(n, 2) + rng.integers(-22, 22, (n, 2))
    near = np.full((n, 8), -1)
    for i in range(n):
        row, column = divmod(i, N_X)
        for k, (dx, dy) in enumerate([(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)]):
            if 0 <= row + dy < N_Y:
                near[i, k] = (row + dy) * N_X + (column + dx) % N_X
    dx, dy = np.meshgrid(np.arange(12) * 125, np.arange(24) * 125)
    reach = np.maximum(np.exp(-dx / 275 - dy / 325), 0.002)
    tensors = {
        "skin.run": runs(), "skin.light": np.full(n, 9000, np.int32),
        "skin.sink": np.round(u * 4096).astype(np.int32),
        "skin.press": np.round(np.maximum(u, 0) ** 2 * 200_000).astype(np.int32),
        "skin.reach": np.round(reach * 16384).astype(np.int16), "skin.taxel_place": place.astype(np.int32),
        "skin.gain": rng.integers(50_000, 80_000, (3, 6, 9, 9)).astype(np.int32),
        "skin.taxel_kind": rng.integers(0, 3, n).astype(np.int16), "skin.taxel_near": near.astype(np.int16),
        "skin.taxel_shift": np.add(rng.integers(-7500, 7500, (n, 2, 4)), [0, 37_500, 0, 0]).astype(np.int32),
        "relaxation.part": np.array([150_000, 90_000], np.int32), "relaxation.time_ms": np.array([80, 4000], np.int32),
    }  # fmt: skip
    numbers = {"taxels": n, "patches": 1, "runs": len(tensors["skin.run"]), "reach_step_um": 125,
               "taxel_area_um2": PITCH_UM**2, "floor_q12": 82, "apart_q12": 1400, "pair_q12": 6000, "sigma_un": 50_000,
               "sigma_q12": 300, "place_sigma_um": 400, "faint_place_sigma_um": 900,
               "stray_limit_q6": 32}  # fmt: skip
    metadata = {**base_metadata(parse_board(text.encode(), "small")), "relaxation.terms": "2"}
    return pack(tensors, {**metadata, **{f"skin.{k}": str(v) for k, v in numbers.items()}})


def picture(rng: np.random.Generator, touches: list[tuple[float, float, float]], light: float = 1.0) -> Picture:
    """Openings that glow, each touch (column, row, strength) more about its place."""
    number = openings()
    row, column = np.divmod(np.arange(N_X * N_Y), N_X)
    brighter = sum(s * np.exp(-np.hypot(column - c, row - r) / 0.6) for c, r, s in touches) + np.zeros(N_X * N_Y)
    level = np.append(40 * light * (1 + brighter), [0.0, 0.0])[number]
    grey = level[..., None] * np.array([1.1, 1.0, 0.6]) + rng.normal(0, 1, (HEIGHT, WIDTH, 3))
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("mode", ["auto", "single"])
def test_taxels_and_touches_are_those_of_the_mirror(mode: str) -> None:
    text = skin_text("tube", mode)
    board, rng = read_board(text), np.random.default_rng(4)
    file = calibration(board, text, rng)
    rest = [picture(rng, []) for _ in range(N_REST)]
    mean = ((16 * np.sum(rest, axis=0, dtype=np.int64) + N_REST // 2) // N_REST).astype(np.uint16)
    base, taxels, saturations = base_of(mean, board), Taxels(file.tensors, file.metadata), Saturations()
    taxels.learn(base)
    touches = TaxelTouches(board, file.tensors, file.metadata)
    n_of: list[int] = []
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for frame in rest:
            core.process(frame)
        for t in range(14):
            one, two = (2.3 + 0.1 * t, 1.6, 0.2 * t), (6.4, 3.2, 1.5 * (t > 6))
            frame = picture(rng, [one, two], light=1 + 0.005 * t)
            capture_s = 0.03 * t**1.5
            result = core.process(frame, capture_s)
            glow = glow_of(frame, base, board)
            assert np.array_equal(core.glow(), glow)
            ratio = taxels.run(glow)
            assert core.taxels().tolist() == ratio
            assert result.flags == 0
            expected = touches.run(ratio, 1 + round(capture_s * 1e6), saturations)
            assert [(r.x_um, r.y_um, r.press_un) for r in core.touches()] == expected
            assert result.wrench_un.tolist() == [0, 0, -sum(row[2] for row in expected), 0, 0, 0]
            assert result.force_z_validity == VALID
            assert result.force_xy_validity == NOT_MEASURED
            n_of.append(len(expected))
    assert n_of[0] == 0
    assert n_of[3:6] == [1, 1, 1], n_of
    assert (max(n_of) > 1) == (mode == "auto"), n_of


@pytest.mark.parametrize(
    ("shape", "apart_q12", "of_pairs"),
    [("tube", 4096, [2, 2, 2, 2]), ("plane", 4096, [2, 2, 2, 0]), ("tube", 1400, [0, 0, 0, 2])],
)
def test_two_fingers_side_by_side_are_told_as_the_mirror_tells_them(
    shape: str, apart_q12: int, of_pairs: list[int]
) -> None:
    """A pitch and a half apart: along both axes, askew, over the tube's cut (far apart on a plane); one stays one.

    Those that stand out by themselves are not searched for.
    """
    text = skin_text(shape)
    board, rng = read_board(text), np.random.default_rng(8)
    made = calibration(board, text, rng)
    file = pack(made.tensors, {**made.metadata, "skin.apart_q12": str(apart_q12)})
    rest = [picture(rng, []) for _ in range(N_REST)]
    base = base_of(((16 * np.sum(rest, axis=0, dtype=np.int64) + N_REST // 2) // N_REST).astype(np.uint16), board)
    taxels, saturations = Taxels(file.tensors, file.metadata), Saturations()
    taxels.learn(base)
    touches = TaxelTouches(board, file.tensors, file.metadata)
    fingers = [[(2.2, 2.0), (3.7, 2.0)], [(4.0, 1.2), (4.0, 2.7)], [(5.2, 2.0), (6.2, 3.1)], [(6.8, 1.9), (0.4, 1.9)],
               [(3.1, 2.2)], [(5.0, 3.1)]]  # fmt: skip
    told = []
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for frame in rest:
            core.process(frame)
        for t, places in enumerate(fingers):
            frame = pressed_picture(rng, places, shape == "tube")
            core.process(frame, float(t))
            expected = touches.run(taxels.run(glow_of(frame, base, board)), 1 + 1_000_000 * t, saturations)
            assert [(r.x_um, r.y_um, r.press_un) for r in core.touches()] == expected
            told.append((len(expected), sum(touch.of_pair > 0 for touch in touches.touches)))
    assert [n for n, _ in told[:3]] == [2, 2, 2]
    assert [n for _, n in told] == [*of_pairs, 0, 0], told
    assert [n for n, _ in told[4:]] == [1, 1]


def pressed_picture(rng: np.random.Generator, places: list[tuple[float, float]], is_tube: bool) -> Picture:
    """Openings that glow as the calibration's reach has it about each place (column, row)."""
    row, column = np.divmod(np.arange(N_X * N_Y), N_X)
    sink = np.zeros(N_X * N_Y)
    for x, y in places:
        aside = np.abs(column - x)
        aside = np.minimum(aside, N_X - aside) if is_tube else aside
        sink += 0.8 * np.exp(-aside * PITCH_UM / 275 - np.abs(row - y) * PITCH_UM / 325)
    level = np.append(40 * np.exp(sink), [0.0, 0.0])[openings()]
    grey = level[..., None] * np.array([1.1, 1.0, 0.6]) + rng.normal(0, 1, (HEIGHT, WIDTH, 3))
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def test_the_paper_s_method_reads_place_and_force_off_its_tables() -> None:
    text = skin_text("plane")
    board, rng = read_board(text), np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(((WIDTH - 2) >> 1) + 2) * 2, np.arange(((HEIGHT - 2) >> 1) + 2) * 2)
    curve = (600_000 + 4_171 * np.arange(513) * 4 + (117 * (np.arange(513) * 4) ** 2) // 1000 * 1000).astype(np.int32)
    tensors = {"skin.place": np.stack([100 * x - 7000, 110 * y - 3000], axis=-1).astype(np.int32), "skin.curve": curve}
    metadata = {**base_metadata(parse_board(text.encode(), "small")), "skin.step_log2": "1"}
    with Pipeline(parse_board(text.encode(), "small"), pack(tensors, metadata).data) as core:
        rest = [picture(rng, []) for _ in range(N_REST)]
        for frame in rest:
            core.process(frame)
        mean = ((16 * np.sum(rest, axis=0, dtype=np.int64) + N_REST // 2) // N_REST).astype(np.uint16)
        frame = picture(rng, [(3.0, 2.0, 2.0)])
        core.process(frame)
        glow = smoothed(glow_of(frame, base_of(mean, board), board))
        assert np.array_equal(core.glow(), glow)
        v, u = np.unravel_index(int(glow.argmax()), glow.shape)
        [touch] = core.touches()
        assert (touch.x_um, touch.y_um) == (100 * u - 7000, 110 * v - 3000)
        assert touch.press_un == image_force(curve.astype(np.int64), int(glow.max()))
        assert (touch.force_x_un, touch.force_y_un, touch.force_z_un) == (0, 0, -touch.press_un)


def test_covered_dead_and_lit_from_outside_is_flagged_at_once_and_good_frames_are_not() -> None:
    text = skin_text()
    board, rng = read_board(text), np.random.default_rng(6)
    file = calibration(board, text, rng)
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for _ in range(N_REST):
            core.process(picture(rng, []))
        dead = picture(rng, [(3.0, 2.0, 1.0)])
        dead[:, 14 : 14 + 3 * 16] = 0  # three columns of openings
        lit = np.clip(picture(rng, []).astype(int) + 8, 0, 255).astype(np.uint8)
        one = picture(rng, [])
        one[4:11, 14:24] = 0  # a single opening
        for bad, flag in ((np.zeros_like(dead), DARK), (dead, DARK), (one, DARK), (lit, LIGHT)):
            frame = core.process(bad)
            assert frame.flags & flag
            assert frame.force_z_validity == INVALID
            assert core.process(picture(rng, [(3.0, 2.0, 1.0)])).flags == 0


def test_a_black_level_that_fell_is_flagged() -> None:
    text = skin_text()
    board, rng = read_board(text), np.random.default_rng(9)

    def above(black: int) -> Picture:
        return np.clip(picture(rng, []).astype(int) + black, 0, 255).astype(np.uint8)

    with Pipeline(parse_board(text.encode(), "small"), calibration(board, text, rng).data) as core:
        for _ in range(N_REST):
            core.process(above(4))
        assert core.process(above(4)).flags == 0
        assert core.process(above(3)).flags & LIGHT


def test_a_table_without_its_parts_is_refused() -> None:
    from ruffini.errors import InputError

    text = skin_text()
    file = calibration(read_board(text), text, np.random.default_rng(7))
    for name in ("skin.gain", "skin.taxel_kind", "skin.reach", "skin.light", "skin.taxel_near"):
        tensors = {k: v for k, v in file.tensors.items() if k != name}
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            Pipeline(parse_board(text.encode(), "small"), pack(tensors, file.metadata).data)


def deviations(sigma: list[list[int]] | None, kind: int) -> list[tuple[int, int, int]]:
    """Force, its deviation (uN) and that of the place (um) of a touch that grows, on taxels of one kind."""
    text, rng, told = skin_text(), np.random.default_rng(4), []
    own = calibration(read_board(text), text, rng)
    tensors = own.tensors | {"skin.taxel_kind": np.full(N_X * N_Y, kind, np.int16)}
    if sigma is not None:
        tensors["skin.sigma"] = np.array(sigma, np.int32)
    rest = [picture(rng, []) for _ in range(N_REST)]
    with Pipeline(parse_board(text.encode(), "small"), pack(tensors, own.metadata).data) as core:
        for frame in [*rest, *(picture(rng, [(2.3, 1.6, 0.3 * t)]) for t in range(1, 12))]:
            core.process(frame)
            told += [(t.press_un, t.press_sigma_un, t.place_sigma_um) for t in core.touches()]
    return told


@pytest.mark.parametrize(("kind", "row"), [(0, (20_000, 0, 100, 0)), (2, (1, 409, 700, 250))])
def test_a_touchs_deviations_are_those_of_its_kind_of_taxel(kind: int, row: tuple[int, int, int, int]) -> None:
    sigma = [[20_000, 0, 100, 0], [1000, 4000, 9000, 9000], [1, 409, 700, 250]]
    threshold = parse_board(skin_text().encode(), "small").contact.threshold_un
    told = deviations(sigma, kind)
    assert len(told) > 5
    for force, of_force, of_place in told:
        assert abs(of_force - np.hypot(row[0], force * row[1] / 4096)) <= 2  # two roundings
        assert abs(of_place - row[2] - row[3] * threshold / max(force, threshold)) <= 1


def test_a_file_without_kinds_of_deviations_has_one_for_all() -> None:
    for force, of_force, _ in deviations(None, 1):
        assert abs(of_force - np.hypot(50_000, force * 300 / 4096)) <= 2  # two roundings


@pytest.mark.parametrize("row", [(0, 0, 1, 0), (1, 4097, 1, 0), (1, 0, 0, 0), (1, 0, 1, -1)])
def test_deviations_out_of_range_are_refused(row: tuple[int, int, int, int]) -> None:
    with pytest.raises(InputError, match="sigma"):
        deviations([[1, 0, 1, 0], [1, 0, 1, 0], list(row)], 0)
