"""The error model: it finds what errors are made of, never says zero, and carries a wrench's covariance as a wrench."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.fem.uncertainty import (
    QUIET_LEVELS,
    REPORTED_LEVELS,
    ContactLoad,
    NodeError,
    NodeSample,
    WrenchError,
    WrenchSample,
    fit_node_error,
    fit_variance,
    fit_wrench_error,
    node_sigma,
    wrench_covariance,
)

THRESHOLD = 300.0
RNG_SEED = 12
WRENCH_ERROR = WrenchError(
    force_n=np.array([0.002, 0.007]),
    moment_nm=np.array([8e-6, 2e-6]),
    lever_m=np.array([20e-6, 4e-6]),
    factor=np.array([0.02, 0.025]),
    crosstalk=3e-3,
)


def samples(n: int, rng: np.random.Generator) -> list[NodeSample]:
    """Bumps whose error is Gaussian of 5 % of the force along that axis and 40 steps, on pressed nodes only."""
    out = []
    y, x = np.mgrid[:15, :17]
    for _ in range(n):
        center, radius = rng.uniform(5, 9, 2), rng.uniform(2.5, 4.5)
        bump = np.maximum(1 - ((y - center[0]) ** 2 + (x - center[1]) ** 2) / radius**2, 0)
        estimate = np.round(bump[..., None] * np.array([900.0, -500.0, -4000.0]) * rng.uniform(0.5, 1.0))
        error = np.hypot(40, 0.05 * estimate) * rng.normal(size=estimate.shape) * (bump > 0)[..., None]
        out.append(NodeSample(estimate, estimate - error))
    return out


def test_a_variance_is_found_again() -> None:
    rng = np.random.default_rng(RNG_SEED)
    reading = rng.uniform(0, 10, 40_000)
    design = np.stack([np.ones_like(reading), reading**2], axis=1)
    error = np.sqrt(design @ [4.0, 0.09]) * rng.normal(size=len(reading))
    np.testing.assert_allclose(fit_variance(design, error), [4.0, 0.09], rtol=0.1)
    np.testing.assert_allclose(fit_variance(design[:, 1:], error, np.full(len(reading), 4.0)), [0.09], rtol=0.1)


def test_heavy_tails_are_covered_to_68_and_95_percent_within_their_shape() -> None:
    rng = np.random.default_rng(RNG_SEED)
    error = rng.standard_t(6, 20_000)
    sigma = np.sqrt(fit_variance(np.ones((len(error), 1)), error)[0])
    assert np.mean(np.abs(error) < sigma) == pytest.approx(0.6827, abs=0.05)
    assert np.mean(np.abs(error) < 2 * sigma) == pytest.approx(0.9545, abs=0.05)


def test_fitted_sigma_covers_errors_that_it_was_not_fitted_on() -> None:
    rng = np.random.default_rng(RNG_SEED)
    model = fit_node_error(samples(40, rng), THRESHOLD)
    within = np.zeros((2, 2))
    n = 0
    for sample in samples(20, rng):
        sigma = node_sigma(model, sample.estimate, THRESHOLD)
        pressed = sample.estimate[..., 2] < 0
        ratio = np.abs(sample.estimate - sample.truth)[pressed] / sigma[pressed]
        within += [[(ratio[:, :2] < k).sum() / 2 for k in (1, 2)], [(ratio[:, 2] < k).sum() for k in (1, 2)]]
        n += int(pressed.sum())
    np.testing.assert_allclose(within / n, [[0.6827, 0.9545]] * 2, atol=0.04)


def test_every_node_has_a_sigma_above_zero_and_faint_touches_are_not_ruled_out() -> None:
    model = fit_node_error(samples(40, np.random.default_rng(RNG_SEED)), THRESHOLD)
    sigma = node_sigma(model, np.zeros((6, 7, 3)), THRESHOLD)
    assert (sigma > 0).all()
    assert (node_sigma(model, 1e6 * np.ones((6, 7, 3)) * [0.1, 0, -1], THRESHOLD) > 0).all()


def test_each_term_reads_the_field_as_written() -> None:
    """One term at a time, on a single pressed node of a quiet field."""
    steps = np.zeros((5, 5, 3))
    steps[2, 2] = (80, 0, -150)  # bit width of 150: 8; half the threshold: weight 1/2
    steps[2, 3] = (16, 0, 0)

    def sigma_of(**terms: object) -> np.ndarray:
        parts = {"reported": np.zeros((2, REPORTED_LEVELS)), "quiet": np.zeros((2, QUIET_LEVELS)),
                 "local": np.zeros((2, 4))}  # fmt: skip
        for name, (index, value) in terms.items():
            parts[name][index] = value
        return node_sigma(NodeError(**parts), steps, THRESHOLD)

    reported = sigma_of(reported=((1, 7), 49.0))
    assert reported[2, 2, 2] == 7
    assert np.count_nonzero(reported) == 1
    quiet = sigma_of(quiet=((0, 4), 9.0))  # beside 150: (8 + 1) / 2
    assert quiet[1, 1, 0] == quiet[3, 3, 1] == quiet[2, 3, 0] == 3
    assert quiet[2, 2, 0] == quiet[0, 0, 0] == 0
    assert sigma_of(local=((0, 0), 0.25))[2, 2, 0] == 40
    # Contrast: 80 - 16 / 8 = 78, at half weight.
    assert sigma_of(local=((0, 1), 2.0))[2, 2, 0] == pytest.approx(78)
    assert sigma_of(local=((0, 1), 2.0))[2, 3, 0] == 0
    # Largest step: 80 at the node, 80 - 16 at the other one, which has no pressure of its own, 80 beside.
    step = sigma_of(local=((0, 2), 1.0))
    assert (step[2, 2, 0], step[2, 3, 0], step[1, 1, 0], step[0, 0, 0]) == (80, 64, 80, 0)
    # Roughness: the pressure's contrast, 150 at the node and 150 / 8 at its eight neighbours, at half weight.
    rough2 = (150**2 + 8 * (150 / 8) ** 2) / 64
    assert sigma_of(local=((1, 3), 2.0))[2, 2, 2] == pytest.approx(rough2**0.5)
    assert sigma_of(local=((1, 3), 2.0))[2, 3, 2] == 0


def test_a_field_that_is_never_pressed_is_refused() -> None:
    nothing = NodeSample(np.zeros((5, 5, 3)), np.zeros((5, 5, 3)))
    with pytest.raises(InputError, match="press next to no node"):
        fit_node_error([nothing] * 10, THRESHOLD)
    with pytest.raises(InputError, match="at least 20"):
        fit_wrench_error([WrenchSample(np.ones(6), np.ones(6))] * 3)


def test_covariance_is_that_of_contacts_whose_errors_are_drawn() -> None:
    """Against a plain simulation: each contact errs about its own centre, the material errs for all at once."""
    rng = np.random.default_rng(RNG_SEED)
    loads = [ContactLoad(np.array([3e-3, -2e-3]), np.array([0.3, 0.1, -1.5])),
             ContactLoad(np.array([-4e-3, 1e-3]), np.array([0.0, -0.2, -0.6]))]  # fmt: skip
    n, total, wrench = 200_000, np.zeros((200_000, 6)), np.zeros(6)

    def about_center(load: ContactLoad, force: np.ndarray, moment: np.ndarray) -> np.ndarray:
        arm = np.array([*load.center_m, 0.0])
        return np.concatenate([force, moment + np.cross(arm, force)], axis=-1)

    for load in loads:
        sigma_m = np.hypot(WRENCH_ERROR.moment_nm, WRENCH_ERROR.lever_m * load.force_n[2])[[0, 0, 1]]
        force = rng.normal(size=(n, 3)) * WRENCH_ERROR.force_n[[0, 0, 1]]
        force[:, :2] += WRENCH_ERROR.crosstalk * load.force_n[2] * rng.normal(size=(n, 2))
        total += about_center(load, force, rng.normal(size=(n, 3)) * sigma_m)
        wrench += about_center(load, load.force_n, np.zeros(3))
    shear, pressure = wrench * [1, 1, 0, 0, 0, 1], wrench * [0, 0, 1, 1, 1, 0]
    total += 0.02 * rng.normal(size=(n, 1)) * shear + 0.025 * rng.normal(size=(n, 1)) * pressure
    expected = np.cov(total.T)
    found = wrench_covariance(WRENCH_ERROR, wrench, loads)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.015)
    assert np.linalg.eigvalsh(found / scale).min() > 0


def test_wrench_error_is_found_again() -> None:
    rng = np.random.default_rng(RNG_SEED)
    drawn = []
    for _ in range(4000):
        wrench = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, -0.2), 0, 0, rng.uniform(-1e-3, 1e-3)])
        own = wrench_covariance(WRENCH_ERROR, wrench, [ContactLoad(np.zeros(2), wrench[:3])])
        drawn.append(WrenchSample(wrench, rng.multivariate_normal(np.zeros(6), own)))
    found = fit_wrench_error(drawn)
    for name in ("force_n", "moment_nm", "lever_m", "factor", "crosstalk"):
        np.testing.assert_allclose(getattr(found, name), getattr(WRENCH_ERROR, name), rtol=0.2)
