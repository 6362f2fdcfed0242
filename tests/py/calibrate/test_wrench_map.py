"""A wrench fitted to features: what was put into made-up recordings comes out again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.errors import InputError
from ruffini.estimators.wrench.fit import Fit, fit_wrench_map, folds_of
from ruffini.estimators.wrench.log import FeatureRun, Features
from ruffini.estimators.wrench.model import AXES, frames_of, memories
from ruffini.estimators.wrench.tables import map_in, tables
from ruffini.estimators.wrench.target_geometry import TargetGeometry
from ruffini.estimators.wrench.warmth import Degrees

Array = npt.NDArray[np.float64]

RATE_HZ, LAG_S, N_FEATURES = 30.0, 0.023, 9
FULL = np.array([1.0, 1.0, 8.0, 20.0, 20.0, 20.0])  # N, N mm
TO_N_M = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
NOISE = 300.0  # of a feature, raw units; a full load makes about 5e5


def loads(seed: int, n_frames: int = 60, n_held: int = 0) -> Array:
    """Rest, push, hold and release, rest: (t, 6) N and N mm."""
    rng = np.random.default_rng(seed)
    way = np.sin(np.pi * np.arange(n_frames) / n_frames) ** 2
    middle = n_frames // 2
    push = np.concatenate([np.zeros(10), way[:middle], np.ones(n_held), way[middle:], np.zeros(10)])
    peak = rng.uniform(-1, 1, 6) * FULL
    peak[2] = -abs(peak[2])
    return np.asarray(push[:, None] * peak)


def recordings(
    n: int, *, bend: float = 0.0, forgets: float = 0.0, silent: int | None = None, noise: float = NOISE
) -> list[FeatureRun]:
    """A sensor whose features are linear in the wrench up to `bend`, and that forgets `forgets` of it."""
    truth = np.random.default_rng(1)
    made_by = truth.normal(size=(N_FEATURES, 6)) * 5e5 / FULL
    square = truth.normal(size=(N_FEATURES, 6)) * 5e5
    out = []
    for k in range(n):
        rng = np.random.default_rng(100 + k)
        wrench = loads(k, n_held=90 if forgets else 0)
        if silent is not None:
            wrench[:, silent] = 0
        strained = wrench.copy()
        if forgets:  # what it is strained by, so that the wrench is what is left of it after 0.3 s
            h, before = np.zeros(6), np.zeros(6)
            step = 1 - np.exp(-1 / RATE_HZ / 0.3)
            for t, w in enumerate(wrench):
                fixed = h + step * (before / 2 - h)
                strained[t] = (w + forgets * fixed) / (1 - forgets * step / 2)
                h = h + step * ((strained[t] + before) / 2 - h)
                before = strained[t]
        features = strained @ made_by.T + bend * (strained / FULL) ** 2 @ square.T
        features += rng.normal(size=features.shape) * noise
        time_s = np.arange(len(wrench)) / RATE_HZ
        late = np.stack([np.interp(time_s - LAG_S, time_s, column) for column in wrench.T], axis=1)
        out.append(FeatureRun(f"made/{k}", time_s, features, np.ones(len(wrench), bool), time_s, late * TO_N_M))
    return out


def fitted(runs: list[FeatureRun], **how: Any) -> Fit:
    return kept(fit_wrench_map, runs, **how)


def error_on_new(fit: Fit, **made: float) -> Array:
    """RMSE of each axis over its range, on recordings that nothing was fitted on."""
    frames = frames_of(recordings(40, **made)[30:], LAG_S)  # type: ignore[arg-type]
    return np.asarray(np.sqrt(((fit.map.predicted(frames) - frames.wrench) ** 2).mean(axis=0)) / FULL)


def test_k_and_the_lag_of_a_linear_sensor() -> None:
    fit = fitted(recordings(30))
    assert fit.lag_s == pytest.approx(LAG_S, abs=0.004)
    assert fit.terms == {"temperature": [], "quadratic": [], "relaxation": []}
    assert fit.report()["temperature"] == "not measured in every recording"
    assert (error_on_new(fit) < 0.004).all()
    assert (fit.r2 > 0.99).all()


def behind(run: FeatureRun, lag_s: float, size: float = 1.0) -> FeatureRun:
    """With its reference by `lag_s` behind the pictures, and all of it `size` times as large."""
    late = np.stack([np.interp(run.time_s - (lag_s - LAG_S), run.time_s, column) for column in run.reference.T], axis=1)
    return replace(run, features=run.features * size, reference=late * size)


def test_a_lag_that_one_recording_decides_is_not_the_logs() -> None:
    paired = [behind(run, 0.0) for run in recordings(6)]
    assert fitted([*paired[:5], behind(recordings(6)[5], 0.06, 60.0)]).lag_s == 0
    assert fitted([behind(run, 0.06) for run in recordings(6)]).lag_s == pytest.approx(0.06, abs=0.004)


@pytest.mark.parametrize(("n", "n_folds"), [(2, 2), (7, 7), (10, 10), (11, 5)])
def test_of_few_recordings_each_is_left_out_alone(n: int, n_folds: int) -> None:
    frames = frames_of(recordings(n), 0.0)
    folds = folds_of(frames, "recording")
    assert len(folds) == n_folds
    assert np.sum(folds, axis=0).tolist() == [1] * len(frames.features), "each frame is left out once"
    for left in folds:
        assert not set(frames.recording[left]) & set(frames.recording[~left])


def test_quadratic_terms_stay_where_they_pay() -> None:
    fit = fitted(recordings(30, bend=0.08))
    assert fit.terms["quadratic"]
    assert (fit.rmse < 0.7 * fit.linear_rmse).any()
    assert (error_on_new(fit, bend=0.08) < 0.02).all()


def test_what_the_structure_forgets_is_found() -> None:
    fit = fitted(recordings(30, forgets=0.2))
    assert set(fit.terms["relaxation"]) == set(AXES)
    assert fit.map.relax[0] == pytest.approx(np.full(6, 0.2), abs=0.05)
    assert (error_on_new(fit, forgets=0.2) < 0.01).all()


GAIN_PER_K = np.array([3e-3, 3e-3, -5e-3, 2e-3, 2e-3, 4e-3])
OFFSET_PER_K = np.array([1e-3, 0.0, 15e-3, 0.0, 0.02, 0.0])  # N and N mm


def warmed(n: int, *, sensitive: float, degrees_k: float = 12.0) -> list[FeatureRun]:
    """Recordings at temperatures between 20 and 20 + degrees_k, their rest learned at up to 4 K less."""
    out, made_by = [], np.random.default_rng(1).normal(size=(N_FEATURES, 6)) * 5e5 / FULL
    for k, run in enumerate(recordings(n)):
        rng = np.random.default_rng(1000 + k)
        celsius, since = 20 + degrees_k * rng.uniform(), rng.uniform(0, 4)
        wrench = frames_of([run], LAG_S).wrench
        elastic = wrench / (1 + sensitive * GAIN_PER_K * (celsius - 26)) + sensitive * OFFSET_PER_K * since
        degrees = Degrees(np.full(len(wrench), celsius), np.full(len(wrench), celsius - since))
        out.append(replace(run, features=run.features + (elastic - wrench) @ made_by.T, degrees=degrees))
    return out


def test_what_temperature_does_is_found() -> None:
    """The linear map alone errs by what 12 K do; on new recordings the corrected one hardly does."""
    fit = fitted(warmed(40, sensitive=1.0)[:30])
    assert {"Fx", "Fz", "Tz"} <= set(fit.terms["temperature"])
    assert fit.map.warmth is not None
    assert fit.map.warmth.gain[[0, 2]] == pytest.approx(GAIN_PER_K[[0, 2]], abs=5e-4)
    assert fit.map.warmth.offset[2] == pytest.approx(OFFSET_PER_K[2], abs=2e-3)
    new = frames_of(warmed(40, sensitive=1.0)[30:], LAG_S)
    error = np.sqrt(((fit.map.predicted(new) - new.wrench) ** 2).mean(axis=0)) / FULL
    assert (error < 0.004).all()
    assert fit.rmse[2] < 0.5 * fit.linear_rmse[2]
    kind, said = tables(fit, Features("targets", N_FEATURES))
    again = map_in(
        container.unpack(container.pack(kind, {**container.base_metadata(find_board("ftouch")), **said}).data)
    )
    assert again.predicted(new) == pytest.approx(fit.map.predicted(new), abs=1e-4)
    assert kind["wrench.warm_mc"][1:].tolist() == pytest.approx([20_000, 32_000], abs=1_000)


def test_temperature_that_does_nothing_is_left_out() -> None:
    fit = fitted(warmed(30, sensitive=0.0))
    assert fit.terms["temperature"] == []
    assert fit.report()["temperature"] == "lessens no error on what was not fitted"
    assert "wrench.warm_mc" not in tables(fit, Features("targets", N_FEATURES))[0]
    fit = fitted(warmed(30, sensitive=1.0, degrees_k=1.0))
    assert fit.map.warmth is None
    assert str(fit.report()["temperature"]).startswith("it varies by")


def test_an_axis_that_nobody_loads_is_not_measured() -> None:
    """However far it is off: its error, here of hundreds of newtons millimetres, is not the table's to hold."""
    runs = recordings(30, silent=5)
    for k, run in enumerate(runs):
        other = np.random.default_rng(k).normal(scale=0.5, size=len(run.reference))
        runs[k] = replace(run, reference=run.reference + np.outer(other, np.eye(6)[5]))
    fit = fitted(runs)
    assert fit.report()["not_measured"] == ["Tz"]
    kind, _ = tables(fit, Features("targets", N_FEATURES))
    assert kind["wrench.full_scale"][5] == 0
    assert not kind["wrench.error"][..., 5].any()


