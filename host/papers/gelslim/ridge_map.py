"""Where the ridge of iFEM 2.0 helps: noise x weight x layers x mesh, Poisson's ratio, modulus, markers. SIMULATED.

    python -m papers.gelslim.ridge_map --out docs/results/ridge.png --table docs/results/ridge.csv

The paper says that inverting K22 is ill-conditioned and amplifies noise, and that eq. (2) mends both. It prints 8-node
hexahedra and n_e >= 2 layers: these are played, and all else is swept. Truth is the twin's: quadratic elements, finer
than any mesh here. The error is the relative L2 error of all nodal forces, mean of the states. The weight is the best
one on these very states: no rule that chooses it can reach more.

Why it does not help: with K22 = V diag(k) V^T, raw is F1 = S U1, S = K11 - K12 K22^-1 K21, and the ridge is
    S_w = S + K12 V diag(1 / k - k / (k^2 + w)) V^T K21.
The second term is positive semidefinite and grows with w, so that no eigenvalue of S_w is below that of S: white noise
of one size in all components gives a force noise of sigma |S_w|, which is never below sigma |S|. Noise reaches F1 by
K11, which the ridge leaves alone, less what the layers below take up, which it lowers. The ridge makes the pad stiffer:
it can help only where the model is softer than the pad.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg as la

from papers.drawing import METHOD, OURS, PAPER, plots, save
from ruffini.bench.disturbance import Disturbance
from ruffini.bench.markers import LostMarkers
from ruffini.bench.states import JUDGED, LIGHT_N, State, make_states
from ruffini.boards import Board, find_board
from ruffini.estimators.operator.fit import board_slab
from ruffini.estimators.operator.marker_lattice import NodesOnLattice
from ruffini.fem.condense import CondensedSlab, condense
from ruffini.files import write_whole
from ruffini.sim.unit import PadError

Array = npt.NDArray[np.float64]

WEIGHTS = (0.0, *(10.0**e for e in range(-10, 1)))  # of K22's largest eigenvalue squared; 0 is raw
NOISES_UM = ((0.0, 0.0, 0.0), (1.25, 1.25, 5.0), (5.0, 5.0, 20.0), (20.0, 20.0, 80.0))
MESHES = ((16, 13), (21, 17), (31, 25))
LAYERS = (2, 4, 6)
POISSON = (0.45, 0.48, 0.49, 0.499)
STIFFER = (0.9, 1.1, 1.3)  # the true modulus over the model's
PITCHES_MM = (1.0, 2.0, 3.0)
LOST = (0.0, 0.1, 0.3)
CORRELATED_UM = ((1.25, 1.25, 5.0), (5.0, 5.0, 20.0))
SHOWN = tuple(i for i, weight in enumerate(WEIGHTS) if 1e-7 < weight < 0.5)  # of the weights, in the map
DEPTH_MM = 0.6
HELPS = 0.05  # of the error, from which on the ridge is said to help
SEED = 31
ELEMENTS = {"hexahedra": False, "B-bar": True}


@dataclass(frozen=True)
class Pad:
    """A condensed slab, ready for all weights: per parity class its basis, K11, K12, eigenvalues and modes of K22."""

    classes: list[tuple[Any, Array, Any, Array, Array]]
    largest: float

    @classmethod
    def of(cls, condensed: CondensedSlab) -> Pad:
        parts = zip(condensed.bases, condensed.k_11, condensed.k_12, condensed.k_22, strict=True)
        classes = [(q, k_11, k_12, *la.eigh(k_22)) for q, k_11, k_12, k_22 in parts]
        return cls(classes, max(float(values[-1]) for *_, values, _ in classes))

    @property
    def condition(self) -> float:
        """Of K22."""
        return self.largest / min(float(values[0]) for *_, values, _ in self.classes)

    def forces(self, displacement: Array) -> Array:
        """F1 (weights, 3 n, m) of U1 (3 n, m) by eq. (2); the first weight is eq. (1)."""
        out = np.zeros((len(WEIGHTS), *displacement.shape))
        for q, k_11, k_12, values, modes in self.classes:
            own = q.T @ displacement
            direct, pushed = k_11 @ own, modes.T @ -(k_12.T @ own)
            for i, weight in enumerate(WEIGHTS):
                gain = values / (values**2 + weight * self.largest**2)
                out[i] += q @ (direct + k_12 @ (modes @ (gain[:, None] * pushed)))
        return out


@dataclass(frozen=True)
class Cell:
    """One pad and one disturbance: relative L2 error of all states by weight, of all, tangential and normal forces.

    noise, signal : mean size of the force that comes of the noise alone, and error without noise, over the true force.
    """

    varied: str
    element: str
    mesh: tuple[int, int]
    layers: int
    poisson: float
    noise_um: float
    condition: float
    error: Array
    tangential: Array
    normal: Array
    noise: Array
    signal: Array

    @property
    def pad(self) -> tuple[str, tuple[int, int], int]:
        return self.element, self.mesh, self.layers

    @property
    def best(self) -> int:
        return int(np.argmin(self.error))

    @property
    def gain(self) -> float:
        """By how much the best weight lowers raw's error."""
        return float(1 - self.error[self.best] / self.error[0])


