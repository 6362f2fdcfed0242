"""The total force with the material that `ruffini cal fit --only material` finds, and the noise that the sensor has.

SIMULATED. The noise is measured: displacement of untouched frames that the twin renders and the real front end reads
(dots, a photometric table made of the twin's own ball presses, Poisson), whole fields of it, so with the correlation
that they have. Pads whose three numbers are each 3 % off the board's are fitted on presses of their own with this noise
and a load cell's; the benchmark's states are then judged with it, with the board's numbers and with the fitted ones.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.states import JUDGED, LIGHT_N, Recipe, State, Touch, make_states
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.material.fit import fit_material, log_from_frames
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import Material, board_slab, make_operator
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.pad_view import Pinhole
from ruffini.estimators.photometric.presses import load_presses
from ruffini.fem.operators import Noise
from ruffini.sim.recording import record_balls
from ruffini.sim.settings import TwinSettings
from ruffini.sim.unit import PadError, TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

PADS = (
    PadError(modulus=1.03, poisson=1.03, thickness=0.97),
    PadError(modulus=0.97, poisson=1.03, thickness=1.03),
    PadError(modulus=1.03, poisson=0.97, thickness=1.03),
    PadError(modulus=0.97, poisson=0.97, thickness=0.97),
)
# Presses with a reference wrench; none of them is judged.
LOGGED = (
    Recipe("ball", (Touch("sphere", 7, -1.3, 1.2),)),
    Recipe("ball sheared", (Touch("sphere", 5, 3.0, 2.4, shift=(0.1, 0.15)),)),
    Recipe("ball aside", (Touch("sphere", 6, -4.6, -2.2),)),
    Recipe("ball dragged", (Touch("sphere", 8, 1.0, -1.0, shift=(-0.6, 0.4)),)),
    Recipe("flat", (Touch("flat", 2.2, 2.6, -2.0),)),
    Recipe("flat sheared", (Touch("flat", 3.0, 1.2, -0.7, shift=(0.0, 0.1)),)),
    Recipe("flat twisted", (Touch("flat", 2.2, -2.4, 1.0, turn=0.08),)),
    Recipe("flat aside", (Touch("flat", 1.8, -4.0, 2.8, shift=(0.08, 0.0)),)),
)  # fmt: skip
LOGGED_DEPTHS_MM = (0.4, 0.8)
NOISE = Noise((5e-6, 5e-6, 20e-6), gauge_m=100e-6, tilt_m=30e-6)
N_REST_FIELDS, N_BALLS, BALL_MM, SEED = 40, 24, 5.0, 20_261_122
CELL = np.array([5e-3] * 3 + [3e-5] * 3)  # standard deviation of the reference wrench, N and N m
READING, FLOOR_N = 0.02, 0.03  # wanted: 2 % of reading + 0.03 N


def has_images(board: Board) -> bool:
    """Whether the board's displacement comes from dots and colours, so that its noise can be measured."""
    return all(board.writes(slot) for slot in ("markers", "slope", "depth"))


def colours_of(
    board: Board, *, twin: TwinSettings | None = None, n_balls: int = N_BALLS, progress: Progress = lambda _: None
) -> container.Tensors:
    """The `photometric` kind, fitted to ball presses of the board's twin, or of `twin`."""
    c = board.camera
    pinhole = Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)
    with tempfile.TemporaryDirectory() as folder:
        balls = Path(folder) / "balls"
        record_balls(TwinUnit.build(board, twin=twin), n_balls, balls, ball_mm=BALL_MM, seed=SEED, progress=progress)
        return {**tabulate(fit_photometric(collect_samples(load_presses(balls), pinhole)).model)}


def rest_noise(board: Board, *, progress: Progress = lambda _: None) -> Array:
    """Displacement that the real front end reads off untouched frames, (N_REST_FIELDS, n_y, n_x, 3) m."""
    unit = TwinUnit.build(board)
    colours = colours_of(board, progress=lambda done: progress(0.5 * done))
    file = container.pack(colours, container.base_metadata(board))
    renderer, rng = unit.renderer(), np.random.default_rng(SEED)
    fields: list[Array] = []
    with Pipeline(board, file.data) as pipeline:
        while len(fields) < N_REST_FIELDS:
            if pipeline.process(renderer.image(unit.at_rest(), rng)).has_reference:
                fields.append(pipeline.displacement_m())
            progress(0.5 + 0.5 * len(fields) / N_REST_FIELDS)
    return np.array(fields)


