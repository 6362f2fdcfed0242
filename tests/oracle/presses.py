"""The presses of the oracle, and their meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from deck import Pad, Place, write_deck
from mesh import PadMesh, Sheet, graded, punch, sheet

from ruffini.bench.states import NO_FRICTION, Recipe, Touch
from ruffini.boards import Board
from ruffini.sim.indenters import Indenter

FINE_STEP = 0.65  # of the elements under the contact; the finest of ours are 0.83 mm
LAYERS = (0.4, 0.65, 1.2, 1.75)  # of a pad of 4 mm, from the surface down
FINE_RADII = 0.4  # the same over the radius of a sharp indenter
SHEET_STEP, SAGITTA = 0.25, 0.0014  # of a rigid facet: its longest edge, and its depth within the round surface
INCREMENT = 0.04  # longest way between two equilibria; a flat face diverges in longer ones
FLANK = 0.4  # around the face of a flat punch, at 45 degrees as the twin has it
NEO_HOOKE = 2.0  # exponent
STIFFENING = 3.24  # exponent of Dragon Skin 10 (README.md)
FRICTION = 0.7


@dataclass(frozen=True)
class Press:
    """A recipe of `bench ifem`, pressed to one depth after the other; `exponent` of the pad's rubber."""

    recipe: Recipe
    depths: tuple[float, ...]
    exponent: float = NEO_HOOKE

    @property
    def name(self) -> str:
        return self.recipe.name + ("" if self.exponent == NEO_HOOKE else f", Ogden {self.exponent:g}")

    @property
    def is_mirrored(self) -> bool:
        """The half of the pad at y < 0 is solved: the other mirrors it. Every shape here mirrors in its own y = 0."""
        touch = self.recipe.touches[0]
        return touch.y == 0 and touch.shift[1] == 0 and touch.turn == 0


def _one(
    name: str, *depths: float, exponent: float = NEO_HOOKE, shape: str = "sphere", radius: float, x: float, y: float,
    shift: tuple[float, float] = (0.0, 0.0), turn: float = 0.0, friction: float | None = None,
) -> Press:  # fmt: skip
    return Press(Recipe(name, (Touch(shape, radius, x, y, shift, turn, friction),)), depths, exponent)


# Most of them mirror in y = 0, which takes a third of the time. A flat punch that slides sideways finds no equilibrium.
PRESSES = (
    _one("ball", 0.3, 0.6, 1.0, radius=6, x=0.3, y=0.0),
    _one("flat", 0.3, 0.6, 1.0, shape="flat", radius=2.5, x=-1.2, y=0.0),
    _one("cylinder", 0.3, 0.6, 1.0, shape="cylinder", radius=2.0, x=-0.6, y=0.0),
    _one("edge", 0.3, 0.6, shape="cylinder", radius=0.8, x=1.1, y=0.0),
    _one("ball sheared", 0.6, 1.0, radius=7, x=-1.5, y=0.0, shift=(0.15, 0.0)),
    _one("ball sliding", 0.6, radius=6, x=-2.0, y=0.0, shift=(1.0, 0.0)),
    _one("cylinder sheared", 0.6, shape="cylinder", radius=2.0, x=-0.6, y=0.0, shift=(0.2, 0.0)),
    _one("ball off centre", 0.3, 0.6, 1.0, radius=5, x=4.1, y=0.0),
    _one("ball, no friction", 0.6, 1.0, radius=8, x=-0.7, y=0.0, friction=NO_FRICTION),
    _one("ball", 0.3, 0.6, 1.0, radius=6, x=0.3, y=0.0, exponent=STIFFENING),
    _one("flat", 0.3, 0.6, 1.0, shape="flat", radius=2.5, x=-1.2, y=0.0, exponent=STIFFENING),
    _one("cylinder deep", 1.2, 1.5, shape="cylinder", radius=2.5, x=-0.6, y=0.0),
    _one("ball deep, no friction", 1.2, 1.5, radius=6, x=0.3, y=0.0, friction=NO_FRICTION),
    _one("flat twisted", 0.6, shape="flat", radius=2.5, x=0.4, y=-1.0, turn=0.1),
    _one("shell", 0.3, 0.6, shape="shell", radius=6.0, x=0.5, y=-0.5),
    _one("ball aside", 0.3, 0.6, 1.0, radius=6, x=0.3, y=-0.2),
)  # fmt: skip


