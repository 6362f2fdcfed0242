"""Of a picture's features that are as at rest no force is stated, where the log shows how they vary at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from kept import kept

from ruffini.estimators.wrench.fit import Fit, fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun, _kind_of
from ruffini.estimators.wrench.model import frames_of
from ruffini.estimators.wrench.rest import rest_gate
from ruffini.evaluate.wrench import on_board

Array = npt.NDArray[np.float64]
GRID = (3, 3, 4)
N_BARE = 6  # features that no press changes
N, N_REST, N_LOADED, N_OBJECTS = 36, 60, 24, 6
DRIFT, NOISE, LOAD = 300.0, 30.0, 6000.0  # of a feature, at most


def squeezed(number: int) -> FeatureRun:
    """Untouched frames in whose light one direction drifts, then one press of its own place to 8 N."""
    rng = np.random.default_rng(number)
    light, place = np.random.default_rng(99).normal(size=N), rng.normal(size=N) + 1
    light[-N_BARE:] = place[-N_BARE:] = 0
    force = np.r_[np.zeros(N_REST), 8 * np.linspace(0.05, 1, N_LOADED)]
    drift = DRIFT * rng.uniform(-1, 1, len(force)).cumsum() / 8
    features = LOAD * (force / 8)[:, None] * place + drift[:, None].clip(-DRIFT, DRIFT) * light
    features = (features + NOISE * rng.normal(size=features.shape)).round()
    wrench = np.zeros((len(force), 6))
    wrench[:, 2] = -force
    time_s = np.arange(len(force)) / 30
    return FeatureRun(f"object_{number}", time_s, features, np.ones(len(force), bool), time_s, wrench,
                      recording=f"object_{number}", kind=f"object_{number}")  # fmt: skip


RUNS = [squeezed(number) for number in range(N_OBJECTS)]


def fitted(runs: list[FeatureRun], grid: tuple[int, int, int] | None) -> Fit:
    return fit_wrench_map(runs, nonlinear=True, grid=grid)


def test_untouched_frames_of_another_object_state_no_force() -> None:
    fit, run = kept(fitted, RUNS[:-1], GRID), RUNS[-1]
    said, free = on_board(fit, frames_of([run], 0.0)), replace(fit.map, rest=None).predicted(frames_of([run], 0.0))
    assert (said.wrench[:N_REST, 2] == 0).mean() > 0.9
    assert np.abs(free[:N_REST, 2]).mean() > 0.005
    loaded = run.reference[:, 2] < -1
    assert (said.wrench[loaded, 2] != 0).all()
    assert (said.sigma[:N_REST, 2] < said.sigma[loaded, 2].min()).mean() > 0.9
    # Tables and integers: a thousandth of full scale.
    assert np.abs(said.wrench - fit.map.predicted(frames_of([run], 0.0))).max() < 8e-3


def test_a_log_without_untouched_frames_has_no_gate() -> None:
    loaded = [replace(r, time_s=r.time_s[N_REST:], features=r.features[N_REST:], is_good=r.is_good[N_REST:],
                      reference_s=r.time_s[N_REST:], reference=r.reference[N_REST:]) for r in RUNS]  # fmt: skip
    frames = frames_of(loaded, 0.0)
    folds = [frames.recording == k for k in np.unique(frames.recording)]
    assert rest_gate(frames.features, frames.wrench, folds) is None


def test_a_gate_that_would_hide_touches_is_not_used() -> None:
    """Flicker of one recording where no press is seen: the map ignores it, but the gate's limit would grow by it."""
    flicker = RUNS[0].features.copy()
    flicker[:, -N_BARE:] += 4 * LOAD * np.random.default_rng(3).normal(size=(len(flicker), N_BARE))
    runs = [replace(RUNS[0], features=flicker), *RUNS[1:]]
    frames = frames_of(runs, 0.0)
    found = rest_gate(frames.features, frames.wrench, [frames.recording == k for k in range(N_OBJECTS)])
    assert found is not None
    assert found.is_untouched[frames.wrench[:, 2] < -2].any()
    assert kept(fitted, runs, GRID).map.rest is None


def test_what_an_untouched_picture_may_hide_is_stated_and_not_how_many_frames_are_at_rest() -> None:
    frames = frames_of(RUNS, 0.0)
    folds = [frames.recording == k for k in range(N_OBJECTS)]
    wrench = frames.wrench.copy()
    wrench[(wrench == 0).all(axis=1).nonzero()[0][::20], 2] = -0.5  # pressed, and the picture shows nothing of it
    for times in (1, 5):  # more frames at rest
        rows = np.concatenate([np.arange(len(wrench)), *[np.flatnonzero((wrench == 0).all(axis=1))] * (times - 1)])
        found = rest_gate(frames.features[rows], wrench[rows], [left[rows] for left in folds])
        assert found is not None
        assert 0.25 < found.gate.error[2] < 0.35


def test_one_kind_of_contact_has_no_gate() -> None:
    """What another kind may hide, it does not tell."""
    one = [replace(run, kind="finger") for run in RUNS]
    assert kept(fitted, one, GRID).map.rest is None


def test_rest_without_noise_and_light_that_differs_by_recording_give_no_gate() -> None:
    frames = frames_of(RUNS, 0.0)
    folds = [frames.recording == k for k in range(N_OBJECTS)]
    unloaded = (frames.wrench == 0).all(axis=1)
    assert rest_gate(np.where(unloaded[:, None], 0.0, frames.features), frames.wrench, folds) is None
    apart = np.zeros((len(unloaded), 2))
    apart[np.arange(len(unloaded)), frames.recording % 2] = 100.0
    halves = [frames.recording % 2 == k for k in range(2)]
    assert rest_gate(apart, frames.wrench, halves) is None


def test_what_pressed_is_the_named_tip_and_logs_without_a_name_are_one_kind() -> None:
    ball, pen = {"shape": "sphere", "radius_m": 3e-3}, {"name": "pen"}
    assert _kind_of({"tip": ball}) == _kind_of({"tip": ball}) != _kind_of({"tip": {**ball, "radius_m": 4e-3}})
    assert len({_kind_of({"tip": tip}) for tip in (ball, pen, None)}) == 3
    assert _kind_of({"tip": None}) == _kind_of({"round": 1})
