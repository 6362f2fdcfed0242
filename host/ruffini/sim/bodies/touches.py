"""What presses on bodies that are no slab: stories for looking, and random touches for judging and datasets."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ruffini.boards import Board
from ruffini.sim import programs
from ruffini.sim.indenters import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.programs import Rest, Step, Touch
from ruffini.sim.settings import TwinSettings

MM = 1e-3
Draw = Callable[[Board, np.random.Generator], Touch]

# The stereo paper's three tools: circle of 78.54, square of 100.00 and hexagon of 64.95 square millimetres.
STEREO_TOOLS = (("flat", 5.0), ("square", 5.0), ("hexagon", 4.33))
STEREO_REACH_MM = 6.0  # its grid of places
STEREO_TURN_RAD = np.pi / 4  # its turned sensor
SKIN_BALLS_MM = (2.5, 5.0, 7.5, 10.0)  # radii of the skin paper's hemispherical tips


def _pressed(indenter: Indenter, held: Pose, n_down: int, n_up: int) -> Touch:
    """Straight down and up; the deepest frame is judged."""
    above = Pose(held.x_m, held.y_m, 0.0, *held.row()[3:].tolist())
    down = [above.towards(held, (i + 1) / n_down) for i in range(n_down)]
    up = [held.towards(above, (i + 1) / n_up) for i in range(n_up)]
    return Touch(indenter, down + up, [False] * (n_down - 1) + [True] + [False] * n_up)


def dome_touch(board: Board, rng: np.random.Generator) -> Touch:
    """One of the stereo paper's tools, 0.3-3 mm deep, within 6 mm of the top; a third under a turned sensor."""
    shape, radius = STEREO_TOOLS[rng.integers(len(STEREO_TOOLS))]
    x, y = rng.uniform(-STEREO_REACH_MM, STEREO_REACH_MM, 2) * MM
    depth, turn = rng.uniform(0.3, 3.0) * MM, rng.uniform(0, 2 * np.pi)
    lean = STEREO_TURN_RAD * rng.uniform(0.5, 1.0) if rng.random() < 1 / 3 else 0.0
    held = Pose(x, y, depth, 0.0, lean * np.sin(turn), lean * np.cos(turn))
    return _pressed(Indenter(shape, radius * MM), held, 4, 2)


def tube_touch(board: Board, rng: np.random.Generator) -> Touch:
    """A ball of the skin paper, 0.5-3 mm deep, anywhere but at the ends of the tube."""
    radius = SKIN_BALLS_MM[rng.integers(len(SKIN_BALLS_MM))]
    x = rng.uniform(-0.5, 0.5) * board.pad.size_x_um * 1e-6
    y = rng.uniform(-0.5, 0.5) * (board.pad.size_y_um * 1e-6 - 4 * radius * MM)
    return _pressed(Indenter("sphere", radius * MM), Pose(x, y, rng.uniform(0.5, 3.0) * MM), 6, 3)


DRAWN: dict[str, Draw] = {"plane": programs.random_touch, "dome": dome_touch, "tube": tube_touch}


def random_touch(board: Board, twin: TwinSettings, rng: np.random.Generator) -> Touch:
    """A press for judging on the body that the board has."""
    return DRAWN[twin.shape.kind](board, rng)


def grid(board: Board, twin: TwinSettings, n: int, rng: np.random.Generator) -> list[Step]:
    """n independent presses, each followed by two untouched frames."""
    if twin.shape.kind == "plane":
        return programs.grid(board, n, rng)

    def presses() -> Iterator[Step]:
        for _ in range(n):
            yield random_touch(board, twin, rng)
            yield Rest(2)

    return [Rest(board.pipeline.n_rest_frames + 2), *presses()]


def demo(board: Board, twin: TwinSettings) -> list[Step]:
    """A few touches to look at."""
    if twin.shape.kind == "plane":
        return programs.demo(board)
    story: list[Step] = [Rest(board.pipeline.n_rest_frames + 2)]
    if twin.shape.kind == "dome":
        story += [
            _pressed(Indenter("flat", 5 * MM), Pose(0, 0, 2 * MM), 6, 4), Rest(4),
            _pressed(Indenter("sphere", 5 * MM), Pose(4 * MM, 0, 2 * MM), 6, 4), Rest(4),
            _pressed(Indenter("square", 5 * MM), Pose(0, 0, 2 * MM, 0, 0, STEREO_TURN_RAD), 6, 4), Rest(4),
        ]  # fmt: skip
        return story
    eighth = board.pad.size_x_um * 0.125e-6  # the middle of the first of four panels
    two = Indenter.two(Indenter("sphere", 5 * MM), Indenter("sphere", 5 * MM), 30 * MM)
    story += [
        _pressed(Indenter("sphere", 5 * MM), Pose(eighth, 0, 3 * MM), 10, 6), Rest(4),
        _pressed(Indenter("sphere", 10 * MM), Pose(3 * eighth, -20 * MM, 3 * MM), 10, 6), Rest(4),
        _pressed(two, Pose(-eighth, 20 * MM, 3 * MM, np.pi / 2), 10, 6), Rest(4),
    ]  # fmt: skip
    return story
