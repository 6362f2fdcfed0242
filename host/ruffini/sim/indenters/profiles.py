"""Heights of indenters over their lowest point, at (x, y) in their own frame; lengths over their radius."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ruffini.sim.indenters.outline import hexagon, polygon

Array = npt.NDArray[np.float64]
Height = Callable[[Array, Array], Array]

STEEP = 0.95  # part of a ball's radius beyond which its side goes on straight
CONE_SLOPE = 0.5  # rise over run of a cone's side
CYLINDER_HALF_LENGTH = 2.0  # of a lying cylinder, along y
FACE_OF_HEAD = 0.95  # ISO 4017: the chamfer of a hexagon head leaves a face of this part of the width
CHAMFER_SLOPE = np.tan(np.deg2rad(30))  # ISO 4017: 15 to 30 degrees
PAN_RADIUS = 13 / 8  # ISO 7045, M8: top of the pan rounded with 13 mm, head 16 mm across
# Phillips recess H4 in an M8 head, about 9 mm across and 2 mm wide; walls as steep as a height map takes
RECESS_HALF_LENGTH, RECESS_HALF_WIDTH, RECESS_DEPTH, RECESS_SLOPE = 0.56, 0.13, 0.45, 3.0
SHELL_FLATNESS, SHELL_LENGTH = 0.45, 1.3  # height and length of a valve over its radius
SHELL_RIBS, SHELL_RIB_HEIGHT = 18, 0.02


def _round(r: Array) -> Array:
    slope = STEEP / np.sqrt(1 - STEEP**2)
    round_part = 1 - np.sqrt(1 - np.minimum(r, STEEP) ** 2)
    return np.asarray(round_part + slope * np.maximum(r - STEEP, 0.0))


def sphere(x: Array, y: Array) -> Array:
    """A ball."""
    return _round(np.hypot(x, y))


def cone(x: Array, y: Array) -> Array:
    """A sharp cone."""
    return CONE_SLOPE * np.hypot(x, y)


def cylinder(x: Array, y: Array) -> Array:
    """A cylinder that lies along y, with square ends."""
    return _round(np.abs(x)) + np.maximum(np.abs(y) - CYLINDER_HALF_LENGTH, 0.0)


def screw_m6(x: Array, y: Array) -> Array:
    """Hexagon head, chamfered."""
    chamfer = CHAMFER_SLOPE * np.maximum(np.hypot(x, y) - FACE_OF_HEAD, 0.0)
    return np.asarray(np.maximum(chamfer, hexagon(x, y)))


def _cross(half_length: float, half_width: float) -> list[tuple[float, float]]:
    a, b = half_length, half_width
    return [(-b, -a), (b, -a), (b, -b), (a, -b), (a, b), (b, b), (b, a), (-b, a), (-b, b), (-a, b), (-a, -b), (-b, -b)]


_recess = polygon(_cross(RECESS_HALF_LENGTH, RECESS_HALF_WIDTH))


def screw_m8(x: Array, y: Array) -> Array:
    """Pan head with a cross recess."""
    r = np.hypot(x, y)
    hole = np.clip(-RECESS_SLOPE * _recess(x, y), 0.0, RECESS_DEPTH)
    lowest = _pan(np.sqrt(2) * RECESS_HALF_WIDTH)  # the top is cut away: the corners of the recess touch first
    return np.asarray(_pan(np.minimum(r, 1.0)) - lowest + hole + np.maximum(r - 1.0, 0.0))


def _pan(r: npt.ArrayLike) -> Array:
    return np.asarray(PAN_RADIUS - np.sqrt(PAN_RADIUS**2 - np.square(r)))


def shell(x: Array, y: Array) -> Array:
    """Valve of a bivalve: a flat ellipsoid with ribs that run out from the hinge at its upper end."""
    r = np.hypot(x, y / SHELL_LENGTH)
    spread = np.arctan2(x, y + SHELL_LENGTH)  # angle of a rib, seen from the hinge
    ribs = SHELL_RIB_HEIGHT * (1 - np.cos(2 * SHELL_RIBS * spread)) * np.clip(r, 0, 1)
    return np.asarray(SHELL_FLATNESS * _round(r) + ribs)


PROFILES: dict[str, Height] = {
    "sphere": sphere,
    "cone": cone,
    "cylinder": cylinder,
    "screw_m6": screw_m6,
    "screw_m8": screw_m8,
    "shell": shell,
}
