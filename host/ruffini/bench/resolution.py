"""Resolution of the normal force field: a modulation transfer curve, and two lines nearer and nearer. SIMULATED.

Truth is the twin's pad, linear, on a mesh of its own: quadratic elements with FINER nodes to a node step of the board
across the lines of pressure, coarse along them. The board observes sideways displacement at its markers and depth at
its nodes, with the bench's white noise; judged is the field that its integers make of that, beside iFEM without a prior
("raw") and the true nodal forces ("exact"). The pictures' own blur is not in it.

Response: the pressure MEAN_STRESS E (1 + cos(2 pi f x + phase)), which pulls nowhere, fades out before the depth
gauge's margin. It moves by PHASES equal steps, and each node's force follows it. The response is the first harmonic of
that force over a node's area, in phase with the true amplitude, over the true amplitude; the mean of noisy repeats.
Noise does not raise it, and f may exceed the nodes' limit of 1 / (2 steps): a presampled modulation transfer function,
as of X-ray detectors (IEC 62220-1). The curve of "exact" is a node's average over its surroundings. Half response: the
lower of the frequencies at which the responses along x and y fall to HALF; that axis is the one shown.

Told apart: two parallel lines, LINE_WIDTH_MM wide at half their height (a row of the truth, if that is wider), press
with LINE_N each. The nodal forces, averaged along the lines, have a maximum on each side of the middle, at most half
the distance from its line, and between the two a force at least DIP below the lower one (Rayleigh). The smallest
distance is the one from which on this holds in ENOUGH of the noisy repeats for lines along x and along y and at each of
OFFSETS places between two nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.markers import LostMarkers
from ruffini.bench.states import Recipe, State, on_board
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.errors import InputError
from ruffini.estimators.material.stage import material_noise
from ruffini.estimators.operator.fit import board_slab, board_window_m, make_operator
from ruffini.estimators.operator.marker_lattice import NodesOnLattice
from ruffini.fem.operators import force_operator
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.settings import load_twin
from ruffini.sim.surface import hat_areas, hat_shares
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Estimate = Callable[[Array], Array]
Progress = Callable[[float], None]

AXES = ("x", "y")  # across the lines
SEED = 53
# The truth's mesh: no whole number of its nodes to one of the board's, so that none repeats the other's error.
FINER = 4.4
COARSE_M = 4e-3  # elements along the lines
LAYERS = (0.04, 0.07, 0.11, 0.18, 0.26, 0.34)  # of the thickness, from the surface down: short waves end near it
# Of the half window: where pressure starts to fade, and ends. The margin that the depth gauge takes as free is free.
FLAT, END = 0.4, 0.8
MEAN_STRESS = 0.1  # mean pressure over E: some 2 N on a pad of 20 x 16 mm
PHASES = 5
FREQUENCIES = np.arange(0.1, 1.21, 0.1)  # of the nodes' own limit
HALF = 0.5
LINE_WIDTH_MM = 0.3
LINE_N = 0.5
METHODS = ("default", "raw", "exact")
DISTANCES_MM = np.round(np.arange(0.4, 4.01, 0.1), 1)
OFFSETS = 4
DIP = 0.265  # of two Airy discs at Rayleigh's distance; 0.19 of two slits
ENOUGH = 0.95


@dataclass(frozen=True)
class Truth:
    """What each unit of pressure on a fine row across the lines does; the rows add up.

    `across_mm` (k,) places of the rows; `along_mm` and `along` (m,) how the pressure fades along them, linear between;
    `area_m2` (k,) of each row's pressure; `force`, `displacement` and `at_markers` as in `State`, for 1 Pa on each row,
    (k, ...).
    """

    across_mm: Array
    along_mm: Array
    along: Array
    area_m2: Array
    force: Array
    displacement: Array
    at_markers: Array | None

    def state(self, pressure_pa: Array) -> State:
        """Of a pressure on each row, (k,)."""

        def add(rows: Array) -> Array:
            return np.tensordot(pressure_pa, rows, axes=1)

        moved = None if self.at_markers is None else add(self.at_markers)
        return State(Recipe("lines", ()), 0.0, add(self.force), add(self.displacement), moved)


def fade(place: Array, half: float) -> Array:
    """1 within FLAT of the half window, a cosine's half down to 0 at END."""
    t = np.clip((np.abs(place) / half - FLAT) / (END - FLAT), 0, 1)
    return np.asarray((1 + np.cos(np.pi * t)) / 2)


