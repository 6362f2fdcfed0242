"""One press as an input file of CalculiX: hyperelastic pad, bonded base, rigid indenter with friction.

CalculiX gets geometry, material and path, and nothing of the twin's solution. Units mm, N, MPa.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mesh import PadMesh, Sheet

Array = npt.NDArray[np.float64]

CONTACT_STIFFNESS = 50.0  # MPa/mm: 0.1 MPa of pressure goes 2 um into the indenter
STICK_STIFFNESS = 25.0  # MPa/mm: shear traction over the way that a sticking point gives
SMALLEST_INCREMENT = 1e-4  # of a step
ROUNDING = 1e-6  # of the number of halvings of a step
# Share of the contact's points that may come and go in a settled iteration; the others are the solver's defaults.
SETTLED_CONTACT = "0.01, 0.1, 100, 60"


@dataclass(frozen=True)
class Pad:
    """A slab and its rubber: `exponent` is Ogden's alpha; 2 is the neo-Hookean."""

    size_x: float
    size_y: float
    thickness: float
    modulus: float
    poisson: float
    exponent: float = 2.0

    def card(self) -> str:
        """U = 2 mu/alpha^2 (sum of the isochoric stretches^alpha - 3) + (J - 1)^2 / D, with D = 2 / bulk modulus."""
        shear = self.modulus / (2 * (1 + self.poisson))
        d = 6 * (1 - 2 * self.poisson) / self.modulus
        if self.exponent == 2.0:
            return f"*HYPERELASTIC, NEO HOOKE\n{shear / 2:.9g}, {d:.9g}\n"
        return f"*HYPERELASTIC, OGDEN, N=1\n{shear:.9g}, {self.exponent:.9g}, {d:.9g}\n"


@dataclass(frozen=True)
class Place:
    """Where an indenter is: its lowest point (mm from the pad's centre, depth downwards), turned about z (rad)."""

    x: float
    y: float
    depth: float
    turn: float = 0.0

    def of(self, points: Array) -> Array:
        """Points (n, 3) of the indenter's own frame in the pad's."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        spin = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        return np.asarray(points @ spin.T + [self.x, self.y, -self.depth])


def write_deck(
    pad: Pad, mesh: PadMesh, indenter: Sheet, path: list[Place], friction: float, increment: float | None = None, *,
    is_mirrored: bool = False,
) -> str:  # fmt: skip
    """The input file; the end of each place of the path is one step, whose results are printed.

    `increment` is the longest way (mm) of the indenter between two equilibria: friction follows the path, and a point
    that touches within an increment sticks to where it was at its beginning. None: half a step, then freely. A step has
    2, 4, 8... increments, whose sum is exactly 1: from a rest of 1e-6 the solver finds no equilibrium.
    `is_mirrored`: the mesh ends in a plane y = 0 of symmetry.
    """
    n_pad, n_bricks = len(mesh.nodes), len(mesh.elements)
    start = Place(path[0].x, path[0].y, 0.0, path[0].turn).of(indenter.nodes)
    nodes = np.vstack([mesh.nodes, start])
    lines = ["*NODE, NSET=ALL", *(f"{i + 1},{x:.9g},{y:.9g},{z:.9g}" for i, (x, y, z) in enumerate(nodes))]
    lines += ["*ELEMENT, TYPE=C3D20R, ELSET=PAD", *_rows(mesh.elements + 1, 1)]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=INDENTER", *_rows(indenter.elements + n_pad + 1, n_bricks + 1)]
    lines += _set("NSET", "BASE", mesh.base + 1)
    lines += _set("NSET", "RIGID", np.arange(n_pad, len(nodes)) + 1)
    lines += _set("ELSET", "UPPER", mesh.top_elements + 1)
    lines += _set("NSET", "LAYER", np.unique(mesh.elements[mesh.top_elements]) + 1)
    lines += ["*SURFACE, NAME=SKIN, TYPE=ELEMENT", "UPPER, S2", "*SURFACE, NAME=FACE, TYPE=ELEMENT", "INDENTER, S1"]
    lines += ["*MATERIAL, NAME=RUBBER", pad.card().rstrip(), "*SOLID SECTION, ELSET=PAD, MATERIAL=RUBBER"]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "200000., .3", "*SOLID SECTION, ELSET=INDENTER, MATERIAL=STEEL"]
    lines += ["*SURFACE INTERACTION, NAME=TOUCH", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"]
    lines += [f"{CONTACT_STIFFNESS:.9g}"]
    if friction:
        lines += ["*FRICTION", f"{friction:.9g}, {STICK_STIFFNESS:.9g}"]
    lines += ["*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE", "SKIN, FACE"]
    if is_mirrored:
        lines += _set("NSET", "MIRROR", np.flatnonzero(mesh.nodes[:, 1] == mesh.y[-1]) + 1)
    lines += ["*BOUNDARY", "BASE, 1, 3", *(["MIRROR, 2, 2"] if is_mirrored else [])]
    before = start
    for place in path:
        moved = place.of(indenter.nodes) - start
        way = float(np.linalg.norm(moved + start - before, axis=1).max())
        halvings = 0 if increment is None else max(0, math.ceil(math.log2(way / increment) - ROUNDING))
        first, most = (0.5, 1.0) if increment is None else (0.5**halvings,) * 2
        before = moved + start
        lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", f"{first:.17g}, 1., {SMALLEST_INCREMENT}, {most:.17g}"]
        lines += ["*CONTROLS, PARAMETERS=CONTACT", SETTLED_CONTACT, "*BOUNDARY"]
        lines += [f"{n_pad + i + 1},{c + 1},{c + 1},{u[c]:.9g}" for i, u in enumerate(moved) for c in range(3)]
        lines += ["*NODE PRINT, NSET=RIGID, TOTALS=ONLY, FREQUENCY=1000", "RF"]
        lines += ["*NODE PRINT, NSET=BASE, TOTALS=ONLY, FREQUENCY=1000", "RF"]
        lines += ["*NODE PRINT, NSET=LAYER, FREQUENCY=1000", "U"]
        lines += ["*EL PRINT, ELSET=UPPER, FREQUENCY=1000", "S", "*END STEP"]
    return "\n".join(lines) + "\n"


def _rows(elements: npt.NDArray[np.intp], first: int) -> list[str]:
    out = []
    for i, nodes in enumerate(elements.tolist()):
        numbers = [str(n) for n in (first + i, *nodes)]
        out += [",".join(numbers[:11]) + ",", ",".join(numbers[11:])] if len(numbers) > 11 else [",".join(numbers)]
    return out


def _set(kind: str, name: str, members: npt.NDArray[np.intp]) -> list[str]:
    rows = [members[i : i + 12].tolist() for i in range(0, len(members), 12)]
    return [f"*{kind}, {kind}={name}", *(",".join(map(str, row)) for row in rows)]
