"""Landmark kernels: chosen where they pay, the board's integers as the fit, flagged beyond what was fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.calibrate import wrench_kernel
from ruffini.calibrate.feature_log import FeatureRun
from ruffini.calibrate.wrench_map import fit_wrench_map
from ruffini.calibrate.wrench_model import frames_of
from ruffini.evaluate.wrench import on_board

Array = npt.NDArray[np.float64]
FULL = np.array([1.0, 1.0, 8.0, 20.0, 20.0, 20.0])  # N, N mm
TO_N_M = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
N_FEATURES, N_TOUCHES, N_FRAMES = 40, 60, 8


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer frames to learn directions on, and fewer steps: what they cost, not what they find."""
    monkeypatch.setattr(wrench_kernel, "N_SAMPLE", 150)
    monkeypatch.setattr(wrench_kernel, "MAX_STEPS", 15)


def pressed(seed: int, bend: float, size: float = 1.0) -> FeatureRun:
    """Touches without untouched frames of a sensor that stiffens by `bend` under load."""
    rng = np.random.default_rng(seed)
    peak = rng.uniform(-1, 1, (N_TOUCHES, 1, 6)) * FULL * size
    peak[..., 2] = -np.abs(peak[..., 2])
    wrench = (peak * np.linspace(0.3, 1, N_FRAMES)[:, None]).reshape(-1, 6)
    u = wrench / FULL
    soft = u * (1 - bend * np.abs(u)) * (1 + bend * u[:, 2:3])
    makes = np.random.default_rng(0).normal(size=(N_FEATURES, 6)) * 2e4
    features = soft @ makes.T + rng.normal(size=(len(u), N_FEATURES)) * 100
    time_s = 0.05 * np.arange(len(u))
    touch = np.repeat(np.arange(N_TOUCHES), N_FRAMES)
    return FeatureRun(f"made/{seed}", time_s, features.round(), np.ones(len(u), bool), time_s, wrench * TO_N_M,
                      touch=touch)  # fmt: skip


def test_a_kernel_is_used_where_it_pays_and_the_board_says_the_same() -> None:
    fit = fit_wrench_map([pressed(1, 0.3), pressed(2, 0.3)], holdout="touch", nonlinear=True)
    assert fit.kernel is not None
    new = frames_of([pressed(3, 0.3, 0.9)], 0.0)
    said, linear = on_board(fit, new), fit_wrench_map([pressed(1, 0.3), pressed(2, 0.3)], holdout="touch")
    error = np.abs(said.wrench - new.wrench).mean(axis=0)
    assert (error < 0.8 * np.abs(linear.map.predicted(new) - new.wrench).mean(axis=0)).all()
    # Tables and integers: a thousandth of full scale.
    assert (np.abs(said.wrench - fit.map.predicted(new)).max(axis=0) < 1e-3 * FULL).all()
    assert said.is_in_range.mean() > 0.9


def test_twice_the_load_is_flagged_and_less_certain() -> None:
    fit = fit_wrench_map([pressed(1, 0.1), pressed(2, 0.1)], holdout="touch", nonlinear=True)
    assert fit.kernel is not None
    inside, beyond = pressed(3, 0.1, 0.9), frames_of([pressed(4, 0.1, 2.0)], 0.0)
    is_beyond = np.abs(beyond.wrench[:, 2]) > 1.3 * FULL[2]
    said = on_board(fit, beyond)
    assert (~said.is_in_range[is_beyond]).mean() > 0.95
    quiet = on_board(fit, frames_of([inside], 0.0)).sigma.mean(axis=0)
    assert (said.sigma[is_beyond].mean(axis=0) > 1.5 * quiet).all()


def test_a_linear_sensor_gets_none() -> None:
    fit = fit_wrench_map([pressed(1, 0.0), pressed(2, 0.0)], holdout="touch", nonlinear=True)
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
    fit = fit_wrench_map([pressed(1, 0.3), pressed(2, 0.3)], holdout=holdout, nonlinear=True)
    assert fit.kernel is not None
    assert (fit.rmse < fit.linear_rmse).all()