def half_window_m(board: Board) -> tuple[float, float]:
    """From the pad's centre to the nearer border of what the camera sees, along x and y."""
    low_x, low_y, high_x, high_y = board_window_m(board)
    x, y = board.pad.size_x_um * 0.5e-6, board.pad.size_y_um * 0.5e-6
    return min(x - low_x, high_x - x), min(y - low_y, high_y - y)


def node_step_m(board: Board) -> tuple[float, float]:
    """Distance of two nodes along x and y."""
    pad, grid = board.pad, board.grid
    return pad.size_x_um * 1e-6 / (grid.n_x - 1), pad.size_y_um * 1e-6 / (grid.n_y - 1)


def make_truth(board: Board, axis: int) -> Truth:
    """Solve the pad with a mesh that is fine along `axis` (0: x, 1: y) (seconds)."""
    twin = load_twin(board).with_pad(strain="linear", is_relaxing=False)
    pad = board.pad
    sizes = np.array([pad.size_x_um, pad.size_y_um]) * 1e-6
    cells = np.ceil(sizes / COARSE_M).astype(int)
    cells[axis] = np.ceil(sizes[axis] / (2 * node_step_m(board)[axis] / FINER))
    model = PadModel(
        sizes[0], sizes[1], pad.thickness_um * 1e-6, pad.modulus_pa, pad.poisson_1e4 * 1e-4,
        int(cells[0]), int(cells[1]), LAYERS,
    )  # fmt: skip
    unit = TwinUnit(board, twin, model, surface_compliance(model))
    fine_m = (model.node_x(), model.node_y())
    along = fade(fine_m[1 - axis], half_window_m(board)[1 - axis])
    n_y, n_x = model.shape
    rows = np.zeros((len(fine_m[axis]), n_y, n_x))
    for k in range(len(rows)):
        if axis == 0:
            rows[k, :, k] = along
        else:
            rows[k, k, :] = along
    hats = rows.reshape(len(rows), -1) * hat_areas(model)
    moved = unit.compliance[:, 2::3] @ (hat_shares(model) @ -hats.T)
    states = [on_board(unit, _downwards(hat), u.reshape(-1, 3)) for hat, u in zip(hats, moved.T, strict=True)]
    at_markers = np.stack([s["at_markers"] for s in states]) if "at_markers" in states[0] else None
    return Truth(
        fine_m[axis] * 1e3, fine_m[1 - axis] * 1e3, along, hats.sum(axis=1), np.stack([s["force"] for s in states]),
        np.stack([s["displacement"] for s in states]), at_markers,
    )  # fmt: skip


def _downwards(hat: Array) -> Array:
    return np.column_stack([np.zeros_like(hat), np.zeros_like(hat), -hat])


def line(across_mm: Array, area_m2: Array, place_mm: float, force_n: float) -> Array:
    """Pressure of a line, (k,) Pa: a cosine's hump, LINE_WIDTH_MM wide at half its height."""
    t = np.clip((across_mm - place_mm) / LINE_WIDTH_MM, -1, 1)
    shape = (1 + np.cos(np.pi * t)) / 2
    return np.asarray(shape * (force_n / float(shape @ area_m2)))


def response(forces: Array, wave: Array) -> float:
    """Part of the amplitude that is left in `forces` (phases, ...) where it should be `wave` (...), complex.

    The phase of forces[j] is 2 pi j / phases ahead of that of the first.
    """
    turn = np.exp(-2j * np.pi * np.arange(len(forces)) / len(forces))
    found = np.tensordot(turn, forces, axes=1) * (2 / len(forces))
    return float(np.vdot(wave, found).real / np.vdot(wave, wave).real)


def falls_to(frequency: Array, curve: Array, level: float = HALF) -> float | None:
    """Where the curve first falls to a level beyond its peak, between two points on a line; None: nowhere.

    A curve that is below the level everywhere has fallen before its first point: 0.
    """
    if curve.max() < level:
        return 0.0
    for i in range(int(np.argmax(curve)), len(curve) - 1):
        if curve[i] >= level > curve[i + 1]:
            share = (curve[i] - level) / (curve[i] - curve[i + 1])
            return float(frequency[i] + share * (frequency[i + 1] - frequency[i]))
    return None


