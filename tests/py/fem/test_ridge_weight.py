"""The rules for the ridge weight: their own formulas on one mode, what they choose where the answer is known."""

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.fem.condense import CondensedSlab, condense, surface_stiffness
from ruffini.fem.operators import Noise, ridge_operator
from ruffini.fem.ridge_weight import WEIGHTS, WeightCurve, curve_of, weight_curve
from ruffini.fem.slab import Slab
from ruffini.reflection import dense_from_blocks, spd_inverse

SLAB = Slab(10e-3, 8e-3, 4e-3, 9, 7, 3, 2e5, 0.48)


def noisy_push(condensed: CondensedSlab, sigma_m: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    force = np.zeros((7, 9, 3))
    force[2:5, 3:6] = (0.004, -0.002, -0.02)
    u = compliance @ force.ravel() + rng.normal(size=force.size) * sigma_m
    return u[:, None], force.reshape(-1, 1)


def test_norms_and_error_are_those_of_the_dense_problem() -> None:
    condensed = condense(SLAB)
    u, force = noisy_push(condensed, 5e-6)
    curve = curve_of(condensed, u, force)
    k_21 = dense_from_blocks(condensed.bases, [k.toarray() for k in condensed.k_12]).T
    k_22 = dense_from_blocks(condensed.bases, condensed.k_22)
    for at in (40, 70, 90):
        w = WEIGHTS[at] * np.linalg.eigvalsh(k_22)[-1] ** 2
        u_2 = np.linalg.solve(k_22.T @ k_22 + w * np.eye(len(k_22)), -k_22.T @ k_21 @ u)
        assert curve.residual[at] == pytest.approx(np.linalg.norm(k_21 @ u + k_22 @ u_2), rel=1e-8)
        assert curve.size[at] == pytest.approx(np.linalg.norm(u_2), rel=1e-8)
        hat = k_22 @ np.linalg.solve(k_22.T @ k_22 + w * np.eye(len(k_22)), k_22.T)
        left_over = len(k_22) - np.trace(hat)
        score = len(k_22) * np.linalg.norm(k_21 @ u + k_22 @ u_2) ** 2 / left_over**2
        assert curve.score[at] == pytest.approx(score, rel=1e-8)
        operator = dense_from_blocks(condensed.bases, ridge_operator(condensed, float(WEIGHTS[at])))
        error = np.linalg.norm(operator @ u - force) / np.linalg.norm(force)
        assert curve.error[at] == pytest.approx(error, rel=1e-8)
    raw = dense_from_blocks(condensed.bases, ridge_operator(condensed, 0.0))
    assert curve.raw_error == pytest.approx(np.linalg.norm(raw @ u - force) / np.linalg.norm(force), rel=1e-8)


def two_slopes(corner: float) -> WeightCurve:
    """An L in logarithms: size falls, residual stands; then the other way round, from `corner` on."""
    t = np.log(WEIGHTS / corner)
    soft = np.logaddexp(0, t)  # 0 before the corner, t after it
    score = 1 + (t / 5) ** 2
    return WeightCurve(WEIGHTS, np.exp(soft), np.exp(soft - t), score, np.ones(len(t)), 1.0)


@pytest.mark.parametrize("corner", [1e-8, 1e-5, 1e-2])
def test_rules_find_a_corner_and_a_minimum(corner: float) -> None:
    curve = two_slopes(corner)
    assert np.log10(curve.chosen("lcurve") / corner) == pytest.approx(0, abs=0.2)
    assert np.log10(curve.chosen("cv") / corner) == pytest.approx(0, abs=0.07)


def test_a_curve_without_a_choice_says_so() -> None:
    flat = WeightCurve(WEIGHTS, WEIGHTS, 1 / WEIGHTS, 1 / WEIGHTS, np.ones(len(WEIGHTS)), 1.0)
    with pytest.raises(InputError, match="cv finds no ridge weight"):
        flat.chosen("cv")
    with pytest.raises(InputError, match="unknown rule"):
        flat.chosen("best")


def test_no_ridge_is_a_choice_of_cross_validation() -> None:
    rising = WeightCurve(WEIGHTS, WEIGHTS, 1 / WEIGHTS, 1 + WEIGHTS, np.ones(len(WEIGHTS)), 0.5)
    assert rising.chosen("cv") == 0.0
    assert rising.error_at(0.0) == 0.5
    with pytest.raises(InputError, match="lcurve finds no ridge weight"):
        rising.chosen("lcurve")


def test_on_a_pad_of_the_usual_size_both_rules_choose() -> None:
    curve = weight_curve(Slab(20e-3, 16e-3, 4e-3, 31, 25, 3, 2e5, 0.48), Noise((5e-6, 5e-6, 20e-6)))
    for rule in ("lcurve", "cv"):
        assert 1e-6 < curve.chosen(rule) < 0.1
    assert np.isfinite(curve.error).all()
