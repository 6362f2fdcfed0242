"""Operators: what each method promises."""

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.operators import METHODS, Noise, depth_modes, force_operator, observed_nodes
from ruffini.fem.slab import Slab
from ruffini.fem.support import solve_on_support, support_system
from ruffini.reflection import dense_from_blocks, spd_inverse

SLAB = Slab(10e-3, 8e-3, 4e-3, 11, 9, 4, 2e5, 0.48)
NOISE = Noise((5e-6, 5e-6, 20e-6))


def true_field(slab: Slab) -> tuple[np.ndarray, np.ndarray]:
    """A smooth push with shear: nodal force and the displacement that it makes."""
    x = np.tile(np.linspace(-1, 1, slab.n_x), slab.n_y)
    y = np.repeat(np.linspace(-1, 1, slab.n_y), slab.n_x)
    bump = np.exp(-(x**2 + y**2) / 0.15)
    force = np.stack([0.01 * bump, -0.004 * bump, -0.03 * bump], axis=1).ravel()
    condensed = condense(slab)
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    return force, compliance @ force


def test_raw_recovers_force_from_exact_displacement():
    force, displacement = true_field(SLAB)
    estimate = force_operator(SLAB, "raw", noise=NOISE) @ displacement
    np.testing.assert_allclose(estimate, force, atol=1e-10)


def test_ridge_without_weight_is_raw_and_with_weight_is_not():
    raw = force_operator(SLAB, "raw", noise=NOISE)
    np.testing.assert_allclose(force_operator(SLAB, "ridge", noise=NOISE, ridge_weight=0.0), raw)
    ridge = force_operator(SLAB, "ridge", noise=NOISE, ridge_weight=1e-2)
    assert np.linalg.norm(ridge - raw) > 0.01 * np.linalg.norm(raw)


def test_optimal_beats_raw_under_noise():
    force, displacement = true_field(SLAB)
    rng = np.random.default_rng(3)
    noisy = displacement + rng.normal(size=displacement.shape) * np.tile(NOISE.sigma_m, SLAB.n_nodes)
    error = {m: np.linalg.norm(force_operator(SLAB, m, noise=NOISE) @ noisy - force) for m in METHODS}
    assert error["optimal"] < 0.7 * error["raw"]


def test_gauge_noise_makes_the_estimate_blind_to_a_constant_depth():
    shift = np.zeros((SLAB.n_nodes, 3))
    shift[:, 2] = 10e-6
    known = force_operator(SLAB, "optimal", noise=NOISE) @ shift.ravel()
    unknown = force_operator(SLAB, "optimal", noise=Noise(NOISE.sigma_m, gauge_m=1e-3)) @ shift.ravel()
    assert abs(unknown[2::3].sum()) < 0.05 * abs(known[2::3].sum())


def test_nodes_outside_the_window_carry_no_force():
    """A push inside the window is recovered from the window alone."""
    inside = np.zeros((9, 11, 3))
    inside[3:6, 4:7, 2] = -0.02
    condensed = condense(SLAB)
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    displacement = (compliance @ inside.ravel()).reshape(9, 11, 3)
    window = (2e-3, 1e-3, 8e-3, 7e-3)
    rows, columns = observed_nodes(SLAB, window)
    assert (rows, columns) == (slice(1, 8), slice(2, 9))
    operator = force_operator(SLAB, "raw", noise=NOISE, window_m=window)
    estimate = (operator @ displacement[rows, columns].ravel()).reshape(7, 7, 3)
    np.testing.assert_allclose(estimate, inside[rows, columns], atol=1e-10)


def pushed_across(left: int, right: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A push on the columns left to right: force, displacement, and which unknowns a window of columns 0 to 7 sees."""
    force = np.zeros((9, 11, 3))
    force[3:6, left : right + 1] = [0.004, 0.0, -0.02]
    condensed = condense(SLAB)
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    seen = np.zeros((9, 11, 3), dtype=bool)
    seen[:, :8] = True
    return force, (compliance @ force.ravel()).reshape(9, 11, 3), seen.ravel()


def test_what_presses_outside_the_window_is_not_taken_for_force_inside():
    _, displacement, _ = pushed_across(9, 10)
    window = (0.0, 0.0, 7e-3, 8e-3)
    raw, optimal = (
        (force_operator(SLAB, m, noise=NOISE, window_m=window) @ displacement[:, :8].ravel()).reshape(9, 8, 3)
        for m in ("raw", "optimal")
    )
    true_n = 6 * 0.02
    assert np.abs(raw.sum(axis=(0, 1))).max() > 0.2 * true_n  # the papers' methods know of no force out there
    assert np.abs(optimal.sum(axis=(0, 1))).max() < 0.05 * true_n


def test_the_second_pass_finds_the_seen_part_of_a_contact_that_goes_on():
    force, displacement, seen = pushed_across(5, 10)
    linear = force_operator(SLAB, "optimal", noise=NOISE, window_m=(0.0, 0.0, 7e-3, 8e-3))
    system = support_system(condense(SLAB), NOISE, seen, linear)
    u = displacement[:, :8].ravel()
    mask = np.pad(np.ones((5, 4)), ((2, 2), (4, 0)))
    found = solve_on_support(system, u, linear @ u, mask.ravel(), threshold_n=1e-3).reshape(9, 8, 3)
    # Three columns of the six are seen; taken as free of force beyond, they would have to carry all.
    np.testing.assert_allclose(found.sum(axis=(0, 1)), force[:, :8].sum(axis=(0, 1)), atol=0.1 * 9 * 0.02)


def test_the_second_passes_equations_of_a_whole_pad_are_those_of_its_noise():
    """Made in parity classes; here H = D C R^-1 C D and D C R^-1 as they are written."""
    condensed, seen = condense(SLAB), np.ones(3 * SLAB.n_nodes, dtype=bool)
    linear = force_operator(SLAB, "optimal", noise=NOISE)
    system = support_system(condensed, NOISE, seen, linear)
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    modes, white = depth_modes(SLAB, NOISE), np.tile(np.square(NOISE.sigma_m), SLAB.n_nodes)
    project = compliance @ np.linalg.inv(np.diag(white) + modes @ modes.T)
    normal = project @ compliance
    scale = 1 / np.sqrt(np.diag(normal))
    np.testing.assert_allclose(system.scale_n, scale, rtol=1e-6)
    np.testing.assert_allclose(system.normal, normal * np.outer(scale, scale), atol=1e-6)
    size = np.abs(system.project).max()
    np.testing.assert_allclose(system.project / size, project * scale[:, None] / size, atol=1e-6)
    deviation = (np.sqrt(np.square(linear) @ white) / scale).reshape(-1, 3)
    assert system.shear_noise == pytest.approx(np.median(deviation[:, :2]), rel=1e-6)


def test_unknown_method_and_weight_are_refused():
    with pytest.raises(InputError, match="unknown method"):
        force_operator(SLAB, "magic", noise=NOISE)
    with pytest.raises(InputError, match="ridge weight"):
        force_operator(SLAB, "ridge", noise=NOISE, ridge_weight=float("nan"))
