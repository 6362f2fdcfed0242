"""The oracle's presses as states of `bench ifem`, the twin beside them, and the tables of both. SIMULATED twice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mesh import PadMesh
from presses import Press, deck_of, path_of, reach
from results import AGAIN, Printed, Surface, read_dat, surface_forces
from solve import OracleError, solved

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.ifem import Methods, evaluate
from ruffini.bench.states import Recipe, State, make_states
from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.operator.marker_lattice import marker_places
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]

MM = 1e-3
KEPT_M, KEPT_N = 1e-7, 1e-5  # steps of a kept state
N_SEEDS = 3


@dataclass(frozen=True)
class Solved:
    """A press at one depth as CalculiX has it: a state on the board's grid, and how well its forces balance."""

    press: Press
    state: State
    imbalance: float  # of indenter and base, over the indenter's force
    unread: float  # of the surface's forces from stresses against the indenter's, over the indenter's force
    stray: float  # largest nodal force where nothing touches, over the largest

    @property
    def name(self) -> str:
        return f"{self.press.name} {self.state.depth_mm:g} mm"


def check_board(board: Board) -> None:
    """Refuse boards that the decks do not describe.

    Raises
    ------
    InputError
        The pad is not flat, has no lattice of markers, or the core makes no forces of its displacements.
    """
    has_lattice = board.markers is not None and board.writes("node_forces")
    twin = load_twin(board) if has_lattice else None
    if twin is None or twin.shape.kind != "plane" or twin.platform is not None:
        raise InputError(
            f"board {board.name!r} cannot be pressed by the oracle: give one with a flat pad, a lattice of markers and "
            "forces of their displacements"
        )


def solve_press(board: Board, press: Press, folder: Path, *, only_kept: bool = False) -> list[Solved]:
    """Every state of a press; with `only_kept` nothing is solved that is not in `folder`.

    Raises
    ------
    OracleError
        It cannot be solved here.
    """
    mesh, deck = deck_of(board, press)
    printed = read_dat(path := solved(deck, folder, only_kept=only_kept))
    places, judged = path_of(press)
    if len(printed) != len(places):
        raise OracleError(f"{path} has {len(printed)} steps of {len(places)}: {AGAIN}")
    return [state_of(board, mesh, press, depth, printed[k]) for depth, k in zip(press.depths, judged, strict=True)]


def state_of(board: Board, mesh: PadMesh, press: Press, depth: float, printed: Printed) -> Solved:
    """One increment on the grid of the board."""
    surface = Surface(mesh)
    force = surface_forces(mesh, printed)[surface.nodes]
    moved = np.zeros_like(mesh.nodes)
    moved[printed.nodes] = printed.displacement
    moved = moved[surface.nodes]
    pad, grid = board.pad, board.grid
    grid_x, grid_y = (
        np.linspace(-size / 2, size / 2, n) * 1e-3 for size, n in ((pad.size_x_um, grid.n_x), (pad.size_y_um, grid.n_y))
    )
    assert board.markers is not None  # `check_board`
    marker_x, marker_y = (line / MM for line in marker_places(board, board.markers))
    state = State(
        press.recipe, depth, surface.on_grid(force, grid_x, grid_y),
        surface.sample(moved, grid_x, grid_y) * MM, surface.sample(moved, marker_x, marker_y) * MM,
    )  # fmt: skip
    load = float(np.linalg.norm(printed.on_indenter))
    size = np.linalg.norm(force, axis=1)
    far = np.linalg.norm(mesh.nodes[surface.nodes][:, :2] - _center(press), axis=1) > _touched(press, depth)
    return Solved(
        press, state,
        imbalance=float(np.linalg.norm(printed.on_indenter + printed.on_base)) / load,
        unread=float(np.linalg.norm(force.sum(axis=0) - printed.on_indenter)) / load,
        stray=float(size[far].max(initial=0.0) / size.max()),
    )  # fmt: skip


def _center(press: Press) -> Array:
    touch = press.recipe.touches[0]
    return np.array([touch.x, touch.y])


def _touched(press: Press, depth: float) -> float:
    touch = press.recipe.touches[0]
    return float(np.hypot(*reach(touch, depth)) + np.hypot(*touch.shift) + 1.0)


