"""Simulated touches of a pad with known nodal forces: what the second pass's error model is fitted on.

Pressures and shears are drawn four times finer than the board's nodes, the pad's material is not quite the board's.
The displacement has nothing of the board's discretisation in it but near the sides, which the exact layer lacks:

    u = C_pad F + (u_exact - u_elements),

the pad's own compliance for the nodal forces, and beside it what elements of this size get wrong in an endless layer:
exact waves (`layer`) of the fine tractions less the same elements' waves of the nodal forces. It shares nothing with
the twin that judges the result, neither the mechanics nor how a contact is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.layer import element_compliance, layer_compliance
from ruffini.fem.slab import Slab
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

FINER = 4  # tractions have this many steps to a node step
FAR_THICKNESSES = 2.0  # the waves repeat after the pad and this many thicknesses
HIGHEST_POISSON = 0.4995
TWO_TOUCHES = 0.1  # share of draws with two indenters
FLAT_TOUCHES = 0.5
FLAT_RADIUS_M = (1.2e-3, 3.5e-3)
BALL_RADIUS_M = (3.0e-3, 10.0e-3)
EDGE = 0.01  # of 1 - rho^2: where a punch's pressure is cut off
DEPTH_M = (0.3e-3, 1.1e-3)  # of the deepest place, log-uniform


@dataclass(frozen=True)
class MaterialSpread:
    """Standard deviations of what a pad really is against what its operator was made for, as fractions.

    By default what `ruffini cal fit --only material` leaves: 1 to 2 % of each.
    """

    modulus: float = 0.015
    poisson: float = 0.01
    thickness: float = 0.015

    def pads(self, slab: Slab) -> list[Slab]:
        """Four pads whose Poisson's ratio and thickness have these standard deviations; E is drawn with each touch."""
        off = np.sqrt(2.0)  # two pads of the four are off by this each way
        poisson = [min(slab.poisson * (1 + sign * off * self.poisson), HIGHEST_POISSON) for sign in (-1, 1)]
        thickness = [slab.thickness_m * (1 + sign * off * self.thickness) for sign in (-1, 1)]
        return [*(replace(slab, poisson=p) for p in poisson), *(replace(slab, thickness_m=t) for t in thickness)]


# Assumed of a pad that was not measured. How far forces differ from one pad to the next, `pad.stiffness_sigma_1e3`, the
# board adds, though nu and thickness are a part of it: a wrench's sigma is a tenth too large.
UNMEASURED = MaterialSpread(poisson=0.02, thickness=0.05)


@dataclass(frozen=True)
class Touch:
    """Nodal force (n_y, n_x, 3) N and surface displacement (n_y, n_x, 3) m at the pad's nodes, without noise."""

    force: Array
    displacement: Array


