"""The stated error of a map of few features: noise beside light touches, and coverage where the reference is noisy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from kept import kept

from ruffini.estimators.wrench.few_features import FittedFrames, noise_of_untouched, stated
from ruffini.estimators.wrench.fit import fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun
from ruffini.estimators.wrench.model import TO_NMM, Frames, frames_of

N_FEATURES, N_REST, N_FRAMES, RATE_HZ = 9, 6, 40, 30.0
FULL = np.array([1.0, 1.0, 8.0, 20.0, 20.0, 20.0])  # N, N mm
NOISE, MOVED = 1500.0, 2.0  # raw units; times as much once a target has moved
REFERENCE = np.array([3e-3, 3e-3, 0.085, 0.25, 1.18, 0.4])  # N, N mm: of some, several times the map's error


def test_noise_is_told_from_light_touches() -> None:
    rng = np.random.default_rng(2)
    sigma = np.array([1.0, 3.0, 0.2])
    noise = rng.normal(size=(150, 3)) * sigma
    touched = rng.normal(size=(200, 3)) * sigma + rng.uniform(-1, 1, (200, 1)) * [4.0, 8.0, 12.0]
    found = noise_of_untouched(np.concatenate([noise, touched]))
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(sigma, rel=0.25)
    assert found.weight[:150].mean() > 0.9
    assert found.weight[150:].mean() < 0.3


@pytest.mark.parametrize("n", [20, 40, 100, 300])
def test_noise_alone_is_all_noise(n: int) -> None:
    for seed in range(20):
        rows = np.random.default_rng(seed).normal(size=(n, 6)) * np.arange(1, 7)
        found = noise_of_untouched(rows)
        assert (found.weight == 1).all()
        assert found.covariance == pytest.approx(rows.T @ rows / n, rel=1e-6, abs=1e-6)


def rest_and_load(size: float, *, reference: float, moved: float) -> tuple[FittedFrames, Frames]:
    """200 frames at rest and 200 under a load, of an exact map of noise 1; deviations of the reference's noise, and of
    the features' under load over that at rest.
    """
    rng, n = np.random.default_rng(4), 400
    is_loaded = np.arange(n) >= n // 2
    sizes = np.where(is_loaded, size, 0.0)
    noise = rng.normal(size=(n, N_FEATURES)) * np.where(is_loaded, moved, 1.0)[:, None]
    seen = FittedFrames(rng.normal(size=(n, 6)), sizes, noise, reference * rng.normal(size=(n, 6)), is_loaded)
    one_run = np.zeros(n, np.intp)
    degrees = frames_of(recordings(0, 1), 0.0).degrees
    return seen, Frames(noise, np.zeros((n, 6)), np.arange(n) / RATE_HZ, one_run, degrees, one_run, one_run)


@pytest.mark.parametrize("size", [0.3, 0.9])
def test_a_moved_target_is_noisier_also_in_a_log_of_heavy_loads_alone(size: float) -> None:
    constant, _ = stated(*rest_and_load(size, reference=0.0, moved=3.0), np.ones(6), N_FEATURES)
    assert np.sqrt(np.diag(constant)) == pytest.approx(np.full(6, 3.0), rel=0.2)


def test_what_the_references_noise_leaves_in_the_terms_is_stated() -> None:
    n_terms, size, reference = 100, 0.7, 10.0
    _, growing = stated(*rest_and_load(size, reference=reference, moved=1.0), np.ones(6), n_terms)
    standard_error = reference * np.sqrt(n_terms / 400 / (size**2 / 2))
    assert np.sqrt(np.diag(growing)) == pytest.approx(np.full(6, standard_error), rel=0.2)


def recordings(first: int, n: int) -> list[FeatureRun]:
    """Pushes, held and released, of a linear sensor; the reference is read beside each frame."""
    made_by = np.random.default_rng(1).normal(size=(N_FEATURES, 6)) * 5e5 / FULL
    out = []
    for k in range(first, first + n):
        rng = np.random.default_rng(500 + k)
        way = np.sin(np.pi * np.arange(N_FRAMES) / N_FRAMES) ** 2
        wrench = np.concatenate([np.zeros(N_REST), way])[:, None] * rng.uniform(-1, 1, 6) * FULL
        noise = np.where(np.abs(wrench / FULL).max(axis=1) > 0.01, MOVED, 1.0)[:, None] * NOISE
        features = wrench @ made_by.T + rng.normal(size=(len(wrench), N_FEATURES)) * noise
        time_s = np.arange(len(wrench)) / RATE_HZ
        read = wrench + rng.normal(size=wrench.shape) * REFERENCE
        out.append(FeatureRun(f"made/{k}", time_s, features, np.ones(len(wrench), bool), time_s, read / TO_NMM))
    return out


def exact(run: FeatureRun) -> np.ndarray:
    """The load of a recording, (t, 6) N and N mm."""
    k = int(run.name.split("/")[1])
    way = np.sin(np.pi * np.arange(N_FRAMES) / N_FRAMES) ** 2
    return np.asarray(
        np.concatenate([np.zeros(N_REST), way])[:, None] * np.random.default_rng(500 + k).uniform(-1, 1, 6) * FULL
    )


def test_truths_are_covered_although_the_reference_is_noisier_than_the_map() -> None:
    """Loaded frames of recordings that nothing was fitted on: 60 to 76 % within one sigma, 92 to 98 % within two.

    Over several logs: in one of them the error that the reference's noise leaves in K is the same in every frame.
    """
    new = recordings(1000, 20)
    frames, truth = frames_of(new, 0.0), np.concatenate([exact(run) for run in new])
    ratios = []
    for first in range(0, 240, 40):
        fit = kept(fit_wrench_map, recordings(first, 40))
        said = fit.map.predicted(frames)
        u = fit.map.scaled(said)
        size2, sigma = (u**2).sum(axis=1), fit.map.sigma(u)
        assert (1.5 * np.median(sigma, axis=0) < REFERENCE).sum() >= 3, "the reference is the noisier one"
        ratios.append((np.abs(said - truth) / sigma)[size2 > 0.01])
    one, two = (100 * (np.concatenate(ratios) < k).mean(axis=0) for k in (1, 2))
    assert 60 < one.mean() < 76
    assert 92 < two.mean() < 98
    assert one.min() > 60
    assert one.max() < 80
    assert two.min() > 92
    assert two.max() < 99


def test_a_log_that_loads_each_axis_once_states_no_more_than_it_errs_by() -> None:
    """With a recording left out nothing loads its axis: that error is of the fold, not of the map."""
    runs = []
    for axis, run in enumerate(recordings(0, 6)):
        alone = np.arange(6) == axis
        load = exact(run)
        made_by = np.random.default_rng(1).normal(size=(N_FEATURES, 6)) * 5e5 / FULL
        own = np.where(alone, np.abs(load).max(axis=1, keepdims=True) / np.abs(load).max() * FULL, 0.0)
        rng = np.random.default_rng(axis)
        features = own @ made_by.T + rng.normal(size=run.features.shape) * NOISE
        reference = (own + rng.normal(size=own.shape) * REFERENCE) / TO_NMM
        runs.append(replace(run, features=features, reference=reference))
    fit = kept(fit_wrench_map, [replace(run, name=f"{run.name}/{k}") for k in range(4) for run in runs])
    assert (np.sqrt((fit.map.error[1] ** 2).sum(axis=0)) < 0.05 * FULL).all()
