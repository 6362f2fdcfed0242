"""A tray on helical springs in a rubber sleeve: its stiffness against forces and moments, 6 x 6.

Springs and sleeve are straight columns of length L, clamped to the tray above and to the base below: Timoshenko
beams with axial, bending, shear and torsional rigidity. Of a spring with n coils of mean radius R and wire inertia
I (J = 2 I), from the strain energy of its wire at a small pitch (Timoshenko, Strength of Materials II):

    axial    G J L / (2 pi n R^3)               shear    E I L / (pi n R^3)
    bending  L / (pi n R (1/(E I) + 1/(G J)))   torsion  E I L / (2 pi n R)

Linear: at turns below 50 mrad what it leaves out of the tray's motion is below 0.1 %. Not in it: precompression of
the springs, give of their magnets, friction of springs in the sleeve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.bodies.settings import PlatformSettings
from ruffini.sim.prony import Memory, Prony

Array = npt.NDArray[np.float64]

STEEL_E_PA, STEEL_G_PA = 206e9, 79.3e9  # spring wire, EN 10270-1
SHEAR_FACTOR = 0.5  # of a thin tube's section (Cowper)


def column_stiffness(length: float, axial: float, bending: float, shear: float, torsion: float) -> Array:
    """Force and moment at the upper end of a column along z for its shift and turn, lower end clamped, (6, 6)."""
    compliance = np.diag(np.array([0, 0, length / axial, length / bending, length / bending, length / torsion]))
    compliance[[0, 1], [0, 1]] = length**3 / (3 * bending) + length / shear
    compliance[0, 4] = compliance[4, 0] = length**2 / (2 * bending)
    compliance[1, 3] = compliance[3, 1] = -(length**2) / (2 * bending)
    return np.linalg.inv(compliance)


def spring_stiffness(length: float, coil_radius: float, wire: float, n_coils: float) -> Array:
    """Of a helical spring of steel, as `column_stiffness`; lengths in metres."""
    inertia, r = np.pi * wire**4 / 64, coil_radius
    flexural, torsional = STEEL_E_PA * inertia, STEEL_G_PA * 2 * inertia
    return column_stiffness(
        length,
        axial=torsional * length / (2 * np.pi * n_coils * r**3),
        bending=length / (np.pi * n_coils * r * (1 / flexural + 1 / torsional)),
        shear=flexural * length / (np.pi * n_coils * r**3),
        torsion=flexural * length / (2 * np.pi * n_coils * r),
    )


def sleeve_stiffness(length: float, inner: float, outer: float, modulus_pa: float) -> Array:
    """Of an incompressible rubber tube, as `column_stiffness`."""
    area, inertia = np.pi * (outer**2 - inner**2), np.pi * (outer**4 - inner**4) / 4
    shear_pa = modulus_pa / 3
    return column_stiffness(
        length,
        axial=modulus_pa * area,
        bending=modulus_pa * inertia,
        shear=SHEAR_FACTOR * shear_pa * area,
        torsion=shear_pa * 2 * inertia,
    )


def rigid_modes(places: Array) -> Array:
    """Displacement (n, 3, 6) of points (n, 3) that go with a shift and a small turn about the origin."""
    out = np.zeros((len(places), 3, 6))
    out[:, [0, 1, 2], [0, 1, 2]] = 1
    x, y, z = places.T
    out[:, 0, 4], out[:, 0, 5] = z, -y
    out[:, 1, 3], out[:, 1, 5] = -z, x
    out[:, 2, 3], out[:, 2, 4] = y, -x
    return out


def about_origin(stiffness: Array, place: Array) -> Array:
    """A stiffness at `place` (3,) as one about the origin."""
    carry = np.eye(6)
    carry[:3] = rigid_modes(place[None])[0]
    return np.asarray(carry.T @ stiffness @ carry)


@dataclass(frozen=True)
class Platform:
    """Stiffness about the origin of the pad's frame of springs and sleeve, (6, 6) each; the sleeve relaxes."""

    springs: Array
    sleeve: Array
    relaxation: Prony

    @classmethod
    def of(cls, settings: PlatformSettings, *, rubber: float = 1.0) -> Platform:
        """The platform of a [platform] section; `rubber`: factor on the sleeve's modulus."""
        um, top = 1e-6, settings.top_um * 1e-6
        length, ring = settings.length_um * um, settings.ring_um * um
        one = spring_stiffness(length, settings.coil_um * um / 2, settings.wire_um * um, settings.coils_1e3 * 1e-3)
        springs = np.zeros((6, 6))
        for angle in 2 * np.pi * np.arange(settings.n_springs) / settings.n_springs:
            springs += about_origin(one, np.array([ring * np.cos(angle), ring * np.sin(angle), top]))
        sleeve = sleeve_stiffness(length, settings.sleeve_inner_um * um, settings.sleeve_outer_um * um,
                                  settings.sleeve_modulus_pa * rubber)  # fmt: skip
        return cls(springs, about_origin(sleeve, np.array([0, 0, top])), settings.relaxation())


class Tray:
    """The tray of a platform in time: shift (m) and turn (rad) about the origin, (6,)."""

    def __init__(self, platform: Platform) -> None:
        self._platform, self._sleeve = platform, Memory(platform.relaxation)
        self.shift = np.zeros(6)
        self.begin(0.0)

    def begin(self, duration_s: float) -> None:
        """A step: in it, shift = `unloaded` + `compliance` times the load."""
        self._sleeve.begin(duration_s)
        self.compliance = np.linalg.inv(self._platform.springs + self._sleeve.factor * self._platform.sleeve)
        self.unloaded = np.asarray(-self.compliance @ np.broadcast_to(self._sleeve.held, 6))

    def load(self, wrench: Array) -> None:
        """At the end of the step the load is `wrench` (6,)."""
        self.shift = self.unloaded + self.compliance @ wrench

    def commit(self) -> None:
        """The step ends."""
        self._sleeve.commit(self._platform.sleeve @ self.shift)