def are_apart(pressing: Array, place_mm: Array, lines_mm: tuple[float, float]) -> bool:
    """True if forces (n,) at places (n,), positive where pressed, show two lines and not one: "told apart" above."""
    distance, middle = lines_mm[1] - lines_mm[0], sum(lines_mm) / 2
    sides = [np.flatnonzero(place_mm < middle), np.flatnonzero(place_mm >= middle)]
    peaks = [int(side[np.argmax(pressing[side])]) for side in sides]
    if any(abs(place_mm[p] - at) > distance / 2 for p, at in zip(peaks, lines_mm, strict=True)):
        return False
    lower = min(pressing[p] for p in peaks)
    valley = pressing[peaks[0] : peaks[1] + 1].min()
    return bool(lower > 0 and valley <= (1 - DIP) * lower)


def smallest_distance(distance_mm: Array, share: Array) -> float | None:
    """The distance from which on `share` (distances, ...) is ENOUGH everywhere; None: not even the largest is."""
    good = share.reshape(len(share), -1).min(axis=1) >= ENOUGH
    if not good[-1]:
        return None
    bad = np.flatnonzero(~good)
    return float(distance_mm[0 if not len(bad) else bad[-1] + 1])


class Observer:
    """What the board sees of a state with noise, and what it, and iFEM without a prior, make of it."""

    def __init__(self, board: Board, progress: Progress = lambda _: None) -> None:
        self.board = board
        noise = material_noise(board)
        method = "support" if board.writes("residual") else "optimal"
        kind = make_operator(board, method=method, noise=noise, progress=progress)
        file = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata})
        self._raw = force_operator(board_slab(board), "raw", noise=noise, window_m=board_window_m(board))
        self._pipeline = Pipeline(board, file.data)
        self._lattice = None if board.markers is None else NodesOnLattice(board, board.markers)

    def close(self) -> None:
        self._pipeline.close()

    def see(self, state: State, rng: np.random.Generator) -> Array:
        """Displacement of the observed nodes, (n_y, n_x, 3) m."""
        if self._lattice is None or state.at_markers is None:
            u = state.displacement + Disturbance(WHITE_UM).draw(state.displacement.shape, rng)
        else:
            u = LostMarkers(0.0, WHITE_UM).observe(self._lattice, state.displacement, state.at_markers, rng)
        return np.asarray(u[self.board.observed])

    def vectors(self) -> dict[str, Estimate]:
        """Force at each node (n_y, n_x, 3), newtons, of what was seen."""
        return {"default": self._as_the_board, "raw": self._without_prior}

    def estimates(self) -> dict[str, Estimate]:
        """Normal force (n_y, n_x), newtons, of what was seen."""
        return {"default": lambda u: self._as_the_board(u)[..., 2], "raw": lambda u: self._without_prior(u)[..., 2]}

    def _as_the_board(self, u: Array) -> Array:
        steps = np.clip(np.round(u / DISPLACEMENT_LSB_M), -32767, 32767).astype(np.int16)
        force = self._pipeline.solve(steps.reshape(1, -1, 3)).reshape(u.shape)
        return np.asarray(force * (self.board.field.force_lsb_un * 1e-6))

    def _without_prior(self, u: Array) -> Array:
        return np.asarray((self._raw @ u.ravel()).reshape(u.shape))


@dataclass(frozen=True)
class Nodes:
    """The observed nodes: places along x and y from the pad's centre, mm."""

    x_mm: Array
    y_mm: Array

    @classmethod
    def of(cls, board: Board) -> Nodes:
        pad, grid = board.pad, board.grid
        rows, columns = board.observed
        x = np.linspace(-0.5, 0.5, grid.n_x)[columns] * pad.size_x_um * 1e-3
        return cls(x, np.linspace(-0.5, 0.5, grid.n_y)[rows] * pad.size_y_um * 1e-3)

    def across(self, axis: int) -> Array:
        return self.x_mm if axis == 0 else self.y_mm

    def waves(self, axis: int, values: Array, along: Array) -> Array:
        """A field (n_y, n_x) of values across the lines times values along them."""
        return np.outer(along, values) if axis == 0 else np.outer(values, along)


