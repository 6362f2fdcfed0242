"""A screw, a coin and a key on the pad: forces of objects that people know, beside iFEM without a prior. SIMULATED.

Truth is the twin's pad, linear, with surface nodes at most NODE_MM apart, and rigid objects on it, pressed in steps
until they carry at least FORCE_N and then turned by TURN. The board observes as in `ruffini.bench.resolution`, with
the same noise; judged is the field that its integers compute. Relative L2 errors as in `bench ifem`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.disturbance import WHITE_UM
from ruffini.bench.ifem import Scores
from ruffini.bench.resolution import Observer, no_flat_field, node_step_m
from ruffini.bench.states import Recipe, State, on_board
from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.settings import MeshSettings, load_twin
from ruffini.sim.surface import hat_areas
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Progress = Callable[[float], None]

MM = 1e-3
SEED = 61
NODE_MM = 0.34  # of the truth
MAP_STEP_MM = 0.05  # between two heights of an object
FORCE_N = 4.0
STEP_MM = 0.12  # of the way down
MOST_STEPS = 16
TURN, N_TURNS = 0.35, 5  # rad, and into how many steps it is divided
LEAST_PAD_MM = (17.0, 13.0)
PLACE_MM = (0.3, -0.2)  # of the object's middle on the pad
METHODS = ("default", "raw")

# ISO 261, coarse: an M12 thread. ISO 68-1: of the height H of the sharp triangle 5/8 remain, crest P/8, root P/4.
SCREW_RADIUS_MM, SCREW_PITCH_MM = 6.0, 1.75
COIN_RADIUS_MM, COIN_RELIEF_MM = 5.5, 0.15


def screw(x_mm: Array, y_mm: Array) -> Array:
    """Height of a screw that lies along x, mm: right-handed, its thread at the lower side."""
    turns = x_mm / SCREW_PITCH_MM - np.arcsin(np.clip(y_mm / SCREW_RADIUS_MM, -1, 1)) / (2 * np.pi)
    from_crest = np.abs(turns - np.round(turns))  # pitches, 0 to 0.5
    cut = 0.625 * np.sqrt(0.75) * SCREW_PITCH_MM * np.clip((from_crest - 1 / 16) / (1 / 2 - 1 / 16 - 1 / 8), 0, 1)
    inside = np.clip((SCREW_RADIUS_MM - cut) ** 2 - y_mm**2, 0, None)
    return np.asarray(SCREW_RADIUS_MM - np.sqrt(inside))


def coin(x_mm: Array, y_mm: Array) -> Array:
    """Height of a coin that lies flat, mm: a rim and the digit 5 stand out of its face."""
    raised = _ring(x_mm, y_mm, COIN_RADIUS_MM - 0.5, 0.5)
    raised |= _bar(x_mm, y_mm, (-1.5, -2.7), (1.7, -2.7)) | _bar(x_mm, y_mm, (-1.5, -2.7), (-1.5, -0.4))
    bow = _ring(x_mm + 0.1, y_mm - 1.1, 1.8, 0.4) & ~((x_mm < -0.1) & (np.abs(y_mm - 1.1) < 1.2))
    face = np.where(raised | bow | _bar(x_mm, y_mm, (-1.5, -0.4), (-0.4, -0.7)), 0.0, COIN_RELIEF_MM)
    return face + _beside(np.hypot(x_mm, y_mm) - COIN_RADIUS_MM)


def key(x_mm: Array, y_mm: Array) -> Array:
    """Height of a key's blade that lies flat along x, mm: six cuts on one side, a groove along the other."""
    cuts = np.interp((x_mm + 7.5) / 2.5 % 1.0, (0.0, 0.3, 0.5, 0.7, 1.0), (0.0, 0.0, 1.0, 0.0, 0.0))
    deep = np.array((0.6, 1.4, 0.9, 1.6, 0.7, 1.2))[np.clip(((x_mm + 7.5) // 2.5).astype(int), 0, 5)]
    outside = np.maximum(np.maximum(y_mm - (3.0 - cuts * deep), -3.0 - y_mm), np.abs(x_mm) - 7.5)
    groove = 0.5 * np.clip(1 - np.abs(y_mm + 1.2) / 0.6, 0, 1)
    return groove + _beside(outside)


OBJECTS = {"screw": screw, "coin": coin, "key": key}
HALF_SIZE_MM = {"screw": (7.0, 5.0), "coin": (6.5, 6.5), "key": (8.0, 4.0)}


def _ring(x: Array, y: Array, radius: float, half_width: float) -> Bools:
    return np.asarray(np.abs(np.hypot(x, y) - radius) < half_width)


def _bar(x: Array, y: Array, start: tuple[float, float], end: tuple[float, float]) -> Bools:
    """A stroke 0.8 mm wide."""
    way = np.subtract(end, start)
    t = np.clip(((x - start[0]) * way[0] + (y - start[1]) * way[1]) / float(way @ way), 0, 1)
    return np.asarray(np.hypot(x - start[0] - t * way[0], y - start[1] - t * way[1]) < 0.4)


def _beside(outside_mm: Array) -> Array:
    """Sides of 45 degrees: nothing hangs over."""
    return np.clip(outside_mm, 0, None)


def indenter_of(name: str) -> Indenter:
    """One of OBJECTS as the twin presses it."""
    half_x, half_y = HALF_SIZE_MM[name]
    lines = [np.arange(-half, half + MAP_STEP_MM / 2, MAP_STEP_MM) for half in (half_x, half_y)]
    heights = OBJECTS[name](*np.meshgrid(*lines))
    return Indenter.of_map((heights - heights.min()) * MM, MAP_STEP_MM * MM)


@dataclass(frozen=True)
class Moment:
    """One moment of a touch; pressure (n_y, n_x) of the truth's own nodes in Pa."""

    state: State
    pressure_pa: Array
    pose: Pose


def fine_unit(board: Board, progress: Progress = lambda _: None) -> TwinUnit:
    """The pad with a mesh of at least NODE_MM, or the twin's own if that is finer (a minute, once)."""
    twin = load_twin(board).with_pad(strain="linear", is_relaxing=False)
    cells = [ceil(um * 1e-3 / (2 * NODE_MM)) for um in (board.pad.size_x_um, board.pad.size_y_um)]
    mesh = MeshSettings(cells_x=max(cells[0], twin.mesh.cells_x), cells_y=max(cells[1], twin.mesh.cells_y))
    return TwinUnit.build(board, twin=twin.model_copy(update={"mesh": mesh}), progress=progress)


def moments(unit: TwinUnit, name: str) -> Iterator[Moment]:
    """Down until the object carries FORCE_N, then round its axis."""
    solver = ContactSolver(unit.model, unit.response(), indenter_of(name), unit.twin.unit.friction_1e3 * 1e-3)
    x, y = (value * MM for value in PLACE_MM)
    for step in range(1, MOST_STEPS + 1):
        pose = Pose(x, y, step * STEP_MM * MM)
        yield _moment(unit, solver, name, pose)
        if -solver.nodal_force[:, 2].sum() >= FORCE_N:
            break
    else:
        raise InputError(
            f"the {name} carries less than {FORCE_N:g} N {MOST_STEPS * STEP_MM:.1f} mm deep: the pad of board "
            f"{unit.board.name!r} is too soft for it"
        )
    for turn in range(1, N_TURNS + 1):
        yield _moment(unit, solver, name, Pose(x, y, pose.depth_m, TURN * turn / N_TURNS))


def _moment(unit: TwinUnit, solver: ContactSolver, name: str, pose: Pose) -> Moment:
    solver.advance(pose)
    displacement = (unit.compliance @ solver.nodal_force.ravel()).reshape(-1, 3)
    made = on_board(unit, solver.hat_force, displacement)
    state = State(Recipe(name, ()), pose.depth_m / MM, made["force"], made["displacement"], made.get("at_markers"))
    pressure = -solver.hat_force[:, 2] / hat_areas(unit.model)
    return Moment(state, pressure.reshape(unit.model.shape), pose)


@dataclass(frozen=True)
class Measured:
    """A moment, and the forces of the observed nodes (n_y, n_x, 3) in newtons: true, and by each method."""

    moment: Moment
    true: Array
    found: dict[str, Array]

    def errors(self, board: Board, method: str) -> dict[str, float]:
        """`Scores` of one method."""
        scores, step_m = Scores(), node_step_m(board)
        scores.add(replace(self.moment.state, force=self.true), self.found[method], (1e3 * step_m[0], 1e3 * step_m[1]))
        return scores.means()


def measure(board: Board, progress: Progress = lambda _: None) -> dict[str, list[Measured]]:
    """All moments of each object with the board's estimate and iFEM raw.

    Raises
    ------
    InputError
        The board measures no field of forces, has no flat twin, or its pad is too small or too soft.
    """
    if refused := no_flat_field(board):
        raise InputError(refused)
    if board.pad.size_x_um * 1e-3 < LEAST_PAD_MM[0] or board.pad.size_y_um * 1e-3 < LEAST_PAD_MM[1]:
        raise InputError(
            f"board {board.name!r} has a pad of {board.pad.size_x_um * 1e-3:g} x {board.pad.size_y_um * 1e-3:g} mm: "
            f"the objects need {LEAST_PAD_MM[0]:g} x {LEAST_PAD_MM[1]:g} mm"
        )
    unit = fine_unit(board, lambda done: progress(0.4 * done))
    observer = Observer(board, lambda done: progress(0.4 + 0.2 * done))
    out: dict[str, list[Measured]] = {}
    try:
        estimates = observer.vectors()
        for number, name in enumerate(OBJECTS):
            out[name] = []
            for count, moment in enumerate(moments(unit, name)):
                u = observer.see(moment.state, np.random.default_rng((SEED, number, count)))
                found = {method: estimates[method](u) for method in METHODS}
                out[name].append(Measured(moment, moment.state.force[board.observed], found))
            progress(0.6 + 0.4 * (number + 1) / len(OBJECTS))
    finally:
        observer.close()
    return out


def result_of(board: Board, objects: dict[str, list[Measured]]) -> dict[str, Any]:
    """Errors of the last moment of each object and method."""
    errors = {name: {method: touch[-1].errors(board, method) for method in METHODS} for name, touch in objects.items()}
    return {"board": board.name, "simulated": True, "noise_um": WHITE_UM, "objects": errors}


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    noise = "/".join(f"{v:g}" for v in result["noise_um"])
    rows = [
        (f"{name}, {method}", f"{e['tangential']:.2f}", f"{e['normal']:.2f}", f"{1e3 * e['resultant_n']:.0f} mN")
        for name, methods in result["objects"].items()
        for method, e in methods.items()
    ]
    heading = f"{result['board']}, SIMULATED, noise {noise} um: relative errors of the nodal forces"
    return "\n".join([heading, *aligned(("", "tangential", "normal", "total force"), rows, "  ")])