def test_noise_on_an_axis_that_is_barely_loaded_is_not_its_range() -> None:
    runs = recordings(30)
    for k, run in enumerate(runs):
        runs[k] = replace(run, reference=run.reference * [0.01, 1, 1, 1, 1, 1])
    fit = fitted(runs)
    assert not fit.report()["not_measured"]
    largest = max(np.abs(run.reference[:, 2]).max() for run in runs)
    kind, _ = tables(fit, Features("targets", N_FEATURES))
    assert kind["wrench.full_scale"][0] == pytest.approx(0.02 * largest * 1e6, rel=0.01)  # uN
    assert kind["wrench.full_scale"][1] > 0.5e6


def test_an_axis_that_only_one_recording_loads_is_measured() -> None:
    """As the twist of the 17 conditions: whoever leaves it out cannot foresee it."""
    runs = recordings(17)
    for k in range(16):
        runs[k] = recordings(17, silent=5)[k]
    fit = fitted(runs)
    assert fit.r2[5] < 0.9
    assert not fit.report()["not_measured"]
    assert error_on_new(fit)[5] < 0.01


def test_wrong_units_and_too_little_are_refused() -> None:
    runs = recordings(10)
    thousand = [replace(r, reference=r.reference * np.array([1, 1, 1, 1e3, 1e3, 1e3])) for r in runs]
    with pytest.raises(InputError, match="give them in N mm"):
        fitted(thousand)
    with pytest.raises(InputError, match="only 1 recordings"):
        fitted(recordings(1))
    with pytest.raises(InputError, match="recording, touch, block"):
        fitted(runs, holdout="frame")
    late = [replace(r, reference_s=r.reference_s + 0.3) for r in runs]
    with pytest.raises(InputError, match="off the pictures"):
        fitted(late)