def no_flat_field(board: Board) -> str:
    """Why the board computes no field of forces of a flat pad, in one sentence; empty if it does.

    Raises
    ------
    InputError
        The board has no twin.
    """
    if not board.writes("node_forces"):
        return f"board {board.name!r} measures no field of forces: no stage of it writes node_forces"
    if (kind := load_twin(board).shape.kind) != "plane":
        return f"board {board.name!r} is a {kind}: this is measured on flat pads"
    return ""


def refusal(board: Board) -> str:
    """Why the resolution of this board cannot be measured, in one sentence; empty if it can.

    Raises
    ------
    InputError
        The board has no twin.
    """
    if refused := no_flat_field(board):
        return refused
    coarsest_mm, most_mm = 1e3 * max(node_step_m(board)), 2 * FINER * LINE_WIDTH_MM  # else a line may miss all rows
    if coarsest_mm > most_mm:
        return (
            f"board {board.name!r} has nodes {coarsest_mm:.1f} mm apart: lines {LINE_WIDTH_MM} mm wide need at most "
            f"{most_mm:.1f} mm"
        )
    return ""


def run(board: Board, *, quick: bool, progress: Progress = lambda _: None) -> dict[str, Any]:
    """Response by frequency and axis, half frequency, share of lines told apart by distance, smallest distance.

    Raises
    ------
    InputError
        It cannot be measured: `refusal`.
    """
    if refused := refusal(board):
        raise InputError(refused)
    truths = []
    for axis in range(len(AXES)):
        truths.append(make_truth(board, axis))
        progress(0.2 * (axis + 1))
    observer = Observer(board, lambda done: progress(0.4 + 0.3 * done))
    try:
        limit = 0.5e-3 / max(node_step_m(board))
        frequency = FREQUENCIES * limit
        curves = [
            curves_of(board, observer, truth, axis, frequency, 2 if quick else 8) for axis, truth in enumerate(truths)
        ]
        progress(0.8)
        shares = [shares_of(board, observer, truth, axis, 20 if quick else 60) for axis, truth in enumerate(truths)]
        progress(1.0)
    finally:
        observer.close()
    methods: dict[str, Any] = {}
    for name in METHODS:
        worse, half = worse_axis(frequency, [curve[name] for curve in curves])
        share = np.stack([s[name] for s in shares], axis=1)  # distances, axes, offsets
        methods[name] = {
            "response": {axis: curve[name].tolist() for axis, curve in zip(AXES, curves, strict=True)},
            "worse_axis": worse,
            "half_per_mm": half,
            "apart": share.min(axis=(1, 2)).tolist(),
            "apart_mm": smallest_distance(DISTANCES_MM, share),
        }
    return {
        "board": board.name, "simulated": True, "quick": quick, "truth": "linear", "noise_um": WHITE_UM,
        "node_limit_per_mm": limit,
        "is_measured": "force_z" not in board.board.not_measured, "frequency_per_mm": frequency.tolist(),
        "distance_mm": DISTANCES_MM.tolist(), "methods": methods,
    }  # fmt: skip


def part(board: Board, *, quick: bool, progress: Progress) -> dict[str, Any]:
    """`run` as a part of a longer bench, which a refusal must not cost: then {"refused": the sentence}."""
    refused = refusal(board)
    return {"refused": refused} if refused else run(board, quick=quick, progress=progress)


def worse_axis(frequency: Array, curves: list[Array]) -> tuple[str, float | None]:
    """The axis whose response falls to HALF first, and where; None: neither falls."""
    falls = [falls_to(frequency, curve) for curve in curves]
    place = int(np.argmin([np.inf if fall is None else fall for fall in falls]))
    return AXES[place], falls[place]