def keep_states(path: Path, solved_states: list[Solved]) -> None:
    """Fields on the board's nodes into a small file: displacement in steps of 0.1 um, force in steps of 10 uN."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Array | npt.NDArray[np.int16]] = {}
    for one in solved_states:
        arrays[f"{one.name}/displacement"] = np.round(one.state.displacement / KEPT_M).astype(np.int16)
        arrays[f"{one.name}/force"] = np.round(one.state.force / KEPT_N).astype(np.int16)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def kept_states(path: Path) -> list[State]:
    """What `keep_states` wrote, as states named by their press and depth."""
    with np.load(path, allow_pickle=False) as kept:
        names = sorted({name.rsplit("/", 1)[0] for name in kept.files})
        return [
            State(
                Recipe(name, ()), float(name.split()[-2]),
                kept[f"{name}/force"] * KEPT_N, kept[f"{name}/displacement"] * KEPT_M,
            )
            for name in names
        ]  # fmt: skip


def twin_state(board: Board, one: Solved) -> State:
    """The same press on our own pad at finite strain: always neo-Hookean."""
    return make_states(board, (one.state.recipe,), (one.state.depth_mm,), truth="finite")[0]


def beside(one: Solved, twin: State) -> dict[str, float]:
    """The twin against the oracle: ratios of forces, and relative L2 differences of the fields on the board's nodes."""
    ours, theirs = twin, one.state

    def apart(a: Array, b: Array) -> float:
        return float(np.linalg.norm(a - b) / np.linalg.norm(b))

    return {
        "force_n": theirs.resultant_n,
        "force_ratio": ours.resultant_n / theirs.resultant_n,
        "peak_ratio": float(ours.force[..., 2].min() / theirs.force[..., 2].min()),
        "normal": apart(ours.force[..., 2], theirs.force[..., 2]),
        "tangential": apart(ours.force[..., :2], theirs.force[..., :2]),
        "displacement": apart(ours.displacement, theirs.displacement),
        "imbalance": one.imbalance, "unread": one.unread, "stray": one.stray,
    }  # fmt: skip


def judge(board: Board, solved_states: list[Solved], twins: list[State]) -> dict[str, Any]:
    """The board's integers, and the peers, on the oracle's states and on the twin's, with the same noise."""
    methods = Methods(board, "finite")
    try:
        noise = Disturbance(white_um=WHITE_UM)
        names = ("optimal", "default, linear", "default")
        rows: dict[str, Any] = {}
        for one, twin in zip(solved_states, twins, strict=True):
            rows[one.name] = {
                "oracle": evaluate(methods, [one.state], noise, N_SEEDS, names),
                "twin": evaluate(methods, [twin], noise, N_SEEDS, ("default",)),
            }
        return rows
    finally:
        methods.close()


def mechanics_table(rows: dict[str, dict[str, float]]) -> str:
    """The twin beside the oracle."""
    lines = [
        "the twin at finite strain (neo-Hookean) against CalculiX; normal, tangential, displacement: relative L2 "
        "differences at the board's nodes",
        f"{'press':32}{'force':>9}{'twin/':>9}{'peak':>8}{'normal':>9}{'tang.':>8}{'displ.':>8}"
        f"{'balance':>10}{'reading':>10}",
    ]
    for name, r in rows.items():
        lines.append(
            f"{name:32}{r['force_n']:7.3f} N{r['force_ratio']:9.3f}{r['peak_ratio']:8.3f}{r['normal']:9.3f}"
            f"{r['tangential']:8.3f}{r['displacement']:8.4f}{r['imbalance']:10.1e}{r['unread']:10.1e}"
        )
    return "\n".join(lines)


def field_table(rows: dict[str, Any]) -> str:
    """What the board makes of the oracle's displacements, beside what it makes of the twin's."""
    lines = [
        f"the board's integers on both, noise 5/5/20 um, {N_SEEDS} seeds: relative L2 error of the nodal forces; total",
        f"{'press':32}{'truth':8}{'method':18}{'tangential':>11}{'normal':>9}{'resultant':>12}",
    ]
    for name, row in rows.items():
        for truth, methods in row.items():
            for method, m in methods.items():
                tangential = m.get("tangential", m.get("false_shear", float("nan")))
                lines.append(
                    f"{name:32}{truth:8}{method:18}{tangential:11.3f}{m['normal']:9.3f}{1e3 * m['resultant_n']:9.0f} mN"
                )
    return "\n".join(lines)


def means_table(rows: dict[str, Any]) -> str:
    """Mean errors of the default by depth, on the presses of a neo-Hookean pad, which both programs solved."""
    lines = [
        "",
        f"{'default, mean of a depth':32}{'truth':8}{'presses':>9}{'tangential':>11}{'normal':>9}{'resultant':>12}",
    ]
    by_depth: dict[str, list[dict[str, Any]]] = {}
    for name, row in rows.items():
        if "Ogden" not in name:
            by_depth.setdefault(name.rsplit(" ", 2)[1], []).append(row)
    for depth, here in sorted(by_depth.items()):
        for truth in ("oracle", "twin"):
            means = [row[truth]["default"] for row in here]
            tangential = [m["tangential"] for m in means if "tangential" in m]
            lines.append(
                f"{depth + ' mm':32}{truth:8}{len(means):9}{np.mean(tangential):11.3f}"
                f"{np.mean([m['normal'] for m in means]):9.3f}"
                f"{1e3 * np.mean([m['resultant_n'] for m in means]):9.0f} mN"
            )
    return "\n".join(lines)