def judged(pad: Pad, states: list[State], seen: Array, named: dict[str, Any], stiffer: float = 1.0) -> Cell:
    """seen : (3 n, states) as measured; stiffer : the true modulus over the model's."""
    shape = states[0].force.shape
    true = stiffer * np.stack([s.force.ravel() for s in states], axis=1)
    exact = np.stack([s.displacement.ravel() for s in states], axis=1)
    found = pad.forces(np.hstack([seen, exact, seen - exact]))
    n = len(states)
    size = np.linalg.norm(true, axis=0)
    off = found[..., :n] - true
    split = off.reshape(len(WEIGHTS), *shape, n)
    parts = true.reshape(*shape, n) ** 2
    shear, press = np.sqrt(parts[:, :, :2].sum(axis=(0, 1, 2))), np.sqrt(parts[:, :, 2].sum(axis=(0, 1)))
    tangential = np.sqrt((split[:, :, :, :2] ** 2).sum(axis=(1, 2, 3)))
    return Cell(
        **named, condition=pad.condition, error=(np.linalg.norm(off, axis=1) / size).mean(axis=1),
        tangential=(tangential / np.maximum(shear, 0.05 * size)).mean(axis=1),
        normal=(np.sqrt((split[:, :, :, 2] ** 2).sum(axis=(1, 2))) / press).mean(axis=1),
        noise=(np.linalg.norm(found[..., 2 * n :], axis=1) / size).mean(axis=1),
        signal=(np.linalg.norm(found[..., n : 2 * n] - true, axis=1) / size).mean(axis=1),
    )  # fmt: skip


def meshed(board: Board, mesh: tuple[int, int], layers: int, poisson: float | None = None) -> Board:
    """The board with another mesh and Poisson's ratio."""
    grid = board.grid.model_copy(update={"n_x": mesh[0], "n_y": mesh[1], "n_layers": layers})
    pad = board.pad if poisson is None else board.pad.model_copy(update={"poisson_1e4": round(1e4 * poisson)})
    return board.model_copy(update={"grid": grid, "pad": pad})


def touched(board: Board, error: PadError | None = None) -> list[State]:
    return [s for s in make_states(board, JUDGED, (DEPTH_MM,), error) if s.resultant_n >= LIGHT_N]


def white(states: list[State], noise_um: tuple[float, float, float]) -> Array:
    """(3 n, states): the same noise for every pad of one mesh."""
    rng = np.random.default_rng(SEED)
    noise = [rng.normal(size=s.displacement.shape) * np.array(noise_um) * 1e-6 for s in states]
    return np.stack([(s.displacement + e).ravel() for s, e in zip(states, noise, strict=True)], axis=1)


