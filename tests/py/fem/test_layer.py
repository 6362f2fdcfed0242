"""The exact layer against elements through its depth, a half-space, a column, and the slab's own waves."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.fem.layer import element_compliance, layer_compliance
from ruffini.fem.slab import Slab

E, NU, H = 2e5, 0.48, 4e-3


def through_the_depth(k: float, n: int = 300) -> np.ndarray:
    """Plane-strain compliance (2, 2) of the wave exp(i k x), by linear elements along z."""
    shear = E / (2 * (1 + NU))
    lame = E * NU / ((1 + NU) * (1 - 2 * NU))
    material = np.array([[lame + 2 * shear, lame, 0], [lame, lame + 2 * shear, 0], [0, 0, shear]])
    dz = H / n
    stiffness = np.zeros((2 * n + 2, 2 * n + 2), dtype=complex)
    for e in range(n):
        for at in (-1 / np.sqrt(3), 1 / np.sqrt(3)):
            shape, slope = np.array([(1 - at) / 2, (1 + at) / 2]), np.array([-1, 1]) / dz
            b = np.zeros((3, 4), dtype=complex)
            b[0, 0::2], b[1, 1::2] = 1j * k * shape, slope
            b[2, 0::2], b[2, 1::2] = slope, 1j * k * shape
            stiffness[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += b.conj().T @ material @ b * dz / 2
    loads = np.eye(2 * n + 2)[2:, -2:]
    return np.linalg.solve(stiffness[2:, 2:], loads)[-2:]


def compliance(k_x: float, k_y: float) -> np.ndarray:
    return layer_compliance(np.array([k_x]), np.array([k_y]), modulus_pa=E, poisson=NU, thickness_m=H)[0]


@pytest.mark.parametrize("kh", [0.3, 1.0, 3.0])
def test_agrees_with_elements_through_the_depth(kh: float) -> None:
    expected = through_the_depth(kh / H)
    np.testing.assert_allclose(
        compliance(kh / H, 0.0)[np.ix_([0, 2], [0, 2])], expected, atol=2e-4 * np.abs(expected).max()
    )


def test_short_waves_feel_no_base() -> None:
    """Half-space: u_z of pressure (1 - nu) / (mu k), u_x of shear along the wave the same, across 1 / (mu k)."""
    k, shear = 40 / H, E / (2 * (1 + NU))
    c = compliance(k, 0.0)
    np.testing.assert_allclose(np.diag(c).real, np.array([1 - NU, 1.0, 1 - NU]) / (shear * k), rtol=1e-6)


def test_long_waves_are_columns() -> None:
    shear = E / (2 * (1 + NU))
    confined = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
    expected = np.diag([H / shear, H / shear, H / confined])
    np.testing.assert_allclose(compliance(0.0, 0.0), expected, rtol=1e-12)
    np.testing.assert_allclose(np.diag(compliance(0.5, 0.3)), np.diag(expected), rtol=1e-3)


def test_turns_with_the_wave_and_is_hermitian() -> None:
    c = compliance(300.0, 400.0)
    np.testing.assert_allclose(c, c.conj().T, atol=1e-12 * np.abs(c).max())
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    np.testing.assert_allclose(c, turn @ compliance(500.0, 0.0) @ turn.T, atol=1e-12 * np.abs(c).max())


def test_the_slabs_elements_approach_it_as_they_get_finer() -> None:
    k_x, k_y = np.array([250.0]), np.array([-400.0])
    exact = compliance(250.0, -400.0)
    errors = []
    for refine in (1, 2):
        slab = Slab(20e-3, 16e-3, H, 30 * refine + 1, 24 * refine + 1, 6 * refine, E, NU)
        errors.append(np.abs(element_compliance(k_x, k_y, slab)[0] - exact).max() / np.abs(exact).max())
    assert errors[0] < 0.03
    assert errors[1] < 0.4 * errors[0]
