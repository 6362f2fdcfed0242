"""Ways of one indenter over the pad: press, shear, twist, roll, slide, cycles, a random walk, a press to the limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ruffini.boards import Section
from ruffini.sim.indenters import Indenter, Material
from ruffini.sim.pose import Pose
from ruffini.sim.programs import Rest, Step, Touch

Um = Annotated[int, Field(ge=-200_000, le=200_000)]

SHEAR = 0.4  # sideways, of the depth: the middle of the contact still sticks at a friction of 0.5 and more
TWIST_RAD = 0.15
TILT_RAD = 0.12  # of shapes that do not roll
SLIDE = 2.0  # of the depth: all of the contact slips
N_CYCLES = 5
LIMIT_DEPTH_M = 4e-3  # the contact-model paper's press to the limit of its 5 mm pad
WALK_STEP = 0.08  # of the depth, standard deviation of a frame's step


class TouchSettings(Section):
    """[touch]: what presses, where and how deep."""

    indenter: str = "sphere"
    radius_um: Annotated[int, Field(ge=10, le=100_000)] = 3000
    shore_a: Annotated[int, Field(ge=0, le=99)] | None = None  # rigid without
    x_um: Um = 0
    y_um: Um = 0
    depth_um: Annotated[int, Field(ge=1, le=50_000)] = 800
    frames: Annotated[int, Field(ge=1, le=100_000)] = 12  # of each stretch of the way

    def made(self) -> Indenter:
        """The indenter."""
        material = None if self.shore_a is None else Material.of_shore_a(self.shore_a)
        return Indenter(self.indenter, self.radius_um * 1e-6, material)


@dataclass
class _Way:
    """Poses so far, `n` a stretch."""

    indenter: Indenter
    start: Pose
    n: int
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.poses: list[Pose] = []
        self._last = self.start

    def to(self, dx: float = 0, dy: float = 0, depth: float = 0, turn: float = 0, pitch: float = 0) -> None:
        end = Pose(self.start.x_m + dx, self.start.y_m + dy, depth, turn, 0.0, pitch)
        self.poses += [self._last.towards(end, (i + 1) / self.n) for i in range(self.n)]
        self._last = end


def _press(way: _Way, depth: float) -> None:
    way.to(depth=depth)
    way.to(depth=depth)
    way.to()


def _shear(way: _Way, depth: float) -> None:
    for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 0), (0, 1), (0, -1)):
        way.to(SHEAR * depth * dx, SHEAR * depth * dy, depth)
    way.to(0, -SHEAR * depth)


def _twist(way: _Way, depth: float) -> None:
    for turn in (0.0, TWIST_RAD, -TWIST_RAD, 0.0):
        way.to(depth=depth, turn=turn)
    way.to()


def _roll(way: _Way, depth: float) -> None:
    radius = way.indenter.pivot_m
    angle = SLIDE * depth / radius if radius else TILT_RAD
    for part in (0, 1, -1, 0):
        way.to(dx=part * angle * radius, depth=depth, pitch=part * angle)
    way.to()


def _slide(way: _Way, depth: float) -> None:
    for part in (0, 1, -1):
        way.to(dx=part * SLIDE * depth, depth=depth)
    way.to(dx=-SLIDE * depth)


def _cycles(way: _Way, depth: float) -> None:
    for _ in range(N_CYCLES):
        way.to(depth=depth)
        way.to()


def _walk(way: _Way, depth: float) -> None:
    """A random walk of place, depth and turn, held near the start by a spring."""
    way.to(depth=depth)
    at = np.zeros(4)
    pull, size = 0.9, WALK_STEP * depth
    for _ in range(10 * way.n):
        at = pull * at + way.rng.normal(0, 1, 4) * (size, size, size / 2, size / way.indenter.radius_m)
        way.poses.append(Pose(way.start.x_m + at[0], way.start.y_m + at[1], max(depth + at[2], 0.0), at[3]))


def _limit(way: _Way, depth: float) -> None:
    _press(way, max(depth, LIMIT_DEPTH_M))


TRAJECTORIES: dict[str, Callable[[_Way, float], None]] = {
    "press": _press, "shear": _shear, "twist": _twist, "roll": _roll, "slide": _slide, "cycles": _cycles,
    "walk": _walk, "limit": _limit,
}  # fmt: skip
TrajectoryName = Literal["press", "shear", "twist", "roll", "slide", "cycles", "walk", "limit"]


def told(name: TrajectoryName, touch: TouchSettings, n_rest: int, rng: np.random.Generator) -> list[Step]:
    """One touch between untouched frames; every frame of it is judged."""
    indenter = touch.made()
    way = _Way(indenter, Pose(touch.x_um * 1e-6, touch.y_um * 1e-6, 0.0), touch.frames, rng)
    TRAJECTORIES[name](way, touch.depth_um * 1e-6)
    return [Rest(n_rest), Touch(indenter, way.poses, [True] * len(way.poses)), Rest(touch.frames)]
