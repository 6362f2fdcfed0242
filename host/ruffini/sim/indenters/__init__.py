"""What presses on the simulated pad: shapes as heights over (x, y), and what they are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.rubber import shore_a_modulus
from ruffini.sim.indenters.maps import HeightMap, map_of_triangles, read_stl
from ruffini.sim.indenters.material import Material
from ruffini.sim.indenters.outline import OUTLINES
from ruffini.sim.indenters.profiles import PROFILES

__all__ = ["SHAPES", "HeightMap", "Indenter", "Material", "Two", "shore_a_modulus"]

Array = npt.NDArray[np.float64]

SHAPES = (*PROFILES, *OUTLINES)
ROLLING = ("sphere", "cylinder")  # these turn about their axis, the others about their lowest point
# Half of the size of what has one: width across the flats, head diameter, plug width.
NATURAL_RADIUS_M = {"screw_m6": 5e-3, "screw_m8": 8e-3, "usb_plug": 6e-3, "nut": 5e-3}


@dataclass(frozen=True)
class Two:
    """Two shapes on one holder, their axes at -+ half_way_m along x; the higher one hangs `lift_m` above the other."""

    first: Indenter
    second: Indenter
    half_way_m: float
    lift_m: float = 0.0

    def __call__(self, x: Array, y: Array) -> Array:
        lift = (max(-self.lift_m, 0.0), max(self.lift_m, 0.0))
        return np.minimum(
            self.first.height(x + self.half_way_m, y) + lift[0],
            self.second.height(x - self.half_way_m, y) + lift[1],
        )


@dataclass(frozen=True)
class Indenter:
    """A shape of a size, pressed with its lowest point first.

    Attributes
    ----------
    shape : one of SHAPES, "map" or "two".
    radius_m : half of its size (`outline` and `profiles` say which).
    material : None where it is rigid.
    form : heights of a "map" or "two".
    """

    shape: str
    radius_m: float
    material: Material | None = None
    form: HeightMap | Two | None = None

    def __post_init__(self) -> None:
        if (self.shape not in SHAPES) if self.form is None else (self.shape not in ("map", "two")):
            raise InputError(f"unknown indenter {self.shape!r}: choose one of {', '.join(SHAPES)}")
        if not self.radius_m > 0:
            raise InputError(f"the indenter's radius must be positive, got {self.radius_m} m")
        if self.shape == "two" and self.material is not None:
            raise InputError("two indenters on one holder are rigid: give them no material")

    @classmethod
    def two(cls, first: Indenter, second: Indenter, distance_m: float, lift_m: float = 0.0) -> Indenter:
        """Two rigid indenters at once, `distance_m` from axis to axis."""
        form = Two(first, second, distance_m / 2, lift_m)
        return cls("two", distance_m / 2 + max(first.reach_m, second.reach_m), form=form)

    @classmethod
    def of_map(cls, heights: Array, step_m: float, material: Material | None = None) -> Indenter:
        """A height map (n_y, n_x) in metres."""
        form = HeightMap(heights, step_m)
        return cls("map", form.reach_m, material, form)

    @classmethod
    def of_stl(cls, path: Path, *, unit_m: float = 1e-3, step_m: float = 0.05e-3) -> Indenter:
        """The lower side (-z) of a mesh in a file whose unit is `unit_m`."""
        form = map_of_triangles(read_stl(path) * unit_m, step_m)
        return cls("map", form.reach_m, form=form)

    @property
    def reach_m(self) -> float:
        """From the axis to where its face ends, at most."""
        wide = {"square": 2**0.5, "h": 2**0.5, "t": 2**0.5, "cylinder": 5**0.5, "hexagon": 1.16, "nut": 1.16,
                "screw_m6": 1.16, "triangle": 1.16, "shell": 1.3, "usb_plug": 1.07}  # fmt: skip
        return wide.get(self.shape, 1.0) * self.radius_m

    @property
    def pivot_m(self) -> float:
        """Height over its lowest point of the point about which it rolls and tilts."""
        return self.radius_m if self.shape in ROLLING else 0.0

    @property
    def is_prism(self) -> bool:
        """Whether its face is flat with sides that go straight up."""
        return self.form is None and self.shape in OUTLINES

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Height (m) of its surface above its lowest point, at (x, y) (m) in its frame.

        Flat faces have a 45 degree flank: what lies beside them is never vertical.
        """
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        if self.form is not None:
            return self.form(x, y)
        u, v = x / self.radius_m, y / self.radius_m
        if self.shape in OUTLINES:
            return self.radius_m * np.maximum(OUTLINES[self.shape](u, v), 0.0)
        return self.radius_m * PROFILES[self.shape](u, v)
