"""Targets and the wrench of their features: the core's whole path against the mirror, bit for bit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import Board, read_board
from mirror.feature_wrench import FeatureWrench
from mirror.fixed import Saturations
from mirror.light import grey, grey_of_rest, rest_image
from mirror.targets import Targets, nominal
from odd_boards import small_board

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, metadata_without_board, pack
from ruffini.core import Pipeline
from ruffini.core.feature_wrench import wrench_on_board
from ruffini.errors import InputError
from ruffini.estimators.wrench.fit import Fit
from ruffini.estimators.wrench.log import Features
from ruffini.estimators.wrench.model import TIMES_S, Frames, WrenchMap
from ruffini.estimators.wrench.tables import tables as tables_of
from ruffini.estimators.wrench.warmth import Degrees, WrenchWarmth

Picture = npt.NDArray[np.uint8]
NOT_MEASURED, VALID, UNCALIBRATED, INVALID = 0, 1, 2, 3
MARKERS_LOST, OVER_RANGE, LIGHT, FEATURES, TEMPERATURE = 8, 32, 1024, 2048, 8192
CELSIUS_AT_REST = 21.5
CELSIUS = (None, 22.034, 45.5, 45.501, 9.9)  # the last two are out of what the table saw
N_REST = 3
TARGETS = """[targets]
places_um = [[2000, 780], [1100, 2200], [2900, 2300]]
below_um = 1000
diameter_um = 461
threshold_1e3 = 400
"""
STAGES = '["difference", "targets", "feature_wrench"]'


def board_text() -> str:
    """Awkward sizes: neither divides by 4, the third target's rays leave the picture."""
    text = small_board(width=242, height=179, step=1).replace("focal_mpx = 101300", "focal_mpx = 400000")
    text = text.replace("center_x_mpx = 33210", "center_x_mpx = 119210")
    text = text.replace("center_y_mpx = 20777", "center_y_mpx = 84777")
    text = text.replace("[depth]\n", f"{TARGETS}[depth]\n")
    return text[: text.index("stages = ")] + f"stages = {STAGES}\n"


def draw(board: Board, rng: np.random.Generator, moved: float, radius: float = 18.0) -> Picture:
    """Dark discs, blurred, on a slanted background with noise; the discs `moved` px from rest."""
    height, width = board["camera"]["height_px"], board["camera"]["width_px"]
    y, x = np.mgrid[:height, :width]
    light = 90 + 0.2 * x + 0.1 * y
    for i, place in enumerate(nominal(board)):
        away = np.hypot(x - place.x / 65536 - 1.3 - moved * (1 + i), y - place.y / 65536 + 0.7 + moved)
        light = light + (12 - light) * np.clip((radius + 0.2 * moved - away) / 2 + 0.5, 0, 1)
    noise = rng.normal(size=(height, width, 3))
    return np.clip(light[..., None] * [0.9, 1.0, 1.1] + noise, 0, 255).astype(np.uint8)


def tables(rng: np.random.Generator, n: int = 9) -> dict[str, npt.NDArray[np.generic]]:
    """Numbers of every size that the loader takes; the fifth axis is not measured."""
    full_scale = np.array([1_000_000, 900_000, 8_000_000, 6_000, 0, 3_000_000], np.int32)
    return {
        "wrench.gain": rng.integers(-(1 << 20), 1 << 20, (6, n)).astype(np.int32),
        "wrench.shift": np.array([20, 19, 18, 17, 16, 21], np.uint8),
        "wrench.full_scale": full_scale,
        "wrench.square": rng.integers(-(1 << 18), 1 << 18, (6, 21)).astype(np.int32),
        "wrench.square_shift": np.array([0, 1, 3, 0, 13, 2], np.uint8),
        "wrench.error": rng.integers(-(1 << 14), 1 << 14, (2, 6, 6)).astype(np.int32),
        "wrench.forward": rng.integers(-(1 << 10), 1 << 10, (n, 27)).astype(np.int32),
        "wrench.tolerance": np.full(n, 1 << 19, np.int32),
        "wrench.warm_mc": np.array([24_000, 20_000, 35_500], np.int32),
        "wrench.warm_gain": np.array([3221, -1999, 1 << 15, 700, 5, -77], np.int32),
        "wrench.warm_offset": rng.integers(-(1 << 18), 1 << 18, 6).astype(np.int32),
        "wrench.relax_time_ms": np.array([40, 900], np.int32),
        "wrench.relax_part": rng.integers(-(1 << 16), 1 << 17, (2, 6)).astype(np.int32),
    }


