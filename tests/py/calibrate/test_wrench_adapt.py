"""A new unit takes the calibration of other units, and its own stiffness from few presses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job
from ruffini.errors import InputError
from ruffini.estimators.wrench.adapt import adapt
from ruffini.estimators.wrench.command import WrenchOptions
from ruffini.estimators.wrench.fit import Fit, fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun, Features
from ruffini.estimators.wrench.model import frames_of
from ruffini.estimators.wrench.stage import WRENCH
from ruffini.estimators.wrench.tables import map_in, tables
from ruffini.evaluate.wrench import on_board

GRID = (3, 3, 4)
N, N_STEPS, MOST_N = 36, 8, 4.0
NOISE = 30.0  # of a feature


def unit(number: int, n_presses: int, stiffness: float) -> FeatureRun:
    """Presses to 4 N: the picture changes in proportion to the dent, the force with its power of 1.5."""
    rng = np.random.default_rng(number)
    dent = rng.uniform(0.3, 1, n_presses)[:, None] * np.linspace(0, 1, N_STEPS)
    place = rng.choice([-1, 1], (n_presses, 1)) * np.random.default_rng(0).normal(size=N) / np.sqrt(N)
    features = (6000 * dent[:, :, None] * place[:, None]).reshape(-1, N) + NOISE * rng.normal(size=(dent.size, N))
    wrench = np.zeros((dent.size, 6))
    wrench[:, 2] = -MOST_N * stiffness * dent.ravel() ** 1.5
    time_s = np.arange(dent.size, dtype=float)
    return FeatureRun(f"unit {number}", time_s, features.round(), np.ones(dent.size, bool), time_s, wrench,
                      touch=np.repeat(np.arange(n_presses), N_STEPS), recording=f"unit {number}")  # fmt: skip


def light(run: FeatureRun, part: float) -> FeatureRun:
    """The same presses, so many times as deep and hard."""
    reference = run.reference * part
    return replace(run, features=run.features * part, reference=reference, reference_s=run.time_s)


def shuffled(run: FeatureRun) -> FeatureRun:
    """Its forces, each at another moment of the same press."""
    order = np.concatenate(
        [np.random.default_rng(i).permutation(np.flatnonzero(run.touch == i)) for i in set(run.touch)]
    )
    return replace(run, reference=run.reference[order], reference_s=run.time_s)


def fleet() -> Fit:
    units = [unit(i, 12, 1 + 0.05 * (i - 2)) for i in range(5)]
    return fit_wrench_map(units, holdout="recording", nonlinear=True, grid=GRID)


def test_three_presses_tell_how_stiff_a_new_unit_is() -> None:
    prior, stiffness = kept(fleet).map, 1.3
    fit = adapt([unit(7, 3, stiffness)], prior)
    others = frames_of([unit(8, 30, stiffness)], 0.0)
    before = (prior.predicted(others) - others.wrench)[:, 2]
    after = (fit.map.predicted(others) - others.wrench)[:, 2]
    assert np.sqrt(np.mean(after**2)) < 0.25 * np.sqrt(np.mean(before**2))
    sigma = on_board(fit, others).sigma[:, 2]
    assert (np.abs(after) < sigma).mean() > 0.6
    # On the board's integers: a thousandth of full scale.
    assert np.abs(on_board(fit, others).wrench - fit.map.predicted(others)).max() < 8e-3


def test_stated_errors_grow_with_the_stiffness_and_with_what_this_unit_errs_by() -> None:
    prior = kept(fleet).map
    assert adapt([unit(7, 5, 1.3)], prior).map.error[1, :, 2] == pytest.approx(1.3 * prior.error[1, :, 2], rel=0.02)
    sure, run = replace(prior, error=0.01 * prior.error), unit(7, 30, 1.0)
    of_touch = np.random.default_rng(1).uniform(0.7, 1.3, 30)[run.touch]
    scattered = replace(run, reference=run.reference * of_touch[:, None], reference_s=run.time_s)
    fit, frames = adapt([scattered], sure), frames_of([scattered], 0.0)
    off = np.abs(fit.map.predicted(frames) - frames.wrench)[:, 2]
    assert 0.5 < (off < on_board(fit, frames).sigma[:, 2]).mean() < 0.9


def test_the_tables_of_other_units_are_what_it_begins_with() -> None:
    prior = kept(fleet)
    tensors, metadata = tables(prior, Features("picture", N, GRID))
    read = map_in(CalibrationFile(tensors, {**metadata, "kinds": "wrench"}))
    run = unit(7, 5, 0.8)
    ours, theirs = adapt([run], prior.map), adapt([run], read)
    assert np.abs(ours.map.full - theirs.map.full)[2] < 1e-3
    assert ours.map.full[2] == pytest.approx(0.8 * prior.map.full[2], rel=0.1)
    assert (ours.map.full[[0, 1, 3, 4, 5]] == 0).all()


def test_a_fit_with_a_prior_begins_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    board = find_board("digit-tactile")
    monkeypatch.setattr("ruffini.estimators.wrench.stage.read_feature_runs", lambda *_, **__: [unit(7, 3, 1.3)])
    tensors, metadata = tables(kept(fleet), Features("picture", N, GRID))
    job = Job(board, [], other_units=CalibrationFile(tensors, {**metadata, "kinds": "wrench"}))
    outcome = WRENCH.fit(job, lambda _: None)
    assert "forces are those of the units of --prior, times 1.29" in outcome.remarks[0]
    alone = WRENCH.fit_alone(job, WrenchOptions(), lambda _: None)
    assert alone.report["axes"]["Fz"] == outcome.report["axes"]["Fz"]
    with pytest.raises(InputError, match="only 3 touches: 5 are needed"):
        WRENCH.fit(replace(job, other_units=None), lambda _: None)


@pytest.mark.parametrize(
    ("run", "said"),
    [
        (unit(7, 2, 1.0), "numbers 2 touches, and 3 are needed"),
        (unit(7, 5, 3.0), "is not like those"),
        (light(unit(7, 5, 1.0), 0.05), "fewer than 3 touches load Fz"),
        (shuffled(unit(7, 8, 1.3)), "explains .* % of it: this unit is not like those"),
        (replace(unit(7, 5, 1.0), reference=np.zeros((40, 6))), "fewer than 3 touches load Fz"),
        (replace(unit(7, 5, 1.0), features=np.zeros((40, N + 3))), "give a calibration of the same board"),
        (replace(unit(7, 5, 1.0), features=np.random.default_rng(0).normal(0, 6000, (40, N))), "is not like those"),
    ],
)  # fmt: skip
def test_a_unit_that_is_not_like_those_is_refused(run: FeatureRun, said: str) -> None:
    if said.startswith("fewer than"):
        run = replace(run, reference_s=run.time_s)
    with pytest.raises(InputError, match=said):
        adapt([run], kept(fleet).map)
