"""The oracle's presses as states of `bench ifem`, the twin beside them, and the tables of both. SIMULATED twice."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mesh import PadMesh
from presses import NEO_HOOKE, Press, deck_of, path_of, reach
from results import AGAIN, Printed, Surface, read_dat, surface_forces
from solve import OracleError, solved

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.ifem import Methods, evaluate
from ruffini.bench.states import State, make_states
from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.settings import MeshSettings, load_twin

Array = npt.NDArray[np.float64]

MM = 1e-3
KEPT_M, KEPT_N = 1e-7, 1e-5  # steps of a kept state
# Relative L2 along the surface and along z; sticking points chatter (0.005, 0.001), the solver's versions differ.
AGAIN_SHARES = (0.05, 0.01)
N_SEEDS = 3
SHARP_MM = 1.0  # an edge of a smaller radius
MIRROR = np.array([1.0, -1.0, 1.0])  # of a vector in the plane y = 0


SECTION = "## An outside oracle"
COLUMNS = (
    "pad, depth",
    "states, with friction",
    "tangential, normal, total",
    "linear default: the same",
    "commit",
    "date",
)
METHODS = ("default", "default, linear")


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


def deck_hash(deck: str) -> str:
    """Names a deck's solution: 24 hexadecimal digits of its SHA-256."""
    return hashlib.sha256(deck.encode()).hexdigest()[:24]


def solve_press(board: Board, press: Press, folder: Path) -> list[Solved]:
    """Every state of a press, solved unless `folder` has the solution.

    Raises
    ------
    OracleError
        It cannot be solved here.
    """
    mesh, deck = deck_of(board, press)
    printed = read_dat(path := solved(deck, folder / f"{deck_hash(deck)}.dat"))
    places, judged = path_of(press)
    if len(printed) != len(places):
        raise OracleError(f"{path} has {len(printed)} steps of {len(places)}: {AGAIN}")
    return [state_of(board, mesh, press, depth, printed[k]) for depth, k in zip(press.depths, judged, strict=True)]


def state_of(board: Board, mesh: PadMesh, press: Press, depth: float, printed: Printed) -> Solved:
    """One increment on the grid of the board."""
    surface = Surface(mesh)
    force = surface_forces(mesh, printed)[surface.nodes]
    if press.is_mirrored:
        force[mesh.nodes[surface.nodes][:, 1] == mesh.y[-1], 1] = 0  # what the plane of symmetry holds
    moved = np.zeros_like(mesh.nodes)
    moved[printed.nodes] = printed.displacement
    moved = moved[surface.nodes]
    pad, grid = board.pad, board.grid
    grid_x, grid_y = (
        np.linspace(-size / 2, size / 2, n) * 1e-3 for size, n in ((pad.size_x_um, grid.n_x), (pad.size_y_um, grid.n_y))
    )
    on_grid = surface.on_grid(force, grid_x, grid_y)
    if press.is_mirrored:  # one half's hats reach to y = 0; the other half adds its own
        on_grid = on_grid + MIRROR * on_grid[::-1]
    state = State(press.recipe, depth, on_grid, _sampled(surface, press, moved, grid_x, grid_y))
    free = [0, 2] if press.is_mirrored else [0, 1, 2]  # the plane of symmetry takes y
    reaction, base = printed.on_indenter[free], printed.on_base[free]
    load = float(np.linalg.norm(reaction))
    size = np.linalg.norm(force, axis=1)
    far = np.linalg.norm(mesh.nodes[surface.nodes][:, :2] - _center(press), axis=1) > _touched(press, depth)
    return Solved(
        press, state,
        imbalance=float(np.linalg.norm(reaction + base)) / load,
        unread=float(np.linalg.norm(force.sum(axis=0)[free] - reaction)) / load,
        stray=float(size[far].max(initial=0.0) / size.max()),
    )  # fmt: skip


def _sampled(surface: Surface, press: Press, moved: Array, x: Array, y: Array) -> Array:
    """Displacement (len(y), len(x), 3) in m; of a mirrored press the half at y > 0 is the other's image."""
    if not press.is_mirrored:
        return surface.sample(moved, x, y) * MM
    sign = np.where((y > 0)[:, None, None], MIRROR, 1.0)
    return surface.sample(moved, x, -np.abs(y)) * sign * MM


def _center(press: Press) -> Array:
    touch = press.recipe.touches[0]
    return np.array([touch.x, touch.y])


def _touched(press: Press, depth: float) -> float:
    touch = press.recipe.touches[0]
    return float(np.hypot(*reach(touch, depth)) + np.hypot(*touch.shift) + 1.0)