def sweep(board: Board) -> Iterator[Cell]:
    """Noise x layers x mesh for both elements; then, at the board's mesh and noise, Poisson's ratio and markers."""
    usual, middle = (board.grid.n_x, board.grid.n_y), NOISES_UM[2]
    own = board.pad.poisson_1e4 * 1e-4
    states = {mesh: touched(meshed(board, mesh, board.grid.n_layers)) for mesh in MESHES}
    pads: dict[str, Pad] = {}
    for element, is_b_bar in ELEMENTS.items():
        for mesh in MESHES:
            for layers in LAYERS:
                pad = Pad.of(condense(board_slab(meshed(board, mesh, layers)), b_bar=is_b_bar))
                if (mesh, layers) == (usual, board.grid.n_layers):
                    pads[element] = pad
                for noise_um in NOISES_UM:
                    named = {"varied": "mesh", "element": element, "mesh": mesh, "layers": layers, "poisson": own,
                             "noise_um": noise_um[2]}  # fmt: skip
                    yield judged(pad, states[mesh], white(states[mesh], noise_um), named)
    named = {"mesh": usual, "layers": board.grid.n_layers, "noise_um": middle[2]}
    for poisson in POISSON:
        other = states[usual] if poisson == own else touched(board, PadError(poisson=poisson / own))
        for element, is_b_bar in ELEMENTS.items():
            pad = Pad.of(condense(board_slab(meshed(board, usual, board.grid.n_layers, poisson)), b_bar=is_b_bar))
            varied = {"varied": "Poisson's ratio", "element": element, "poisson": poisson}
            yield judged(pad, other, white(other, middle), {**named, **varied})
    named["poisson"] = own
    for factor in STIFFER:
        for element, pad in pads.items():
            varied = {"varied": f"true modulus {factor:g} times the model's", "element": element}
            yield judged(pad, states[usual], white(states[usual], middle), {**named, **varied}, factor)
    for correlated_um in CORRELATED_UM:
        noise, rng = Disturbance(correlated_um=correlated_um), np.random.default_rng(SEED)
        seen = np.stack(
            [(s.displacement + noise.draw(s.displacement.shape, rng)).ravel() for s in states[usual]], axis=1
        )
        for element, pad in pads.items():
            varied = {"varied": "correlated noise", "element": element, "noise_um": correlated_um[2]}
            yield judged(pad, states[usual], seen, {**named, **varied})
    for what, markers, lost in _markers(board):
        seen_by = board.model_copy(update={"markers": markers})
        there = touched(seen_by)
        lattice, rng = NodesOnLattice(seen_by, markers), np.random.default_rng(SEED)
        seen = np.stack([
            LostMarkers(lost, middle).observe(lattice, s.displacement, s.at_markers, rng).ravel()
            for s in there if s.at_markers is not None
        ], axis=1)  # fmt: skip
        for element, pad in pads.items():
            yield judged(pad, there, seen, {**named, "varied": what, "element": element})