def test_a_reference_of_something_else_is_refused() -> None:
    """Features of their own, best explained by no lag at all."""
    runs = recordings(10)
    for k, run in enumerate(runs):
        noise = np.random.default_rng(7 + k).normal(size=(len(run.time_s), 40))
        runs[k] = replace(run, features=noise + 0.2 * run.at(LAG_S)[:, :1])
    with pytest.raises(InputError, match="the features tell nothing of the reference"):
        fitted(runs)


def test_features_that_tell_nothing_or_hardly_of_a_load_are_refused() -> None:
    """One axis alone is loaded: those that nobody loads are no reason to accept what says nothing of that one."""
    time_s, wrench, rng = np.arange(60) / RATE_HZ, np.zeros((60, 6)), np.random.default_rng(1)
    rows = np.arange(60)
    wrench[10:50, 2] = -3.0

    def run(name: str, features: Array, reference: Array) -> FeatureRun:
        return FeatureRun(name, time_s, features, np.ones(60, bool), time_s, reference, touch=rows)

    still = [run(str(k), np.tile(rng.normal(size=4), (60, 1)), wrench) for k in range(2)]
    with pytest.raises(InputError, match="the features tell nothing of the reference"):
        fit_wrench_map(still)
    spike = np.zeros((60, 6))
    spike[10, 2] = -5.0
    made = [rng.normal(size=(60, 4)), 1e3 * spike[:, :4] + rng.normal(size=(60, 4))]
    with pytest.raises(InputError, match="show a load in 1 frames of this log"):
        fit_wrench_map([run("a", made[0], np.zeros((60, 6))), run("b", made[1], spike)])


