"""Landmark kernels: chosen where they pay, the board's integers as the fit, flagged beyond what was fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.estimators.wrench import fit as wrench_fit
from ruffini.estimators.wrench import kernel as wrench_kernel
from ruffini.estimators.wrench import kernel_choice as wrench_kernel_choice
from ruffini.estimators.wrench.fit import Fit, fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun
from ruffini.estimators.wrench.model import Frames, frames_of
from ruffini.evaluate.wrench import on_board

Array = npt.NDArray[np.float64]
FULL = np.array([1.0, 1.0, 8.0, 20.0, 20.0, 20.0])  # N, N mm
TO_N_M = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
N_FEATURES, N_TOUCHES, N_FRAMES = 40, 60, 5
SIZES = list(wrench_kernel.SIZES)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer frames to learn directions on, and fewer steps: what they cost, not what they find."""
    monkeypatch.setattr(wrench_kernel, "N_BLOCK", 150)
    monkeypatch.setattr(wrench_kernel, "MAX_STEPS", 15)


def pressed(seed: int, bend: float, size: float = 1.0, n_frames: int = N_FRAMES) -> FeatureRun:
    """Touches without untouched frames of a sensor that stiffens by `bend` under load."""
    rng = np.random.default_rng(seed)
    peak = rng.uniform(-1, 1, (N_TOUCHES, 1, 6)) * FULL * size
    peak[..., 2] = -np.abs(peak[..., 2])
    wrench = (peak * np.linspace(0.3, 1, n_frames)[:, None]).reshape(-1, 6)
    u = wrench / FULL
    soft = u * (1 - bend * np.abs(u)) * (1 + bend * u[:, 2:3])
    makes = np.random.default_rng(0).normal(size=(N_FEATURES, 6)) * 2e4
    features = soft @ makes.T + rng.normal(size=(len(u), N_FEATURES)) * 100
    time_s = 0.05 * np.arange(len(u))
    touch = np.repeat(np.arange(N_TOUCHES), n_frames)
    return FeatureRun(f"made/{seed}", time_s, features.round(), np.ones(len(u), bool), time_s, wrench * TO_N_M,
                      touch=touch)  # fmt: skip


def fitted(runs: list[FeatureRun], holdout: str, *, nonlinear: bool, grid: tuple[int, int, int] | None = None) -> Fit:
    """With what `_small` says, which is of this file: `kept` knows it."""
    return fit_wrench_map(runs, holdout=holdout, nonlinear=nonlinear, grid=grid)


def test_a_kernel_is_used_where_it_pays_and_the_board_says_the_same() -> None:
    fit = kept(fitted, [pressed(1, 0.3), pressed(2, 0.3)], "touch", nonlinear=True)
    assert fit.kernel is not None
    new = frames_of([pressed(3, 0.3, 0.9)], 0.0)
    said, linear = on_board(fit, new), kept(fitted, [pressed(1, 0.3), pressed(2, 0.3)], "touch", nonlinear=False)
    error = np.abs(said.wrench - new.wrench).mean(axis=0)
    assert (error < 0.8 * np.abs(linear.map.predicted(new) - new.wrench).mean(axis=0)).all()
    # Tables and integers: a thousandth of full scale.
    assert (np.abs(said.wrench - fit.map.predicted(new)).max(axis=0) < 1e-3 * FULL).all()
    assert said.is_in_range.mean() > 0.9


def test_twice_the_load_is_flagged_and_less_certain() -> None:
    fit = kept(fitted, [pressed(1, 0.1), pressed(2, 0.1)], "touch", nonlinear=True)
    assert fit.kernel is not None
    inside, beyond = pressed(3, 0.1, 0.9), frames_of([pressed(4, 0.1, 2.0)], 0.0)
    is_beyond = np.abs(beyond.wrench[:, 2]) > 1.3 * FULL[2]
    said = on_board(fit, beyond)
    assert (~said.is_in_range[is_beyond]).mean() > 0.95
    quiet = on_board(fit, frames_of([inside], 0.0)).sigma.mean(axis=0)
    assert (said.sigma[is_beyond].mean(axis=0) > 1.5 * quiet).all()


def test_a_linear_sensor_gets_none() -> None:
    fit = kept(fitted, [pressed(1, 0.0), pressed(2, 0.0)], "touch", nonlinear=True)
    assert fit.kernel is None