def keep_states(path: Path, board: Board, states: list[Solved]) -> None:
    """States on the grid of `board` into a small file: steps of 0.1 um and of 10 uN."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, npt.NDArray[Any]] = {}
    for one in states:
        arrays[f"{one.name}/displacement"] = np.round(one.state.displacement / KEPT_M).astype(np.int16)
        arrays[f"{one.name}/force"] = np.round(one.state.force / KEPT_N).astype(np.int16)
        arrays[f"{one.name}/residuals"] = np.array([one.imbalance, one.unread, one.stray])
        arrays[f"{one.name}/deck"] = np.array(deck_hash(deck_of(board, one.press)[1]))
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def kept_press(path: Path, board: Board, press: Press) -> list[Solved] | None:
    """The states of a press that `keep_states` wrote; None if the file has none, or those of another deck or grid.

    Raises
    ------
    OracleError
        The file is damaged.
    """
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as kept:
            return _states_in(kept, board, press)
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise OracleError(
            f"{path} cannot be read ({error}): take it from the repository again, git checkout {path}"
        ) from error


def _states_in(kept: np.lib.npyio.NpzFile, board: Board, press: Press) -> list[Solved] | None:
    deck, states = deck_hash(deck_of(board, press)[1]), []
    for depth in press.depths:
        name = f"{press.name} {depth:g} mm"
        if f"{name}/deck" not in kept.files or str(kept[f"{name}/deck"]) != deck:
            return None
        if kept[f"{name}/force"].shape[:2] != (board.grid.n_y, board.grid.n_x):
            return None
        force, displacement = kept[f"{name}/force"] * KEPT_N, kept[f"{name}/displacement"] * KEPT_M
        state = State(press.recipe, depth, force, displacement)
        states.append(Solved(press, state, *kept[f"{name}/residuals"].tolist()))
    return states


def solved_again(before: list[Solved], after: list[Solved]) -> str | None:
    """What differs between two solutions of one press by more than AGAIN allows; None: nothing."""
    for one, other in zip(before, after, strict=True):
        for what in ("force", "displacement"):
            for along, axes, limit in (
                ("the surface", slice(0, 2), AGAIN_SHARES[0]),
                ("z", slice(2, 3), AGAIN_SHARES[1]),
            ):
                a, b = getattr(one.state, what)[..., axes], getattr(other.state, what)[..., axes]
                apart = float(np.linalg.norm(a - b) / np.linalg.norm(a))
                if apart > limit:
                    return f"{one.name}: the {what} along {along} differs by {100 * apart:.1f} % from the kept one"
    return None


def twin_mesh(press: Press) -> MeshSettings | None:
    """The twin's mesh for a press; None: its usual one.

    Sharp edges, which all lie along y, get twice the elements along x: the usual ones are wider than an edge's radius.
    """
    return MeshSettings(cells_x=48) if min(touch.radius for touch in press.recipe.touches) < SHARP_MM else None


def twin_state(board: Board, one: Solved) -> State:
    """The same press on our own neo-Hookean pad at finite strain."""
    state = one.state
    return make_states(board, (state.recipe,), (state.depth_mm,), truth="finite", mesh=twin_mesh(one.press))[0]


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


def judge(board: Board, solved_states: list[Solved], twins: dict[str, State]) -> dict[str, Any]:
    """The board's integers, and the peers, on the oracle's states and on the twin's, with the same noise."""
    methods = Methods(board, "finite")
    try:
        noise = Disturbance(white_um=WHITE_UM)
        names = ("optimal", "default, linear", "default")
        rows: dict[str, Any] = {}
        for one in solved_states:
            rows[one.name] = {"oracle": evaluate(methods, [one.state], noise, N_SEEDS, names)}
            if twin := twins.get(one.name):
                rows[one.name]["twin"] = evaluate(methods, [twin], noise, N_SEEDS, ("default",))
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
    """What is made of the oracle's displacements and, where it pressed too, of the twin's."""
    lines = [
        f"relative L2 error of nodal forces, and total, of the board's integers (default) and the linear estimate "
        f"(optimal), noise 5/5/20 um, {N_SEEDS} seeds",
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


def means(states: list[Solved], rows: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Mean errors by material and depth: (what was pressed, cells of COLUMNS).

    Presses without friction carry no shear, so they have no relative tangential error.
    """
    groups: dict[tuple[float, float], list[dict[str, Any]]] = {}
    for one in states:
        groups.setdefault((one.press.exponent, one.state.depth_mm), []).append(rows[one.name]["oracle"])
    out = []
    for (exponent, depth), here in sorted(groups.items()):
        material = "neo-Hookean" if exponent == NEO_HOOKE else f"Ogden {exponent:g}"
        n_sheared = sum("tangential" in row["default"] for row in here)
        cells = [f"{len(here)}, {n_sheared}", *(_mean([row[method] for row in here]) for method in METHODS)]
        out.append((f"{material}, {depth:g} mm", cells))
    return out


def _mean(errors: list[dict[str, float]]) -> str:
    sheared = [m["tangential"] for m in errors if "tangential" in m]
    tangential = f"{np.mean(sheared):.2f}" if sheared else "-"
    normal, total = (np.mean([m[name] for m in errors]) for name in ("normal", "resultant_n"))
    return f"{tangential}, {normal:.2f}, {1e3 * total:.0f} mN"


def means_table(rows: list[tuple[str, list[str]]]) -> str:
    """`means` as text."""
    lines = ["", f"{COLUMNS[0]:24}{COLUMNS[1]:>24}   {COLUMNS[2]:32}{COLUMNS[3]}"]
    lines += [f"{name:24}{cells[0]:>24}   {cells[1]:32}{cells[2]}" for name, cells in rows]
    return "\n".join(lines)