def test_touches_of_one_recording_can_be_held_out() -> None:
    runs = recordings(12)
    joined = FeatureRun(
        "one", np.arange(sum(len(r.time_s) for r in runs)) / RATE_HZ, np.concatenate([r.features for r in runs]),
        np.concatenate([r.is_good for r in runs]), np.arange(sum(len(r.time_s) for r in runs)) / RATE_HZ,
        np.concatenate([r.reference for r in runs]),
    )  # fmt: skip
    assert (fitted([joined], holdout="touch").r2 > 0.99).all()
    with pytest.raises(InputError, match="only 1 recordings"):
        fitted([joined])


def test_the_covariance_covers_what_it_errs_by() -> None:
    """Within three stated sigmas, 99 % of the frames of every axis, and not many times too wide."""
    fit = fitted(recordings(30, bend=0.05))
    frames = frames_of(recordings(40, bend=0.05)[30:], LAG_S)
    error = fit.map.predicted(frames) - frames.wrench
    sigma = fit.map.sigma(fit.map.scaled(frames.features @ fit.map.gain.T))
    assert (np.mean(np.abs(error) < 3 * sigma, axis=0) > 0.97).all()
    assert (np.sqrt(np.mean((error / sigma) ** 2, axis=0)) > 0.1).all()


def test_the_geometry_gives_pairs_that_no_load_of_the_log_has() -> None:
    """A tray of one stiffness, loaded one axis at a time; judged under all axes together."""
    geometry = TargetGeometry(find_board("ftouch"))
    compliance = np.array([0.4, 0.4, 0.08, 6e-4, 6e-4, 2e-3])  # mm or rad for 1 N or N mm

    def recording(k: int, peak: Array) -> FeatureRun:
        push = np.concatenate([np.zeros(12), np.sin(np.pi * np.arange(40) / 40) ** 2, np.zeros(12)])
        wrench = push[:, None] * peak
        features = geometry.features(wrench * compliance)
        features += np.random.default_rng(k).normal(size=features.shape) * NOISE
        time_s = np.arange(len(push)) / RATE_HZ
        return FeatureRun(f"axis/{k}", time_s, features, np.ones(len(push), bool), time_s, wrench * TO_N_M)

    rng = np.random.default_rng(5)
    single = [
        recording(k, np.eye(6)[k % 6] * FULL * rng.uniform(0.5, 1) * (1 if k % 6 != 2 else -1)) for k in range(36)
    ]
    together = frames_of([recording(100 + k, rng.uniform(-1, 1, 6) * FULL) for k in range(20)], 0.0)
    errors = {}
    for name, bend in (("free", None), ("geometry", geometry.second_order)):
        found = fitted(single, bend=bend).map
        errors[name] = np.sqrt(((found.predicted(together) - together.wrench) ** 2).mean(axis=0)) / FULL
    assert (errors["geometry"] < 0.03).all()
    assert errors["geometry"].sum() < 0.7 * errors["free"].sum(), errors