def test_a_curve_that_is_no_covariance_is_solved_all_the_same() -> None:
    """A table that is straight between its entries is not quite one; this one, a box, is far from it."""
    frames = frames_of([pressed(1, 0.3)], 0.0)
    shape = wrench_kernel.candidates(frames.features, frames.wrench, frames.touch)[0]
    box = replace(shape, curve=(np.arange(len(shape.curve)) < wrench_kernel.STEPS // 8).astype(float))
    gain, kernel = wrench_kernel.solve(frames.features, frames.wrench, box)
    error = np.abs(frames.features @ gain.T + kernel.added(frames.features) - frames.wrench).mean(axis=0)
    assert (error < 0.1 * FULL).all()


@pytest.mark.parametrize("holdout", ["recording", "block"])
def test_recordings_and_blocks_of_time_are_left_out(holdout: str) -> None:
    fit = kept(fitted, [pressed(1, 0.3), pressed(2, 0.3)], holdout, nonlinear=True)
    assert fit.kernel is not None
    assert (fit.rmse < fit.linear_rmse).all()


def test_directions_that_bend_the_wrench_are_short_and_a_noisy_axis_is_smoothed_more() -> None:
    rng, n = np.random.default_rng(5), 450
    way = np.linalg.qr(rng.normal(size=(N_FEATURES, 3)))[0]
    place = rng.uniform(-1, 1, (n, 3))
    noise = np.array([0.02, 0.02, 0.02, 0.02, 0.02, 0.3])
    wrench = np.sin(3 * place[:, :1]) + rng.normal(size=(n, 6)) * noise
    features = place * [1e5, 2e5, 3e5] @ way.T + rng.normal(size=(n, N_FEATURES)) * 10
    narrow = wrench_kernel.candidates(features, wrench, np.arange(n) // N_FRAMES)[1]
    bending, *idle = np.linalg.norm(narrow.project @ way, axis=0)
    assert bending > 3 * max(idle)
    assert narrow.noise[5] > 20 * narrow.noise[:5].max()


def test_the_narrow_curve_is_the_one_that_its_lengths_were_learned_with() -> None:
    """Halving a Gaussian's length is its fourth power: the table has the same sum, to its steps."""
    curve = wrench_kernel.candidates(*_few_frames())[1].curve
    at = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 5.0])
    parts = [(4.0, 32.0), (2.0, 5.65685425), (1.0, 1.0), (0.5, 0.176776695), (0.25, 0.03125)]
    sum_ = sum(part * np.exp(-((at / length) ** 2) / 2) for length, part in parts)
    assert curve[(wrench_kernel.STEPS * at).astype(int)] == pytest.approx(sum_ / 38.8648809, abs=1e-6)
    assert wrench_kernel._bells(at[:, None])[0][0] == pytest.approx(sum_ / 38.8648809, abs=1e-6)


def _few_frames() -> tuple[Array, Array, npt.NDArray[np.intp]]:
    frames = frames_of([pressed(1, 0.3)], 0.0)
    return frames.features, frames.wrench, frames.touch


def test_each_axis_is_smoothed_by_its_own_noise() -> None:
    features, wrench, touch = _few_frames()
    shape = wrench_kernel.candidates(features, wrench, touch)[1]
    gain, kernel = wrench_kernel.solve(features, wrench, replace(shape, noise=np.array([1e-4] * 5 + [1e6])))
    said = features @ gain.T + kernel.added(features)
    error = np.abs(said - wrench).mean(axis=0) / wrench.std(axis=0)
    assert (error[:5] < 0.1).all()
    assert said[:, 5].std() < 0.1 * wrench[:, 5].std()


def test_touches_beyond_half_of_the_largest_force_are_heavy() -> None:
    frames = frames_of([pressed(1, 0.1)], 0.0)
    force, left = np.linalg.norm(frames.wrench[:, :3], axis=1), wrench_kernel_choice.heavy(frames, frames.touch)
    assert force[~left].max() <= 0.5 * force.max() < force[left].max()
    assert not set(frames.touch[left]) & set(frames.touch[~left])
    assert (force[left] < 0.5 * force.max()).any()  # the touch goes as a whole


@pytest.mark.parametrize(("must_extrapolate", "name"), [(False, "narrow"), (True, "wide")])
def test_where_no_fold_presses_harder_the_heaviest_touches_choose(
    must_extrapolate: bool, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The narrow kernel errs less on the folds, the wide one beyond the loads that it was fitted on."""
    frames = frames_of([pressed(1, 0.1)], 0.0)
    is_heavy = wrench_kernel_choice.heavy(frames, frames.touch)

    def left_out(
        _: Frames, __: object, folds: list[npt.NDArray[np.bool_]], names: list[str], ___: object
    ) -> tuple[list[Array], list[Array]]:
        assert names == ["wide", "narrow"]
        parts = (0.1, 0.3) if len(folds) == 1 and (folds[0] == is_heavy).all() else (0.2, 0.1)
        return [part * frames.wrench for part in parts], [np.ones(len(frames.wrench)) for _ in parts]

    monkeypatch.setattr(wrench_kernel_choice, "_left_out", left_out)
    folds = [frames.touch % 2 == 0, frames.touch % 2 == 1]
    linear = 0.5 * frames.wrench
    chosen = wrench_kernel_choice.choose_kernel(frames, frames.touch, folds, linear, must_extrapolate=must_extrapolate)
    assert chosen is not None
    assert chosen.name == name
    assert chosen.errors == pytest.approx((0.2 if must_extrapolate else 0.1) * frames.wrench)  # of the folds
    worse = wrench_kernel_choice.choose_kernel(
        frames, frames.touch, folds, 0.05 * frames.wrench, must_extrapolate=must_extrapolate
    )
    assert worse is None


def test_few_touches_tell_no_relevance_and_get_a_smooth_kernel_without_k() -> None:
    few = wrench_kernel.LEAST_TOUCHES - 1
    names = wrench_kernel.shape_names(np.repeat(np.arange(few), 5))
    assert names[0] == "wide"
    assert len(names) > 2
    assert wrench_kernel.shape_names(np.repeat(np.arange(few + 1), 5)) == ["wide", "narrow"]
    frames = frames_of([pressed(1, 0.3)], 0.0)
    found = wrench_kernel.candidates(frames.features, frames.wrench, frames.touch, names[1:])
    assert [shape.name for shape in found] == names[1:]
    for shape in found:
        gain, kernel = wrench_kernel.solve(frames.features, frames.wrench, shape)
        assert not gain.any()
        error = np.abs(kernel.added(frames.features) - frames.wrench).mean(axis=0)
        assert (error < 0.1 * FULL).all()
        assert (error > 0.001 * FULL).all()  # it follows no noise of the features


def test_sigma_follows_held_out_errors_light_and_heavy_and_no_outlier() -> None:
    """Of a kernel's map the moments of rest and load are a start: here they are 10 times too small and too large."""
    rng, n = np.random.default_rng(2), 4000
    size2 = rng.uniform(0, 1, n) ** 2
    truth = np.sqrt(0.1**2 + 2.0**2 * size2)[:, None] * np.ones(6)
    errors = rng.normal(size=(n, 6)) * truth
    errors[:8] = 100.0
    start = np.stack([0.01 * np.eye(6), 20.0 * np.eye(6)])
    folds = [np.arange(n) % 5 == k for k in range(5)]
    found = wrench_fit._as_left_out(start, errors, size2, folds)
    sigma = np.sqrt((found[0] ** 2).sum(axis=0) + size2[:, None] * (found[1] ** 2).sum(axis=0))
    for part in (size2 < 0.002, size2 > 0.5):
        assert np.median(sigma[part] / truth[part], axis=0) == pytest.approx(np.ones(6), rel=0.2)


def test_a_glitch_of_the_reference_does_not_choose_the_kernel_of_few_touches(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel errs half as much as K but in one frame, where it is far from what the reference says."""
    frames = frames_of([pressed(1, 0.1, n_frames=8)], 0.0)
    touch = frames.touch // 2
    errors = 0.1 * frames.wrench
    kernel_errors = 0.5 * errors
    kernel_errors[0] = 5 * FULL

    def left_out(*_: object) -> tuple[list[Array], list[Array]]:
        return [kernel_errors, 2 * errors], [np.ones(len(errors))] * 2

    monkeypatch.setattr(wrench_kernel_choice, "_left_out", left_out)
    chosen = wrench_kernel_choice.choose_kernel(frames, touch, [touch == 0], errors, must_extrapolate=False)
    assert chosen is not None
    assert chosen.name == "wide"
    assert (
        wrench_kernel_choice.choose_kernel(frames, frames.touch, [touch == 0], errors, must_extrapolate=False) is None
    )


def dents(seed: int, n_touches: int, part: float = 1.0) -> FeatureRun:
    """Presses of one ball on 9 x 7 cells, each at a place of its own: slopes left and right of it cancel in sum."""
    rng, (y, x) = np.random.default_rng(seed), np.mgrid[:7, :9]
    rows, force = [], []
    for _ in range(n_touches):
        at_x, at_y = rng.uniform(2, 6), rng.uniform(2, 4)
        for force_n in np.r_[np.zeros(3), part * rng.uniform(0.5, 1) * np.linspace(0.1, 1, N_FRAMES)]:
            bell = force_n**0.7 * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / 2)
            rows.append(np.r_[((x - at_x) * bell).ravel(), ((y - at_y) * bell).ravel()])
            force.append(force_n)
    features = 2e4 * np.array(rows) + rng.normal(size=(len(rows), 126)) * 100
    wrench = np.zeros((len(rows), 6))
    wrench[:, 2] = -np.array(force)
    time_s = 0.05 * np.arange(len(rows))
    touch = np.repeat(np.arange(n_touches), N_FRAMES + 3)
    return FeatureRun(f"dents/{seed}", time_s, features.round(), np.ones(len(rows), bool), time_s, wrench, touch=touch)


@pytest.mark.parametrize("n_touches", [8, 24])  # fewer frames than other kernels ask for, and more
def test_the_size_of_a_dent_tells_its_force_wherever_it_is(n_touches: int) -> None:
    fit = kept(fitted, [dents(1, n_touches)], "touch", nonlinear=True, grid=(2, 7, 9))
    assert fit.kernel in SIZES
    assert fit.rmse[2] < 0.05 * fit.map.full[2]
    new = frames_of([dents(2, 30)], 0.0)
    said = on_board(fit, new)
    assert np.abs(said.wrench - new.wrench)[:, 2].max() < 0.12
    assert (np.abs(said.wrench - fit.map.predicted(new)).max(axis=0) < 1e-3).all()
    assert said.is_in_range.mean() > 0.97
    harder = on_board(fit, frames_of([dents(3, 10, 2.0)], 0.0))
    is_harder = new.wrench[:, 2].min() * 1.3 > frames_of([dents(3, 10, 2.0)], 0.0).wrench[:, 2]
    assert not harder.is_in_range[is_harder].any()


def test_one_log_does_not_claim_to_know_other_kinds_of_contact() -> None:
    one = kept(fitted, [dents(1, 8)], "touch", nonlinear=True, grid=(2, 7, 9))
    logs = [replace(dents(k, 8), kind=f"ball {k}") for k in range(1, 6)]
    five = kept(fitted, logs, "recording", nonlinear=True, grid=(2, 7, 9))
    same = kept(fitted, [replace(log, kind="ball 1") for log in logs], "recording", nonlinear=True, grid=(2, 7, 9))
    assert [line for line in one.checks if "1 of 5 kinds of contact" in line]
    assert not [line for line in five.checks if "kinds of contact" in line]
    new = frames_of([dents(9, 10)], 0.0)
    is_pressed = new.wrench[:, 2] < -0.3 * one.map.full[2]
    force = -new.wrench[is_pressed, 2]
    part = [(on_board(fit, new).sigma[is_pressed, 2] / force).mean() for fit in (one, same, five)]
    assert all(0.45 < of_one_kind < 0.6 for of_one_kind in part[:2])
    assert part[2] < 0.1


def test_a_dozen_readings_of_a_scale_are_enough() -> None:
    """One row at rest and one of the hold each."""
    whole = dents(1, 12)
    rows = np.flatnonzero(np.isin(np.arange(len(whole.time_s)) % (N_FRAMES + 3), (0, N_FRAMES + 2)))
    time_s = whole.time_s[rows]
    assert whole.touch is not None
    run = replace(whole, time_s=time_s, features=whole.features[rows], is_good=whole.is_good[rows], reference_s=time_s,
                  reference=whole.reference[rows], touch=whole.touch[rows])  # fmt: skip
    fit = kept(fitted, [run], "touch", nonlinear=True, grid=(2, 7, 9))
    assert fit.kernel in SIZES
    assert fit.lag_s == 0
    new = frames_of([dents(2, 30)], 0.0)
    assert np.abs(on_board(fit, new).wrench - new.wrench)[:, 2].max() < 0.15


def test_more_features_than_its_table_takes_have_no_size() -> None:
    touch = np.arange(400)
    assert set(SIZES) < set(wrench_kernel.shape_names(touch, (3, 8, 16)))
    assert not set(SIZES) & set(wrench_kernel.shape_names(touch, (1, 5, 77)))