def pad_of(board: Board, exponent: float) -> Pad:
    pad = board.pad
    return Pad(pad.size_x_um * 1e-3, pad.size_y_um * 1e-3, pad.thickness_um * 1e-3, pad.modulus_pa * 1e-6,
               pad.poisson_1e4 * 1e-4, exponent)  # fmt: skip


def reach(touch: Touch, depth: float) -> tuple[float, float]:
    """Half width along x and y of what may touch at a depth."""
    if touch.shape == "flat":
        return touch.radius + FLANK, touch.radius + FLANK
    radius = touch.radius if touch.shape != "shell" else touch.radius / 0.45
    across = min(0.93 * touch.radius, 1.1 * float(np.sqrt(2 * radius * depth)) + 0.4)
    return (across, 2 * touch.radius + 0.25) if touch.shape == "cylinder" else (across, across)


def pad_mesh(pad: Pad, press: Press) -> PadMesh:
    """Fine where any indenter of the press goes."""
    touch, depth = press.recipe.touches[0], max(press.depths)
    half = [0.85 * r + 0.5 for r in reach(touch, depth)]
    fine = FINE_STEP if touch.shape == "flat" else min(FINE_STEP, FINE_RADII * touch.radius)
    x, y = (
        graded(-size / 2, size / 2, min(at, at + way) - h, max(at, at + way) + h, fine)
        for size, at, way, h in zip((pad.size_x, pad.size_y), (touch.x, touch.y), touch.shift, half, strict=True)
    )
    z = -np.cumsum([0.0, *LAYERS])[::-1] * pad.thickness / sum(LAYERS)
    if press.is_mirrored:
        y = graded(-pad.size_y / 2, 0, -half[1], 0, fine)
    return PadMesh(x, y, z)


def indenter(touch: Touch, depth: float) -> Sheet:
    """The rigid surface of a touch, of the same shape as the twin's."""
    if touch.shape == "flat":
        return punch(touch.radius, FLANK, SHEET_STEP)
    shape = Indenter(touch.shape, touch.radius * 1e-3)
    step = min(SHEET_STEP, float(np.sqrt(8 * touch.radius * SAGITTA)))
    return sheet(lambda x, y: shape.height(x * 1e-3, y * 1e-3) * 1e3, *reach(touch, depth), step)


def path_of(press: Press) -> tuple[list[Place], list[int]]:
    """Places that are solved, and which of them are the states at the press's depths."""
    touch = press.recipe.touches[0]
    if not (touch.turn or any(touch.shift)):
        return [Place(touch.x, touch.y, d) for d in press.depths], list(range(len(press.depths)))
    places, states = [], []
    for d in press.depths:
        places += [
            Place(touch.x, touch.y, d), Place(touch.x + touch.shift[0], touch.y + touch.shift[1], d, touch.turn),
        ]  # fmt: skip
        states.append(len(places) - 1)
    return places, states


def deck_of(board: Board, press: Press) -> tuple[PadMesh, str]:
    """The mesh of a press and its input file."""
    touch, pad = press.recipe.touches[0], pad_of(board, press.exponent)
    mesh = pad_mesh(pad, press)
    friction = FRICTION if touch.friction is None else 0.0
    face, path = indenter(touch, max(press.depths)), path_of(press)[0]
    return mesh, write_deck(pad, mesh, face, path, friction, INCREMENT, is_mirrored=press.is_mirrored)