def curves_of(
    board: Board, observer: Observer, truth: Truth, axis: int, frequency: Array, n_repeats: int
) -> dict[str, Array]:
    """Of each method the response at each frequency, the mean over noisy repeats."""
    nodes, half = Nodes.of(board), 1e3 * half_window_m(board)[axis]
    fine, fine_mm = truth.across_mm, float(truth.across_mm[1] - truth.across_mm[0])
    along = np.interp(nodes.across(1 - axis), truth.along_mm, truth.along)
    at = nodes.across(axis)
    mean_pa, area = MEAN_STRESS * board.pad.modulus_pa, float(np.prod(node_step_m(board)))
    out: dict[str, list[float]] = {}
    for i, f in enumerate(frequency):
        # The truth's own pressure is bilinear between its rows: its wave is smaller than that of its nodes.
        true = -mean_pa * np.sinc(f * fine_mm) ** 2 * area * fade(at, half) * np.exp(2j * np.pi * f * at)
        wave = nodes.waves(axis, true, along)
        phases = 2 * np.pi * np.arange(PHASES) / PHASES
        states = [
            truth.state(mean_pa * fade(fine, half) * (1 + np.cos(2 * np.pi * f * fine + phase))) for phase in phases
        ]
        exact = np.stack([s.force[board.observed][..., 2] for s in states])
        out.setdefault("exact", []).append(response(exact, wave))
        found: dict[str, list[float]] = {}
        for repeat in range(n_repeats):
            rng = np.random.default_rng((SEED, axis, i, repeat))
            seen = [observer.see(s, rng) for s in states]
            for name, estimate in observer.estimates().items():
                field = np.stack([estimate(u) for u in seen])
                found.setdefault(name, []).append(response(field, wave))
        for name, values in found.items():
            out.setdefault(name, []).append(float(np.mean(values)))
    return {name: np.array(values) for name, values in out.items()}


def shares_of(board: Board, observer: Observer, truth: Truth, axis: int, n_repeats: int) -> dict[str, Array]:
    """Of each method the share of noisy repeats in which the lines are told apart, (distances, OFFSETS)."""
    nodes, step_mm = Nodes.of(board), 1e3 * node_step_m(board)[axis]
    at, other = nodes.across(axis), nodes.across(1 - axis)
    middle = np.abs(other) <= 1e3 * FLAT * half_window_m(board)[1 - axis]
    out = {name: np.zeros((len(DISTANCES_MM), OFFSETS)) for name in METHODS}

    def apart(field: Array, lines: tuple[float, float]) -> bool:
        profile = field[middle].mean(axis=0) if axis == 0 else field[:, middle].mean(axis=1)
        return are_apart(-profile, at, lines)

    press = partial(line, truth.across_mm, truth.area_m2, force_n=LINE_N)
    for i, distance in enumerate(DISTANCES_MM):
        for k in range(OFFSETS):
            offset = step_mm * k / OFFSETS
            lines = (offset - distance / 2, offset + distance / 2)
            state = truth.state(press(place_mm=lines[0]) + press(place_mm=lines[1]))
            out["exact"][i, k] = n_repeats * apart(state.force[board.observed][..., 2], lines)
            for repeat in range(n_repeats):
                seen = observer.see(state, np.random.default_rng((SEED, axis, i, k, repeat)))
                for name, estimate in observer.estimates().items():
                    out[name][i, k] += apart(estimate(seen), lines)
    return {name: count / n_repeats for name, count in out.items()}


def named(result: dict[str, Any]) -> str:
    """The board, and what its row takes for granted."""
    return str(result["board"]) + ("" if result["is_measured"] else ", its depth calibrated")


def cells(result: dict[str, Any], name: str) -> tuple[str, str]:
    """Smallest distance and half frequency of a method as text."""
    found = result["methods"][name]
    apart, half = found["apart_mm"], found["half_per_mm"]
    most_mm, (least, *_, most) = result["distance_mm"][-1], result["frequency_per_mm"]
    limit = f"> {most:.2f}" if half is None else f"< {least:.2f}" if half < least else f"{half:.2f}"
    return f"> {most_mm:.1f} mm" if apart is None else f"{apart:.1f} mm", f"{limit} / mm"


def table(result: dict[str, Any]) -> str:
    """The result of `run` or `part` as text."""
    if "refused" in result:
        return f"resolution: not measured: {result['refused']}"
    noise = "/".join(f"{v:g}" for v in result["noise_um"])
    picked = range(0, len(result["frequency_per_mm"]), 2)
    rows = []
    for name, found in result["methods"].items():
        curve = found["response"][found["worse_axis"]]
        rows.append((name, *cells(result, name), *(f"{curve[i]:.2f}" for i in picked)))
    head = ("", "lines told apart at", "half response at", *(f"{result['frequency_per_mm'][i]:.2f}" for i in picked))
    return "\n".join([
        f"{named(result)}: resolution of the normal force field, linear pad, noise {noise} um, "
        f"two lines of {LINE_N:g} N; "
        f"response by spatial frequency per mm (nodes' limit {result['node_limit_per_mm']:.2f})",
        *aligned(head, rows, "  "),
    ])  # fmt: skip