def kernel(rng: np.random.Generator, n: int = 9, n_landmarks: int = 37) -> dict[str, npt.NDArray[np.generic]]:
    """A kernel whose landmarks lie about where the features of the recording do."""
    curve = np.round((1 << 24) * np.exp(-((np.arange(1025) / 64) ** 2) / 2)).astype(np.int32)
    return {
        "wrench.kernel_project": rng.integers(-(1 << 20), 1 << 20, (5, n)).astype(np.int32),
        "wrench.kernel_landmark": rng.integers(-(1 << 19), 1 << 21, (n_landmarks, 5)).astype(np.int32),
        "wrench.kernel_curve": curve,
        "wrench.kernel_weight": rng.integers(-(1 << 24), 1 << 24, (6, n_landmarks)).astype(np.int32),
        "wrench.kernel_offset": rng.integers(-(1 << 12), 1 << 12, 6).astype(np.int32),
        "wrench.kernel_reach": np.array([3 << 20, 300], np.int32),
        "wrench.kernel_shift": np.array([18, 20, 21, 22, 23, 24, 25], np.uint8),
    }


def opened(text: str, kind: dict[str, npt.NDArray[np.generic]], features: str = "targets") -> Pipeline:
    typed = parse_board(text, "targets")
    return Pipeline(typed, pack(kind, {**base_metadata(typed), "wrench.features": features}).data)


def test_a_kernel_in_integers() -> None:
    """The board's map alone against the mirror: near the landmarks, far beyond the table, and at the limits."""
    rng = np.random.default_rng(17)
    kind = {**tables(rng), **kernel(rng)}
    del kind["wrench.warm_mc"], kind["wrench.warm_gain"], kind["wrench.warm_offset"]
    kind["wrench.full_scale"] = np.array([1 << 30, 1 << 29, 1 << 30, 1 << 30, 0, 1 << 28], np.int32)
    metadata = {**metadata_without_board(), "wrench.features": "columns"}
    mirror, saturations = FeatureWrench(kind), Saturations()
    raw = np.concatenate([rng.normal(size=(20, 9)) * s for s in (1e4, 1e5, 3e6)]).round()
    raw = np.concatenate([raw, np.full((1, 9), -(2.0**31)), np.full((1, 9), 2.0**31 - 1)])
    time_s = 0.03 * np.arange(len(raw))
    said = wrench_on_board(pack(kind, metadata).data, "columns", raw, time_s)
    inside = 0
    for t, row in enumerate(raw):
        expected = mirror.run([int(v) for v in row], 1 + round(1e6 * time_s[t]), saturations)
        assert said.wrench[t].tolist() == [v * s for v, s in zip(expected.wrench, [1e-6] * 3 + [1e-9] * 3, strict=True)]
        variances = [expected.covariance[i] for i in (0, 6, 11, 15, 18, 20)]
        assert said.sigma[t].tolist() == (1e-6 * np.sqrt(np.array(variances))).tolist()
        assert bool(said.agrees[t]) == expected.agrees
        assert bool(said.is_in_range[t]) == expected.is_in_range
        inside += expected.is_in_range
    assert 0 < inside < len(raw)
    # The covariance grows outside: the same frame, a reach of nothing.
    kind["wrench.kernel_reach"] = np.array([0, 300], np.int32)
    outside = wrench_on_board(pack(kind, metadata).data, "columns", raw, time_s)
    assert (outside.sigma[:20, :4] > said.sigma[:20, :4]).any()
    assert not outside.is_in_range.any()


def rest(rng: np.random.Generator, n: int = 9) -> dict[str, npt.NDArray[np.generic]]:
    """Directions in which features of about 1e4 have a length of about 1."""
    return {
        "wrench.rest_project": rng.integers(-(1 << 20), 1 << 20, (n, n)).astype(np.int32),
        "wrench.rest_shift": np.array([16], np.uint8),
        "wrench.rest_error": np.array([40_000, 30_000, 70_000, 900, 0, 800], np.int32),
    }


def test_features_as_at_rest_make_no_wrench() -> None:
    """Against the mirror: inside and outside of the limit, and where a direction is clamped."""
    rng = np.random.default_rng(23)
    kind = {**tables(rng), **rest(rng)}
    del kind["wrench.warm_mc"], kind["wrench.warm_gain"], kind["wrench.warm_offset"]
    metadata = {**metadata_without_board(), "wrench.features": "columns"}
    mirror, saturations = FeatureWrench(kind), Saturations()
    raw = np.concatenate([rng.normal(size=(30, 9)) * s for s in (3e3, 1.5e4, 1e5)]).round()
    raw = np.concatenate([raw, np.full((1, 9), 2.0**31 - 1)])
    time_s = 0.03 * np.arange(len(raw))
    said = wrench_on_board(pack(kind, metadata).data, "columns", raw, time_s)
    n_untouched = 0
    for t, row in enumerate(raw):
        expected = mirror.run([int(v) for v in row], 1 + round(1e6 * time_s[t]), saturations)
        assert said.wrench[t].tolist() == [v * s for v, s in zip(expected.wrench, [1e-6] * 3 + [1e-9] * 3, strict=True)]
        variances = [expected.covariance[i] for i in (0, 6, 11, 15, 18, 20)]
        assert said.sigma[t].tolist() == (1e-6 * np.sqrt(np.array(variances))).tolist()
        n_untouched += not said.wrench[t].any()
    assert 20 < n_untouched < 60
    assert not said.wrench[:20].any()
    assert said.sigma[:20] == pytest.approx(np.tile([0.04, 0.03, 0.07, 0.0009, 0, 0.0008], (20, 1)))