def _markers(board: Board) -> Iterator[tuple[str, Any, float]]:
    """Lattices over the same part of the pad, coarser and with lost markers."""
    own = board.markers
    assert own is not None
    for pitch_mm in PITCHES_MM:
        pitch = round(1e3 * pitch_mm)
        n_x, n_y = (1 + (n - 1) * p // pitch for n, p in ((own.n_x, own.pitch_x_um), (own.n_y, own.pitch_y_um)))
        changed = {"n_x": n_x, "n_y": n_y, "pitch_x_um": pitch, "pitch_y_um": pitch,
                   "first_x_um": (board.pad.size_x_um - (n_x - 1) * pitch) // 2,
                   "first_y_um": (board.pad.size_y_um - (n_y - 1) * pitch) // 2}  # fmt: skip
        for lost in LOST if pitch_mm == PITCHES_MM[0] else (0.0,):
            what = f"markers {pitch_mm:g} mm apart" + (f" and {100 * lost:.0f} % lost" if lost else "")
            yield what, own.model_copy(update=changed), lost


COLUMNS = (
    "varied", "element", "nodes_x", "nodes_y", "layers", "poisson", "noise_z_um", "condition_of_k22", "raw",
    "best_ridge", "weight", "better_percent", "tangential_raw", "tangential_best", "normal_raw", "normal_best",
)  # fmt: skip


def line(c: Cell) -> str:
    """Its row of the table; weight 0 is raw. The last four at the weight that is best for each."""
    values = (
        *c.mesh, c.layers, c.poisson, c.noise_um, round(c.condition), c.error[0], c.error[c.best], WEIGHTS[c.best],
        100 * c.gain, c.tangential[0], c.tangential.min(), c.normal[0], c.normal.min(),
    )  # fmt: skip
    return ",".join([c.varied, c.element, *(f"{value:.4g}" for value in values)])


def verdict(cells: list[Cell]) -> list[str]:
    """What the sweep says, in sentences made of its numbers."""
    soft = [c for c in cells if c.varied.startswith("true modulus")]
    right = [c for c in cells if c not in soft]
    most, of_soft = max(right, key=lambda c: c.gain), max(soft, key=lambda c: c.gain)
    least_noise = min(float((c.noise / c.noise[0]).min()) for c in right if c.noise_um > 0)
    parts = [
        max(1 - float(v.min() / v[0]) for v in (getattr(c, what) for c in right)) for what in ("tangential", "normal")
    ]
    return [
        f"With its best weight the ridge lowers the error by {100 * HELPS:.0f} % or more in "
        f"{sum(c.gain >= HELPS for c in right)} of {len(right)} cells with the right modulus, most by "
        f"{100 * most.gain:.1f} % ({most.varied}, {most.element}, {most.mesh[0]} x {most.mesh[1]} nodes, "
        f"{most.layers} layers, noise {most.noise_um:g} um); raw is best in {sum(c.best == 0 for c in right)}. "
        f"Tangential and normal error alone, each with its own best weight, fall by at most {100 * parts[0]:.1f} and "
        f"{100 * parts[1]:.1f} %.",
        f"Force noise at the best weight for it is at least {least_noise:.3f} of raw's.",
        f"With a model that is too soft it lowers the error by up to {100 * of_soft.gain:.1f} % ({of_soft.varied}, "
        f"{of_soft.element}).",
        f"K22's condition number is {min(c.condition for c in cells):.0f} to {max(c.condition for c in cells):.0f}.",
    ]


def draw(cells: list[Cell], path: Path) -> Path:
    """Error over raw's by weight, of every mesh and noise; below, why, and the same of what else was varied."""
    swept = [c for c in cells if c.varied == "mesh"]
    figure, axes = plots().subplots(2, 2, figsize=(14, 17), height_ratios=(2.6, 1))
    for panel, element in zip(axes[0], ELEMENTS, strict=True):
        rows = [c for c in swept if c.element == element]
        ratio = np.array([[c.error[i] / c.error[0] for i in SHOWN] for c in rows])
        panel.imshow(np.log2(ratio), cmap="RdBu_r", vmin=-2, vmax=2, aspect="auto")
        panel.set_xticks(range(len(SHOWN)), [f"{WEIGHTS[i]:.0e}" for i in SHOWN])
        labels = [f"{c.mesh[0]} x {c.mesh[1]}, {c.layers} layers, {c.noise_um:g} um: {c.error[0]:.2f}" for c in rows]
        panel.set_yticks(range(len(rows)), labels, fontsize=7)
        panel.set_title(f"{element}: error over raw's (blue: it helps)", loc="left", fontsize=9)
        panel.set_ylabel("nodes, layers, noise along z: error of raw")
        for (y, x), value in np.ndenumerate(ratio):
            colour = "white" if abs(np.log2(value)) > 1.4 else "black"
            panel.text(x, y, f"{value:.3g}", ha="center", va="center", fontsize=7, color=colour)
    x = np.array([WEIGHTS[1] / 10, *WEIGHTS[1:]])
    usual = next(c for c in swept if c.pad == ("B-bar", MESHES[-1], LAYERS[-1]) and c.noise_um == NOISES_UM[2][2])
    curves = {
        "error": (usual.error, OURS),
        "of the noise alone": (usual.noise, PAPER),
        "no noise": (usual.signal, METHOD),
    }
    for what, (values, colour) in curves.items():
        axes[1, 0].loglog(x, values, "o-", color=colour, label=what)
    axes[1, 0].set_title("why: B-bar, 31 x 25, 6 layers, 20 um")
    for c in (c for c in cells if c.varied != "mesh" and c.element == "B-bar"):
        number = {"Poisson's ratio": f" {c.poisson:g}", "correlated noise": f" {c.noise_um:g} um"}.get(c.varied, "")
        name = c.varied + number
        style = "-" if c.varied.startswith(("Poisson", "markers")) else "--"
        axes[1, 1].loglog(x, c.error / c.error[0], style, label=name)
    axes[1, 1].axhline(1, color="black", linewidth=0.5)
    axes[1, 1].set_ylim(0.7, 5)
    axes[1, 1].set_title("error over raw's: B-bar, 31 x 25, 6 layers, 20 um")
    for panel in axes.flat:
        panel.set_xlabel("weight, of K22's largest eigenvalue squared")
    for panel in axes[1]:
        panel.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(figure, path, "Ridge (iFEM 2.0) against raw")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--out", type=Path, required=True, help="the picture")
    parser.add_argument("--table", type=Path, required=True, help="CSV of every cell")
    given = parser.parse_args()
    cells = []
    for cell in sweep(find_board(given.board)):
        cells.append(cell)
        print(line(cell), file=sys.stderr, flush=True)
    given.table.parent.mkdir(parents=True, exist_ok=True)
    write_whole(given.table, ("\n".join([",".join(COLUMNS), *map(line, cells)]) + "\n").encode())
    print("\n".join([*verdict(cells), str(draw(cells, given.out))]))


if __name__ == "__main__":
    main()
