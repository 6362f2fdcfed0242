"""A skin round a rigid tube: panels that glow lie on rubber pyramids, under a soft black cover.

Each panel is a shell at large displacement (`shell`) with free edges on a bed of pyramids (`pyramid`). The cover gives
way to a tool like a layer (pressure over overlap, stiffer as it gets thin); it is as thick as nothing in the geometry:
tools touch the panel's middle surface. Panels do not pull at each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.bodies.pyramid import BedNumbers, PyramidBed, PyramidLaw
from ruffini.sim.bodies.settings import SkinSettings
from ruffini.sim.bodies.sheet import Sheet
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.bodies.splines import Line, Patch

Array = npt.NDArray[np.float64]
UM = 1e-6


def around(angle: Array, along: Array, radius: float) -> Array:
    """Points (..., 3) of a tube about z."""
    angle, along = np.broadcast_arrays(angle, along)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), along], axis=-1)


def bonded_modulus(modulus_pa: float, side: float, thickness: float) -> float:
    """Apparent modulus of an incompressible layer under a square of `side`: E (1 + 2 S^2), S = side / (4 t).

    A. N. Gent and P. B. Lindley, "The compression of bonded rubber blocks", 1959.
    """
    return modulus_pa * (1 + 2 * (side / (4 * thickness)) ** 2)


@dataclass(frozen=True)
class SkinModel:
    """A skin's true numbers; metres, pascals. `chart_m` is the radius on which the camera's coordinates count."""

    settings: SkinSettings
    chart_m: float
    length_m: float
    modulus_pa: float
    base_m: float  # side of a pyramid

    @property
    def radius_m(self) -> float:
        """Of the panels' middle surface."""
        s = self.settings
        return self.chart_m + (s.pyramid_um - s.squeezed_um + s.panel_um / 2) * UM

    @property
    def cover_m(self) -> float:
        return self.settings.cover_um * UM

    @property
    def cover_pa_m(self) -> float:
        """Pressure per overlap of the untouched cover."""
        return bonded_modulus(self.modulus_pa, self.base_m, self.cover_m) / self.cover_m

    def span(self, panel: int) -> tuple[float, float]:
        """Angles at which a panel begins and ends."""
        one, half_seam = 2 * np.pi / self.settings.n_panels, self.settings.seam_um * UM / 2 / self.radius_m
        return -np.pi + panel * one + half_seam, -np.pi + (panel + 1) * one - half_seam

    def sheet(self, panel: int) -> Sheet:
        """A panel at rest; its coordinates are angle times the chart's radius, and the way along the tube."""
        s, (begin, end) = self.settings, self.span(panel)
        line_a = Line(np.linspace(begin, end, s.cells_x + 1) * self.chart_m)
        line_b = Line(np.linspace(-self.length_m / 2, self.length_m / 2, s.cells_y + 1))
        patch = Patch.of(line_a, line_b)
        home_a, home_b = np.meshgrid(line_a.greville(), line_b.greville())
        rest = patch.interpolated(around(home_a / self.chart_m, home_b, self.radius_m))
        shell = Shell(patch, rest, s.panel_um * UM, float(s.panel_modulus_pa), s.panel_poisson_1e4 * 1e-4)
        return Sheet(shell, np.ones_like(rest, dtype=bool))

    def bed(self, sheet: Sheet, in_base: npt.NDArray[np.bool_]) -> PyramidBed:
        """The pyramids under a panel; `in_base` says which of its samples lie over one, (elements, samples)."""
        s = self.settings
        numbers = BedNumbers(
            PyramidLaw(self.base_m, s.pyramid_um * UM, self.modulus_pa), s.squeezed_um * UM, s.mask_gap_um * UM,
            bonded_modulus(self.modulus_pa, self.base_m, s.mask_um * UM) / (s.mask_um * UM),
            self.modulus_pa / 3 / (s.pyramid_um * UM), s.relaxation(),
        )  # fmt: skip
        return PyramidBed(sheet, in_base, numbers)