class TouchMaker:
    """Draws touches of one pad. Same seed, same touches."""

    def __init__(self, slab: Slab, seed: int, *, modulus_spread: float = 0.0) -> None:
        self._slab, self._modulus_spread = slab, modulus_spread
        self._rng = np.random.default_rng(seed)
        self._to_x, self._to_y = _hats(slab.n_x), _hats(slab.n_y)
        self._fine = (self._to_y.shape[1], self._to_x.shape[1])
        condensed = condense(slab)
        self._pad = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
        far = FAR_THICKNESSES * slab.thickness_m
        self._box = (slab.n_y + round(far / slab.step_m[1]), slab.n_x + round(far / slab.step_m[0]))
        self._exact = layer_compliance(
            *self._waves(FINER), modulus_pa=slab.modulus_pa, poisson=slab.poisson, thickness_m=slab.thickness_m
        )
        self._elements = element_compliance(*self._waves(1), slab)

    def _waves(self, finer: int) -> tuple[Array, Array]:
        """k_x and k_y of the box with `finer` points to a node step, radian per metre."""
        step_x, step_y, _ = self._slab.step_m
        k_x = 2 * np.pi * np.fft.rfftfreq(finer * self._box[1], step_x / finer)
        k_y = 2 * np.pi * np.fft.fftfreq(finer * self._box[0], step_y / finer)
        out_x, out_y = np.meshgrid(k_x, k_y)
        return out_x, out_y

    def draw(self) -> Touch:
        """One touch."""
        rng = self._rng
        depth = float(np.exp(rng.uniform(*np.log(DEPTH_M))))
        fine = self._one(depth)
        if rng.random() < TWO_TOUCHES:
            fine = fine + self._one(depth)
        nodal = np.einsum("ai,bj,ijc->abc", self._to_y, self._to_x, fine, optimize=True)
        u = (self._pad @ nodal.ravel()).reshape(nodal.shape)
        u += self._in_layer(self._exact, fine, FINER) - self._in_layer(self._elements, nodal, 1)
        scale = depth / -u[..., 2].min()
        stiffer = 1 + self._modulus_spread * float(np.clip(rng.normal(), -2.5, 2.5))
        return Touch(nodal * (scale * stiffer), u * scale)

    def _in_layer(self, compliance: ComplexArray, force: Array, finer: int) -> Array:
        """Displacement at the board's nodes of forces on a grid `finer` than these, by waves."""
        step_x, step_y, _ = self._slab.step_m
        shape = (finer * self._box[0], finer * self._box[1])
        waves = np.fft.rfft2(force, s=shape, axes=(0, 1)) / (step_x * step_y / finer**2)
        u = np.fft.ifft(np.einsum("...ij,...j->...i", compliance, waves), axis=0)[: force.shape[0] : finer]
        return np.asarray(np.fft.irfft(u, shape[1], axis=1)[:, : force.shape[1] : finer])

    def _one(self, depth: float) -> Array:
        """Forces of one indenter on the fine grid, of a peak pressure of about 1: over an ellipse, with shear."""
        rng, slab = self._rng, self._slab
        rows, columns = self._fine
        half = (slab.size_x_m / 2, slab.size_y_m / 2)
        radius, pressure_of = self._indenter(depth)
        center = [max(h - radius - step, 0) * rng.uniform(-1, 1) for h, step in zip(half, slab.step_m, strict=False)]
        x = np.linspace(-half[0], half[0], columns)[None, :] - center[0]
        y = np.linspace(-half[1], half[1], rows)[:, None] - center[1]
        aspect, turn = rng.uniform(0.6, 1.0), rng.uniform(0, np.pi)
        along = (np.cos(turn) * x + np.sin(turn) * y) / radius
        across = (np.cos(turn) * y - np.sin(turn) * x) / (radius * aspect)
        rho2 = along**2 + across**2
        pressure = np.where(rho2 < 1, pressure_of(np.maximum(1 - rho2, EDGE)), 0.0)
        return np.stack([*self._shear(pressure, x / radius, y / radius), -pressure], axis=-1)

    def _indenter(self, depth: float) -> tuple[float, Callable[[Array], Array]]:
        """Contact radius (m) and pressure over 1 - rho^2: a flat punch, or a ball as wide as its depth makes it."""
        rng = self._rng
        if rng.random() < FLAT_TOUCHES:
            middle = rng.uniform(0, 1.5)  # bonded and nearly incompressible: pressure in the middle too
            return rng.uniform(*FLAT_RADIUS_M), lambda inside: inside**-0.5 + middle * inside
        exponent = rng.uniform(0.5, 1.0)  # Hertz to a thin layer
        return rng.uniform(0.8, 1.3) * np.sqrt(rng.uniform(*BALL_RADIUS_M) * depth), lambda inside: inside**exponent

    def _shear(self, pressure: Array, x: Array, y: Array) -> tuple[Array, Array]:
        """Friction as a drag, a twist and a spreading, each there or not, of at most 0.9 of the pressure."""
        rng = self._rng
        drag, direction = rng.choice([0.0, rng.uniform(0, 0.8)]), rng.uniform(0, 2 * np.pi)
        twist = rng.choice([0.0, rng.uniform(-0.6, 0.6)], p=[0.7, 0.3])
        spread = rng.uniform(-0.3, 0.3)
        rim = (x**2 + y**2) ** rng.choice([0.0, 1.0])  # stuck in the middle: the drag is carried near the rim
        t_x = drag * np.cos(direction) * rim - twist * y + spread * x
        t_y = drag * np.sin(direction) * rim + twist * x + spread * y
        size = np.hypot(t_x, t_y)
        limit = np.minimum(1.0, 0.9 / np.maximum(size, 1e-9))
        return t_x * limit * pressure, t_y * limit * pressure


def _hats(n: int) -> Array:
    """Share of each fine point's force that each node gets, (n, FINER (n - 1) + 1)."""
    fine = np.linspace(0, n - 1, FINER * (n - 1) + 1)
    return np.asarray(np.maximum(1 - np.abs(fine - np.arange(n)[:, None]), 0))
