"""Exact compliance of an endless elastic layer bonded to a rigid base, wave by wave.

An independent oracle for the slab of elements, and the pad that simulated touches press (`touches`): no mesh, so
nothing of the board's own discretisation is in it. Sides are not free: it holds some layer thicknesses away from them.

With psi and phi harmonic (Papkovich and Neuber), 2 mu u = (3 - 4 nu) psi e_z - z grad psi - grad phi, clamped at z = 0.
For a wave exp(i k x): psi = (a cosh kz + b sinh kz), phi = (3 - 4 nu) a sinh kz / k; shear across the wave is
tanh(kh) / (mu k) alone.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.fem.slab import CORNERS, Slab, hexahedron_stiffness

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

DEEP = 12.0  # k h from which the base is not felt to 1e-9, and the waves are those of a half-space


def layer_compliance(k_x: Array, k_y: Array, *, modulus_pa: float, poisson: float, thickness_m: float) -> ComplexArray:
    """Surface displacement per surface traction of the waves exp(i (k_x x + k_y y)), (..., 3, 3) m / Pa.

    Parameters
    ----------
    k_x, k_y : arrays of one shape, radian per metre
    """
    shear = modulus_pa / (2 * (1 + poisson))
    k = np.hypot(k_x, k_y)
    flat = k == 0
    k_safe = np.where(flat, 1.0, k)
    along_x, along_y = np.where(flat, 1.0, k_x / k_safe), k_y / k_safe
    depth = np.minimum(k_safe * thickness_m, DEEP)
    # A half-space's compliance falls as 1 / k.
    ll, lz, zl, zz = (part / (2 * shear * k_safe) for part in _in_the_plane_of_the_wave(depth, poisson))
    across = np.tanh(depth) / (shear * k_safe)
    confined = 2 * shear * (1 - poisson) / (1 - 2 * poisson)
    ll, across = (np.where(flat, thickness_m / shear, c) for c in (ll, across))
    zz = np.where(flat, thickness_m / confined, zz)
    lz, zl = (np.where(flat, 0.0, c) for c in (lz, zl))
    out = np.zeros((*k.shape, 3, 3), dtype=complex)
    out[..., 0, 0] = along_x**2 * ll + along_y**2 * across
    out[..., 1, 1] = along_y**2 * ll + along_x**2 * across
    out[..., 0, 1] = out[..., 1, 0] = along_x * along_y * (ll - across)
    out[..., 0, 2], out[..., 1, 2] = -1j * along_x * lz, -1j * along_y * lz
    out[..., 2, 0], out[..., 2, 1] = -1j * along_x * zl, -1j * along_y * zl
    out[..., 2, 2] = zz
    return out


def _in_the_plane_of_the_wave(depth: Array, poisson: float) -> tuple[Array, Array, Array, Array]:
    """2 mu u / (traction / k) at the surface of kh = depth: (l, l), (l, z) / -i, (z, l) / -i, (z, z)."""
    kappa = 3 - 4 * poisson
    sinh, cosh = 1 - np.exp(-2 * depth), 1 + np.exp(-2 * depth)  # over exp(depth) / 2, which cancels
    # Columns: the solutions of a and of b; u_l = -i u_1, traction_l = i k t_1.
    u_1 = np.stack([depth * cosh + kappa * sinh, depth * sinh])
    u_z = np.stack([-depth * sinh, kappa * sinh - depth * cosh])
    t_1 = np.stack([(1 - 2 * poisson - kappa) * cosh - depth * sinh, (1 - 2 * poisson) * sinh - depth * cosh])
    t_z = np.stack([(2 * (1 - poisson) - kappa) * sinh - depth * cosh, 2 * (1 - poisson) * cosh - depth * sinh])
    determinant = t_1[0] * t_z[1] - t_1[1] * t_z[0]

    def over(u: Array) -> tuple[Array, Array]:
        return (u[0] * t_z[1] - u[1] * t_z[0]) / determinant, (u[1] * t_1[0] - u[0] * t_1[1]) / determinant

    (u1_t1, u1_tz), (uz_t1, uz_tz) = over(u_1), over(u_z)
    return -u1_t1, u1_tz, uz_t1, uz_tz


def element_compliance(k_x: Array, k_y: Array, slab: Slab) -> ComplexArray:
    """The same of the slab's own elements, endless: displacement of the nodes per force on them over the node's area.

    Waves that the nodes carry: on a regular mesh every node sees the same element matrix, turned in phase.
    """
    step_x, step_y, _ = slab.step_m
    element = hexahedron_stiffness(slab.step_m, slab.modulus_pa, slab.poisson).reshape(8, 3, 8, 3)
    along_x, along_y = ((CORNERS[:, i] + 1) / 2 * slab.step_m[i] for i in (0, 1))
    phase = np.exp(1j * (np.multiply.outer(k_x, along_x) + np.multiply.outer(k_y, along_y)))

    def block(rows: slice, columns: slice) -> ComplexArray:
        turned = (phase[..., rows].conj(), element[rows, :, columns], phase[..., columns])
        return np.asarray(np.einsum("...i,iajb,...j->...ab", *turned, optimize=True))

    upper, lower = slice(0, 4), slice(4, 8)
    inner = block(upper, upper) + block(lower, lower)
    down, up = block(upper, lower), block(lower, upper)
    stiffness = inner  # of the lowest free plane, what is below it condensed
    for _ in range(slab.n_layers - 2):
        stiffness = inner - down @ np.linalg.solve(stiffness, up)
    stiffness = block(upper, upper) - down @ np.linalg.solve(stiffness, up)
    return np.asarray(np.linalg.inv(stiffness) * (step_x * step_y))