@pytest.mark.parametrize(
    ("name", "value"), [("wrench.rest_project", 1 << 27), ("wrench.rest_shift", 0), ("wrench.rest_error", -1)]
)
def test_untouched_features_out_of_range_are_refused(name: str, value: int) -> None:
    rng = np.random.default_rng(1)
    kind = {**tables(rng), **rest(rng)}
    kind[name].flat[0] = value  # type: ignore[index]
    with pytest.raises(InputError, match=r"wrench.rest.* out of range"):
        opened(board_text(), kind)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wrench.kernel_project", 1 << 27), ("wrench.kernel_landmark", 1 << 27), ("wrench.kernel_curve", 1 << 25),
        ("wrench.kernel_weight", 1 << 29), ("wrench.kernel_reach", -1), ("wrench.kernel_shift", 0),
    ],
)  # fmt: skip
def test_a_kernel_out_of_range_is_refused(name: str, value: int) -> None:
    rng = np.random.default_rng(1)
    kind = {**tables(rng), **kernel(rng)}
    kind[name].flat[0] = value  # type: ignore[index]
    with pytest.raises(InputError, match=r"wrench.kernel.* out of range"):
        opened(board_text(), kind)


def mirror_rows(targets: Targets) -> list[list[int]]:
    pairs = zip(targets.rest, targets.now, targets.is_lost, strict=True)
    return [[*(v for s in (rest, now) for v in (s.x, s.y, s.area, s.bright)), int(lost)] for rest, now, lost in pairs]


def test_targets_and_their_wrench_over_a_recording() -> None:
    text = board_text()
    board, rng = read_board(text), np.random.default_rng(3)
    kind = tables(rng)
    rest = np.stack([draw(board, rng, 0.0) for _ in range(N_REST)])
    targets, wrench, saturations = Targets(board), FeatureWrench(kind), Saturations()
    targets.learn(grey_of_rest(rest_image(rest)))
    seen_flags = 0
    with opened(text, kind) as core:
        for frame in rest:
            core.process(frame)
        core.zero(N_REST)
        core.set_celsius(CELSIUS_AT_REST)
        for frame in rest:
            core.process(frame)
        for t, moved in enumerate((0.1, 1.0, 3.3, 4.0, 0.2), 1):
            picture = draw(board, rng, moved)
            if t == 4:
                picture[60:] = np.minimum(picture[60:].astype(int) + 60, 255)  # light on two of three
            celsius = CELSIUS[t - 1]
            core.set_celsius(celsius)
            said = core.process(picture, capture_s=t * 0.03)
            targets.track(grey(picture))
            assert core.targets().tolist() == mirror_rows(targets)
            assert core.features().tolist() == targets.features().tolist()
            assert bool(said.flags & LIGHT) == targets.is_light_wrong() == (t == 4)
            is_wrong = bool(said.flags & LIGHT)
            warm = (None if celsius is None else round(1000 * celsius), round(1000 * CELSIUS_AT_REST))
            expected = wrench.run(targets.features().tolist(), 0 if is_wrong else 1 + t * 30_000, saturations, warm)
            assert said.wrench_un.tolist() == expected.wrench
            assert core.covariance().tolist() == expected.covariance
            assert bool(said.flags & FEATURES) != expected.agrees
            assert bool(said.flags & OVER_RANGE) != expected.is_in_range
            assert bool(said.flags & TEMPERATURE) != expected.is_warmth_known == (t in (2, 3))
            state = VALID if expected.is_warmth_known else UNCALIBRATED
            state = INVALID if is_wrong or not expected.agrees or not expected.is_in_range else state
            assert said.wrench_validity == (state, state, state, state, NOT_MEASURED, state)
            seen_flags |= said.flags
        assert core.process(picture).saturations == saturations.count
    assert seen_flags & FEATURES
    assert seen_flags & OVER_RANGE