def test_many_markers_are_features_too() -> None:
    """Sixty shifts that follow six loads and fifty other ways of moving: the ridge comes from what was not fitted."""
    truth = np.random.default_rng(4)
    made_by, others = truth.normal(size=(120, 6)) * 5e4 / FULL, truth.normal(size=(120, 50)) * 2e3

    def recording(k: int) -> FeatureRun:
        rng, wrench = np.random.default_rng(k), loads(k)
        features = wrench @ made_by.T + rng.normal(size=(len(wrench), 50)) @ others.T
        time_s = np.arange(len(wrench)) / RATE_HZ
        noisy = wrench + rng.normal(size=wrench.shape) * 0.05 * FULL
        return FeatureRun(f"pad/{k}", time_s, features, np.ones(len(wrench), bool), time_s, noisy * TO_N_M)

    fit = fitted([recording(k) for k in range(25)])
    new = frames_of([replace(recording(k), reference=loads(k) * TO_N_M) for k in range(100, 110)], 0.0)
    assert (np.sqrt(((fit.map.predicted(new) - new.wrench) ** 2).mean(axis=0)) / FULL < 0.02).all()
    assert not fit.leaning
    kind, said = tables(fit, Features("markers", 120))
    assert kind["wrench.gain"].shape == (6, 120)
    assert said["wrench.features"] == "markers"


def few_loads_for_many_markers(truth: np.random.Generator) -> tuple[list[FeatureRun], Array]:
    """Recordings, and K of the mechanics, of which each axis is off by a factor."""
    made_by, others = truth.normal(size=(120, 6)) * 5e4 / FULL, truth.normal(size=(120, 50)) * 1e4
    known = np.linalg.pinv(np.concatenate([made_by, others], axis=1))[:6] * truth.uniform(0.5, 2, 6)[:, None]

    def recording(k: int) -> FeatureRun:
        rng, wrench = np.random.default_rng(k), loads(k, 20)
        size = np.abs(wrench / FULL).max(axis=1, keepdims=True)
        features = wrench @ made_by.T + size * (rng.normal(size=50) @ others.T)
        features += rng.normal(size=features.shape) * NOISE
        time_s = np.arange(len(wrench)) / RATE_HZ
        return FeatureRun(f"pad/{k}", time_s, features, np.ones(len(wrench), bool), time_s, wrench * TO_N_M)

    return [recording(k) for k in range(25)], known


def test_what_the_mechanics_says_is_leaned_on_where_it_helps() -> None:
    truth = np.random.default_rng(6)
    runs, known = few_loads_for_many_markers(truth)
    plain, leaning = fitted(runs), fitted(runs, prior=known)
    assert leaning.leaning == list(AXES)
    assert (leaning.rmse < 0.5 * plain.rmse).all()
    assert (leaning.rmse / FULL < 0.02).all()
    nonsense = fitted(runs, prior=truth.normal(size=known.shape) * 1e-9)
    assert (nonsense.rmse < 1.01 * plain.rmse).all()


def test_each_axis_leans_on_the_mechanics_by_itself() -> None:
    """What the mechanics says of Fz is wrong: the others lean on theirs, and Fz is as without."""
    truth = np.random.default_rng(6)
    runs, known = few_loads_for_many_markers(truth)
    known[2] = truth.normal(size=120) * np.abs(known[2]).mean()
    plain, leaning = fitted(runs), fitted(runs, prior=known)
    assert leaning.leaning == ["Fx", "Fy", "Tx", "Ty", "Tz"]
    others = [0, 1, 3, 4, 5]
    assert (leaning.rmse[others] < 0.5 * plain.rmse[others]).all()
    assert leaning.rmse[2] < 1.01 * plain.rmse[2]


def test_memories_follow_their_equation() -> None:
    """After a step held for one time constant, 1 - 1/e of it is forgotten."""
    runs = recordings(1)
    frames = frames_of(runs, 0.0)
    held = np.ones((len(frames.features), 6))
    h = memories(held, frames)
    after = int(0.3 * RATE_HZ)
    assert h[0, after, 0] == pytest.approx(1 - np.exp(-1), abs=0.06)
    both = frames_of([runs[0], replace(runs[0], features=2 * runs[0].features)], 0.0)
    joined = memories(np.concatenate([held, 2 * held]), both)
    assert joined == pytest.approx(np.concatenate([h, 2 * h], axis=1)), "each recording starts from rest"
