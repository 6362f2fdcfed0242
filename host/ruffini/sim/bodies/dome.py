"""A rubber dome: the shell of the stereo fingertip.

The middle surface is a half sphere with its top at the origin on a cylinder (`optics.charts.Dome`, its coordinates),
clamped where the half sphere ends. The wall gives way locally like a layer of rubber: pressure = E / t times the
overlap with the tool, sticking shear = E / (3 t) times the way since it stuck, at most friction times pressure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.bodies.sheet import Sheet
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.bodies.splines import Line, Patch

Array = npt.NDArray[np.float64]

FINE = 0.55  # of the even spacing: lines about the top


def places(a: Array, b: Array, radius: float) -> Array:
    """Points (..., 3) at ways (a, b) from the top along the surface; all lengths in one unit."""
    way = np.hypot(a, b)
    angle = np.minimum(way / radius, np.pi / 2)
    part = np.where(way > 1e-9 * radius, radius * np.sin(angle) / np.maximum(way, 1e-12 * radius), 1.0)
    return np.stack([a * part, b * part, radius * (np.cos(angle) - 1) - np.maximum(way - radius * np.pi / 2, 0)], -1)


def _graded(half: float, n: int) -> Array:
    t = np.linspace(-1, 1, n + 1)
    return half * t * (FINE + (1 - FINE) * t**2)


@dataclass(frozen=True)
class DomeModel:
    """A dome's true numbers; lengths in metres."""

    radius_m: float
    thickness_m: float
    modulus_pa: float
    poisson: float
    n_cells: int

    def sheet(self) -> Sheet:
        """Its shell at rest."""
        half = np.pi / 2 * self.radius_m
        line = Line(_graded(half, self.n_cells))
        patch = Patch.of(line, line)
        home_a, home_b = np.meshgrid(line.greville(), line.greville())
        rest = patch.interpolated(places(home_a, home_b, self.radius_m))
        is_free = np.hypot(home_a, home_b).ravel() < half
        shell = Shell(patch, rest, self.thickness_m, self.modulus_pa, self.poisson)
        return Sheet(shell, np.repeat(is_free[:, None], 3, axis=1))