@dataclass(frozen=True)
class Bench:
    """A board and its measured noise."""

    board: Board
    noise: Array

    def seen(self, state: State, rng: np.random.Generator) -> Array:
        """Displacement of a state with the noise of one untouched frame."""
        return np.asarray(state.displacement + self.noise[rng.integers(len(self.noise))])

    def fit(self, error: PadError, rng: np.random.Generator) -> Material:
        """What `cal fit --only material` makes of the logged presses on a pad."""
        places = node_places(board_slab(self.board), self.board.observed)
        seen, wrench = [], []
        states = make_states(self.board, LOGGED, LOGGED_DEPTHS_MM, error)
        for i, state in enumerate(states):
            if i % len(LOGGED_DEPTHS_MM) == 0:  # untouched between two presses
                seen.append(self.noise[rng.integers(len(self.noise))])
                wrench.append(np.zeros(6))
            seen.append(self.seen(state, rng))
            wrench.append(places.wrench(state.force, np.zeros(2)) + rng.normal(size=6) * CELL)
        log = log_from_frames(np.array(seen).reshape(len(seen), -1, 3), np.array(wrench))
        return fit_material(self.board, log, NOISE).material

    def errors(self, material: Material | None, states: list[State], rng: np.random.Generator, n_seeds: int) -> Array:
        """Error of the total force over what is wanted, and itself in N, (frames, 2): the board's integers."""
        kind = make_operator(self.board, method="support", noise=NOISE, material=material)
        file = container.pack(kind.tensors, {**container.base_metadata(self.board), **kind.metadata})
        rows = []
        with Pipeline(self.board, file.data) as pipeline:
            for state in states:
                for _ in range(n_seeds):
                    u = np.round(self.seen(state, rng) / DISPLACEMENT_LSB_M)
                    steps = np.clip(u, -32767, 32767).astype(np.int16).reshape(1, -1, 3)
                    force = pipeline.solve(steps).sum(axis=(0, 1)) * (self.board.field.force_lsb_un * 1e-6)
                    error = float(np.linalg.norm(force - state.force.sum(axis=(0, 1))))
                    rows.append((error / (READING * state.resultant_n + FLOOR_N), error))
        return np.array(rows)


def run(board: Board, depths: tuple[float, ...], *, quick: bool, progress: Progress = lambda _: None) -> dict[str, Any]:
    """Measure the noise, fit each pad, judge the benchmark's states; `quick`: one pad of four, one seed."""
    bench = Bench(board, rest_noise(board, progress=lambda done: progress(0.3 * done)))
    pads, n_seeds = PADS[:1] if quick else PADS, 1 if quick else 3
    out: dict[str, Any] = {"noise": _describe(bench.noise), "wanted": [READING, FLOOR_N], "pads": [], "rows": {}}
    errors: dict[str, list[Array]] = {"board's numbers": [], "fitted": []}
    for i, pad in enumerate(pads):
        rng = np.random.default_rng((SEED, i))
        material = bench.fit(pad, rng)
        slab = board_slab(board)
        true = (slab.modulus_pa * pad.modulus, slab.poisson * pad.poisson, slab.thickness_m * pad.thickness)
        out["pads"].append([float(100 * (m / t - 1)) for m, t in zip(material, true, strict=True)])
        states = [s for s in make_states(board, JUDGED, depths, pad) if s.resultant_n >= LIGHT_N]
        for name, known in (("board's numbers", None), ("fitted", material)):
            errors[name].append(bench.errors(known, states, rng, n_seeds))
        progress(0.3 + 0.7 * (i + 1) / len(pads))
    for name, parts in errors.items():
        ratio, error = np.concatenate(parts).T
        out["rows"][name] = {
            "mean_n": float(error.mean()), "within": float(100 * np.mean(ratio <= 1)), "worst": float(ratio.max()),
            "frames": len(ratio),
        }  # fmt: skip
    return out


def _describe(noise: Array) -> dict[str, Any]:
    """Standard deviation (um) along x, y, z, and correlation of each with the node beside it."""
    beside = [float(np.mean(f[:, :, 1:] * f[:, :, :-1]) / np.mean(f**2)) for f in np.moveaxis(noise, -1, 0)]
    return {"sigma_um": (1e6 * noise.std(axis=(0, 1, 2))).tolist(), "beside": beside, "fields": len(noise)}


def table(result: dict[str, Any]) -> str:
    """The rows as text."""
    noise = result["noise"]
    sigma, beside = ("/".join(f"{v:{f}}" for v in noise[key]) for key, f in (("sigma_um", ".1f"), ("beside", ".2f")))
    lines = [
        f"total force on pads 3 % off in E, nu, thickness; noise of {noise['fields']} untouched frames through the "
        f"front end: {sigma} um, correlation with the node beside {beside}",
        "fitted less true (E, nu, thickness): "
        + "; ".join(", ".join(f"{v:+.1f} %" for v in pad) for pad in result["pads"]),
        *aligned(("", "mean error", "within 2 % + 0.03 N", "worst over that", "frames"), [
            (name, f"{1e3 * r['mean_n']:.1f} mN", f"{r['within']:.0f} %", f"{r['worst']:.2f}", r["frames"])
            for name, r in result["rows"].items()
        ], "  "),
    ]  # fmt: skip
    return "\n".join(lines)
