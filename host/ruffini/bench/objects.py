"""States beyond balls and discs: the paper's ten and its objects, textures, two contacts side by side. SIMULATED.

The paper's are those of the board's reproduce.toml, at small strain as its twin is.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.states import Recipe, State, Touch, make_states
from ruffini.boards import Board
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import PressSet, load_reproduce
from ruffini.sim.reproduce.solved import solved
from ruffini.sim.settings import load_twin
from ruffini.sim.surface import on_grid
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Estimate = Callable[[Array], Array]

MM = 1e-3
APART_MM = (2.5, 3.0, 3.5, 4.0, 5.0)  # from axis to axis
APART_RADIUS_MM, APART_DEPTH_MM = 3.0, 0.5
RESOLVED = 0.735  # valley over peaks: where two are told apart (Rayleigh)
TEXTURE_DEPTH_MM = 0.45


def has_paper(board: Board) -> bool:
    """Whether the board has a paper's bench and measures the field of forces that `bench ifem` judges."""
    return board.writes("node_forces") and (board.folder or Path()).joinpath("reproduce.toml").is_file()


def paper_states(board: Board, *, quick: bool) -> list[State]:
    """The last pressed moment of each run that the paper judges or shows; with `quick` of those marked so.

    Raises
    ------
    InputError
        The board has no reproduce.toml or no slab for a pad.
    """
    unit = TwinUnit.build(board)
    states = []
    for run in runs_of(load_reproduce(board), quick=quick):
        if run.settings.part == "fit" or not isinstance(run.settings, PressSet):
            continue
        moment = [m for m in solved(unit, run) if m.judged][-1]
        several = len(run.settings.indenter or ()) > 1
        name = str(run.chosen["indenter"]) if several else run.settings.name
        shape = (board.grid.n_y, board.grid.n_x, 3)
        force, displacement = moment.nodal_force().reshape(shape), moment.nodal_displacement().reshape(shape)
        states.append(State(Recipe(name, ()), run.settings.depth_um * 1e-3, force, displacement))
    return states


def textured_states(board: Board) -> list[State]:
    """Ridges and a grid of knobs, 1.6 mm from top to top and 0.15 mm high, pressed and sheared."""
    line = np.linspace(-3.2, 3.2, 65)
    x, y = np.meshgrid(line, line)
    wave_x, wave_y = (0.075 * (1 - np.cos(2 * np.pi * v / 1.6)) for v in (x, y))
    textures = {"ridges": wave_x, "knobs": (wave_x + wave_y) / 2}
    unit = TwinUnit.build(board, twin=load_twin(board).with_pad(strain="linear", is_relaxing=False))
    states = []
    for name, heights in textures.items():
        indenter = Indenter.of_map((heights - heights.min()) * MM, float(line[1] - line[0]) * MM)
        solver = ContactSolver(unit.model, unit.response(), indenter, unit.twin.unit.friction_1e3 * 1e-3)
        for shift in (0.0, 0.1):
            solver.advance(Pose((0.4 + shift) * MM, -0.3 * MM, TEXTURE_DEPTH_MM * MM))
        force = on_grid(unit.model, solver.hat_force, board.grid.n_x, board.grid.n_y)
        moved = unit.at_nodes((unit.compliance @ solver.nodal_force.ravel()).reshape(-1, 3))
        states.append(State(Recipe(name, ()), TEXTURE_DEPTH_MM, force, moved))
    return states


def separation(board: Board, estimates: dict[str, Estimate], noise: Callable[[], Array]) -> dict[str, Any]:
    """Two balls nearer and nearer: pressure in the valley over that of the lower peak, in truth and as found.

    Along the row of nodes nearest to the axes; a method tells the two apart where its valley is below RESOLVED.
    """
    out: dict[str, Any] = {}
    for distance in APART_MM:
        pair = tuple(Touch("sphere", APART_RADIUS_MM, s * distance / 2, 0.0) for s in (-1, 1))
        state = make_states(board, (Recipe("apart", pair),), (APART_DEPTH_MM,))[0]
        u = state.displacement + noise()
        found = {"truth": valley(state.force)} | {name: valley(estimate(u)) for name, estimate in estimates.items()}
        out[f"{distance:g} mm"] = found
    return out


def valley(force: Array) -> float:
    """Least pressure between the peaks of the middle row's halves, over the lower peak; 1 where there is one peak."""
    row = -force[force.shape[0] // 2, :, 2]
    middle = len(row) // 2
    left, right = int(np.argmax(row[:middle])), middle + int(np.argmax(row[middle:]))
    return float(np.clip(row[left : right + 1].min() / max(min(row[left], row[right]), 1e-9), 0.0, 1.0))


def separation_table(result: dict[str, Any]) -> str:
    """The result of `separation` as text."""
    names = next(iter(result.values()))
    lines = [
        f"two balls of {APART_RADIUS_MM:g} mm side by side: pressure in the valley over the lower peak "
        f"(told apart below {RESOLVED})",
        *aligned(("", *result), [(name, *(f"{found[name]:.2f}" for found in result.values())) for name in names], "  "),
    ]
    return "\n".join(lines)
