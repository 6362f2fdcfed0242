"""Relaxation from a log: what was put in is found, on noisy wrenches of other time steps than the fit's own grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.calibrate.log.reference import write_fit
from ruffini.errors import InputError
from ruffini.estimators.relaxation.fit import RelaxationFit, RelaxationLog, fit_relaxation, read_relaxation
from ruffini.sim.prony import Memory, Prony

PERIOD_S = 1 / 60


def log_of(prony: Prony, modulus_factor: float, seed: int, noise_n: float = 0.0) -> RelaxationLog:
    """Held touches on a pad that relaxes as the twin's do; the estimate is elastic with a wrong modulus."""
    rng = np.random.default_rng(seed)
    elastic, touched = [], []
    for _ in range(6):
        peak = rng.normal(size=6) * [0.3, 0.3, 0.0, 1e-3, 1e-3, 1e-3] + [0, 0, -rng.uniform(0.5, 2.5), 0, 0, 0]
        ramp = np.minimum(np.arange(round(rng.uniform(2, 6) / PERIOD_S)) / 20, 1)
        elastic += [*(ramp[:, None] * peak), *np.zeros((round(rng.uniform(0.5, 2) / PERIOD_S), 6))]
        touched += [True] * len(ramp) + [False] * (len(elastic) - len(touched) - len(ramp))
    memory, real = Memory(prony), []
    for wanted, is_touched in zip(elastic, touched, strict=True):
        memory.begin(PERIOD_S)
        # Between touches nothing acts, and the dent is what makes that so.
        now = np.asarray(wanted) if is_touched else -memory.held / memory.factor * np.ones(6)
        real.append(memory.factor * now + memory.held)
        memory.commit(now)
    reference = np.array(real)
    seen = np.array(elastic) / modulus_factor + rng.normal(size=reference.shape) * noise_n * [1, 1, 1, 0, 0, 0]
    return RelaxationLog(PERIOD_S * np.arange(len(reference)), seen, reference)


def test_what_relaxes_is_found() -> None:
    prony = Prony(((0.12, 0.3), (0.15, 3.0)))
    fit = kept(fit_relaxation, log_of(prony, 1.1, seed=1, noise_n=0.005))
    assert [tau for _, tau in fit.terms] == [0.3, 3.0]
    np.testing.assert_allclose([g for g, _ in fit.terms], [0.12, 0.15], atol=0.02)
    assert fit.gain == pytest.approx(1.1 * prony.scale, rel=0.02)
    assert fit.rmse_after_n < 0.2 * fit.rmse_before_n  # of which the noise is 0.13


def test_times_between_those_tried_are_explained_on_another_log() -> None:
    prony = Prony(((0.1, 0.17), (0.08, 1.7), (0.07, 12.0)))
    fit = kept(fit_relaxation, log_of(prony, 1.0, seed=2, noise_n=0.005))
    other = log_of(prony, 1.0, seed=3)
    again = kept(fit_relaxation, other)
    assert fit.loss == pytest.approx(prony.loss, abs=0.06)
    assert again.rmse_after_n < 0.15 * again.rmse_before_n


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda log: RelaxationLog(log.time_s, log.elastic * np.nan, log.reference), "NaN"),
        (lambda log: RelaxationLog(log.time_s[:60], log.elastic[:60], log.reference[:60]), "hold several touches"),
        (lambda log: RelaxationLog(log.time_s, log.elastic, log.elastic.copy()), "no relaxation"),
        (lambda log: RelaxationLog(log.time_s, log.elastic, -log.reference), "no relaxation"),
    ],
)
def test_a_log_that_cannot_tell_is_refused(change, words: str) -> None:
    with pytest.raises(InputError, match=words):
        fit_relaxation(change(log_of(Prony(((0.2, 1.0),)), 1.0, seed=4)))


def test_the_file_comes_back_and_is_of_one_board(tmp_path: Path) -> None:
    fit = RelaxationFit(1.2, ((0.1, 0.3), (0.05, 10.0)), 0.2, 0.02)
    gelslim = find_board("gelslim")
    write_fit(tmp_path / "r.json", gelslim, fit.report())
    assert read_relaxation(tmp_path / "r.json", gelslim) == fit
    tensors, metadata = fit.tensors()
    assert metadata == {"relaxation.terms": "2"}
    assert tensors["relaxation.time_ms"].tolist() == [300, 10_000]
    with pytest.raises(InputError, match="measured on board"):
        read_relaxation(tmp_path / "r.json", find_board("gelsight-mini"))
    (tmp_path / "r.json").write_text("{}")
    with pytest.raises(InputError, match="no file of"):
        read_relaxation(tmp_path / "r.json", gelslim)