def test_a_removed_target_is_lost_and_the_others_are_not() -> None:
    text = board_text()
    board, rng = read_board(text), np.random.default_rng(5)
    with opened(text, tables(rng)) as core:
        for _ in range(N_REST):
            core.process(draw(board, rng, 0.0))
        picture = draw(board, rng, 0.0)
        x, y = (int(v) // 65536 for v in core.targets()[1, :2])
        picture[y - 25 : y + 26, x - 25 : x + 26] = 110
        said = core.process(picture)
        assert core.targets()[:, 8].tolist() == [0, 1, 0]
        assert said.flags & MARKERS_LOST
        assert said.n_markers_lost == 1
        assert set(said.wrench_validity) == {INVALID, NOT_MEASURED}


def test_a_table_for_other_features_is_refused() -> None:
    with pytest.raises(InputError, match=r"tensor wrench\.gain has another type or shape"):
        opened(board_text(), tables(np.random.default_rng(1), n=12))
    with pytest.raises(InputError, match='calibration is for a wrench from "markers", this board has "targets"'):
        opened(board_text(), tables(np.random.default_rng(1)), features="markers")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wrench.gain", 1 << 27), ("wrench.square", 1 << 27), ("wrench.shift", 41), ("wrench.full_scale", -1),
        ("wrench.error", 1 << 26), ("wrench.forward", 1 << 27), ("wrench.tolerance", 0), ("wrench.relax_time_ms", 0),
        ("wrench.relax_part", (1 << 20) + 1), ("wrench.warm_mc", 300_001), ("wrench.warm_gain", -(1 << 15) - 1),
        ("wrench.warm_offset", (1 << 26) + 1), ("wrench.square_shift", 14),
    ],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(name: str, value: int) -> None:
    kind = tables(np.random.default_rng(1))
    kind[name].flat[0] = value  # type: ignore[index]
    with pytest.raises(InputError, match=r"wrench.* out of range"):
        opened(board_text(), kind)


def test_a_row_that_could_overflow_is_refused() -> None:
    """Of 513 markers: 1,024 of the largest entries are what the accumulator holds."""
    text = board_text().replace('"targets", ', '"markers", ')
    for old, new in (
        (
            "n_x = 5\nn_y = 3\npitch_x_um = 733\npitch_y_um = 751",
            "n_x = 27\nn_y = 19\npitch_x_um = 101\npitch_y_um = 101",
        ),
        ("diameter_um = 301", "diameter_um = 80"),
    ):
        assert old in text
        text = text.replace(old, new)
    kind = tables(np.random.default_rng(1), n=2 * 27 * 19)
    kind["wrench.gain"][2] = 1 << 26
    with pytest.raises(InputError, match=r"a row of wrench.gain sums to more than 2\^36"):
        opened(text, kind, features="markers")
    kind["wrench.gain"][2, :2] = 0
    opened(text, kind, features="markers").close()


def test_a_fitted_map_says_the_same_in_integers() -> None:
    """`cal fit --only wrench` tables on the core's arithmetic against the fit in float: within 1e-4 of full scale."""
    rng = np.random.default_rng(8)
    full = np.array([1.0, 1.0, 8.0, 20.0, 20.0, 20.0])
    features = rng.normal(size=(50, 9)) * 3e5
    gain = rng.normal(size=(6, 9)) * full[:, None] / 1.5e6
    relax = np.zeros((len(TIMES_S), 6))
    relax[1] = 0.1
    made = WrenchMap(
        gain, full, rng.normal(size=(6, 21)) * 0.02 * full[:, None], relax, np.zeros((9, 27)), np.full(9, 6e7),
        np.zeros((2, 6, 6)),
        WrenchWarmth(25.0, 20.0, 30.0, rng.normal(size=6) * 3e-3, rng.normal(size=6) * 1e-3 * full),
    )  # fmt: skip
    fit = Fit(made, 0.0, {}, {}, full, full, full, 1.0, 50, 1, "recording")
    kind, _ = tables_of(fit, Features("targets", 9))
    degrees = Degrees(np.linspace(18.0, 33.0, 50), np.full(50, 21.0))
    none = np.zeros(50, np.intp)
    frames = Frames(np.round(features), np.zeros((50, 6)), 0.1 * np.arange(50), none, degrees, none, none)
    core, saturations = FeatureWrench(kind), Saturations()
    said = [
        core.run(row.astype(int).tolist(), 1 + 100_000 * t, saturations, (round(1000 * degrees.now[t]), 21_000))
        for t, row in enumerate(frames.features)
    ]
    wrench = np.array([s.wrench for s in said]) * [1e-6, 1e-6, 1e-6, 1e-9, 1e-9, 1e-9]
    assert (np.abs(wrench - made.predicted(frames)) < 1e-4 * full).all()
    assert saturations.count == 0
