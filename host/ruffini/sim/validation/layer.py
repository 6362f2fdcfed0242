"""An elastic layer bonded to a rigid bed, without sides: surface compliance by wavenumber, without finite elements.

For waves exp(i k x) Navier's equations are ordinary ones in depth (state: along, down, shear, normal stress; its
transfer matrix is an exponential). What the bed changes at the place of a small load follows by an integral over all
waves: contact theory of the half-space, whose contact is small against the layer, plus that (the first order of
Dimitriadis et al., Biophys. J. 82, 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
from scipy.optimize import brentq

DEEP = 18.0  # k h beyond which the bed is not felt: exp(-36)


@dataclass(frozen=True)
class BondedLayer:
    """Thickness (m), modulus (Pa), Poisson's ratio."""

    thickness_m: float
    modulus_pa: float
    poisson: float

    @property
    def shear_pa(self) -> float:
        return self.modulus_pa / (2 * (1 + self.poisson))

    @property
    def confined_pa(self) -> float:
        """Modulus without lateral strain."""
        return self.modulus_pa * (1 - self.poisson) / ((1 + self.poisson) * (1 - 2 * self.poisson))

    @property
    def plane_pa(self) -> float:
        """E* of a rigid body on this material."""
        return self.modulus_pa / (1 - self.poisson**2)

    def wave_compliance(self, k: float) -> tuple[float, float, float]:
        """Displacement over stress at wavenumber k (1/m): normal, along the wave, across it; m/Pa."""
        g = self.shear_pa
        if k * self.thickness_m > DEEP:
            return (1 - self.poisson) / (g * k), (1 - self.poisson) / (g * k), 1 / (g * k)
        m = self.confined_pa  # lambda + 2 mu
        lame = m - 2 * g
        kh = k * self.thickness_m  # depth in units of h, stresses in units of mu / h
        state = np.array(
            [
                [0, -kh, 1, 0],
                [kh * lame / m, 0, 0, g / m],
                [kh**2 * (m - lame**2 / m) / g, 0, 0, -kh * lame / m],
                [0, 0, kh, 0],
            ]
        )
        transfer = la.expm(state)
        surface = transfer[:2, 2:] @ np.linalg.inv(transfer[2:, 2:]) * self.thickness_m / g
        return float(surface[1, 1]), float(surface[0, 0]), float(np.tanh(kh) / (g * k))

    def point_corrections(self) -> tuple[float, float]:
        """What the bed adds to the half-space's displacement under a load, down and sideways: m/N, negative."""
        nodes, weights = np.polynomial.legendre.leggauss(200)
        k = (nodes + 1) / 2 * DEEP / self.thickness_m
        weights = weights / 2 * DEEP / self.thickness_m
        down = sideways = 0.0
        for one, weight in zip(k, weights, strict=True):
            normal, along, across = self.wave_compliance(float(one))
            free = 1 / (self.shear_pa * one)
            down += weight * one * (normal - (1 - self.poisson) * free) / (2 * np.pi)
            sideways += weight * one * (along + across - (2 - self.poisson) * free) / (4 * np.pi)
        return float(down), float(sideways)

    def hertz(self, radius_m: float, depth_m: float) -> tuple[float, float]:
        """Load (N) and contact radius (m) of a rigid ball without friction: depth = a^2/R + load * correction."""
        down, _ = self.point_corrections()

        def load(a: float) -> float:
            return 4 / 3 * self.plane_pa * a**3 / radius_m

        a = float(brentq(lambda a: a**2 / radius_m + load(a) * down - depth_m, 1e-9, 3 * (radius_m * depth_m) ** 0.5))
        return load(a), a

    def mindlin_shift(self, load_n: float, a_m: float, friction: float, shear_n: float) -> float:
        """Sideways way (m) of a ball pressed with a load on a contact of radius a: Cattaneo (1938), Mindlin (1949)."""
        _, sideways = self.point_corrections()
        limit = friction * load_n
        local = 3 * (2 - self.poisson) * limit / (16 * self.shear_pa * a_m) * (1 - (1 - shear_n / limit) ** (2 / 3))
        return float(local + shear_n * sideways)
