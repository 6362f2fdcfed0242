"""What the front end's displacement is off: at rest, and under a touch.

Untouched frames show the noise of camera, markers and colours. Under a touch the displacement is off by more: the dots
of a sheared patch, colours beyond what was pressed. How much follows from what the best forces on the contact leave
unexplained, u - C F with the fitted pad. The operator weighs displacements by the larger of the two, axis by axis.

The noise's correlation is told by how much of it is left in means over BLOCK x BLOCK nodes, about as large as a
contact: white noise leaves 1 / BLOCK^2 of its variance. That part is what a wrench errs by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.log.touches import TouchLog
from ruffini.estimators.base import Estimator
from ruffini.estimators.material.fit import force_size
from ruffini.estimators.material.stage import material_noise
from ruffini.estimators.operator.fit import board_slab, board_window_m, observed_unknowns, second_pass
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.operators import Noise, force_operator
from ruffini.fem.support import support_system
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]

MIN_REST = 10  # untouched frames
LEAST_M = 0.5e-6  # four steps of the displacement: what rounding and interpolation leave at best
MAX_TOUCHES = 60  # the strongest frame of each: more tell no more
BLOCK = 4  # nodes to a side
CORRELATION_RANGE = (0.3, 6.0)  # nodes


@dataclass(frozen=True)
class Power:
    """Of displacements, by axis (3,), m^2: mean square of nodes; of means over blocks, times a block's nodes."""

    node: Array
    block: Array

    @classmethod
    def mean(cls, parts: list[Power]) -> Power:
        return cls(*(np.mean([getattr(p, name) for p in parts], axis=0) for name in ("node", "block")))


def unexplained(job: Job, log: TouchLog, noise: Noise) -> Power:
    """Mean over touches of what the second pass leaves of the displacement."""
    board = job.board
    slab, observed = board_slab(board, job.material), observed_unknowns(board)
    condensed = condense(slab)
    matrix = force_operator(slab, "optimal", noise=noise, window_m=board_window_m(board))
    estimate = second_pass(board, matrix, support_system(condensed, noise, observed, matrix))
    whole = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    compliance = whole[np.ix_(observed, observed)]
    rows, columns = board.observed
    shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
    plane = _planes(board)
    strength = force_size(log.wrench)
    frames = [np.flatnonzero(log.touch == t) for t in np.unique(log.touch)]
    last = [touch[strength[touch].argmax()] for touch in frames]
    chosen = [last[i] for i in np.unique(np.linspace(0, len(last) - 1, MAX_TOUCHES).astype(int))]
    left = []
    for u in log.displacement[chosen]:
        force, _ = estimate(u.reshape(shape))
        left.append(power_of(u - (compliance @ force.ravel()).reshape(-1, 3), plane, shape))
    return Power.mean(left)


def _planes(board: Board) -> Array:
    """The depth's constant and tilt at the observed nodes, (m, 3): they are told to the operator apart."""
    rows, columns = board.observed
    x, y = np.linspace(-1, 1, columns.stop - columns.start), np.linspace(-1, 1, rows.stop - rows.start)
    return np.stack([np.ones(len(x) * len(y)), np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)


def power_of(field: Array, plane: Array, shape: tuple[int, ...]) -> Power:
    """Of a displacement (m, 3) of nodes (n_y, n_x), without a constant and a tilt of its z."""
    z = field[:, 2] - plane @ np.linalg.lstsq(plane, field[:, 2], rcond=None)[0]
    whole = np.stack([field[:, 0], field[:, 1], z], axis=-1).reshape(shape)
    n_y, n_x = (n // BLOCK for n in shape[:2])
    blocks = whole[: n_y * BLOCK, : n_x * BLOCK].reshape(n_y, BLOCK, n_x, BLOCK, 3).mean(axis=(1, 3))
    return Power((whole**2).mean(axis=(0, 1)), BLOCK**2 * (blocks**2).mean(axis=(0, 1)))


def correlation_nodes(growth: float) -> float:
    """Length l of noise with the correlation exp(-d^2 / (4 l^2)) whose blocks vary `growth` times as white noise's."""
    place = np.stack(np.meshgrid(np.arange(BLOCK), np.arange(BLOCK)), axis=-1).reshape(-1, 2)
    square = ((place[:, None] - place[None, :]) ** 2).sum(axis=-1)

    def grown(length: float) -> float:
        return float(np.exp(-square / (4 * length**2)).sum() / BLOCK**2)

    shortest, longest = CORRELATION_RANGE
    if growth <= grown(shortest):
        return 0.0
    return (
        longest
        if growth >= grown(longest)
        else float(brentq(lambda length: grown(length) - growth, *CORRELATION_RANGE))
    )


def _text(values: Array) -> str:
    return ", ".join(f"{1e6 * v:.1f}" for v in values)


class NoiseEstimator(Estimator):
    """The noise that the operator weighs displacements by."""

    name = "noise"
    kinds = ()

    def applies(self, board: Board) -> bool:
        return "support" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Measure both, and take the larger."""
        log, usual = job.log(), material_noise(job.board)
        with threadpool_limits(limits=1):
            under_touch = unexplained(job, log, usual)
        progress(1.0)
        has_rest = len(log.rest) >= MIN_REST
        plane, (rows, columns) = _planes(job.board), job.board.observed
        shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
        untouched = Power.mean([power_of(frame, plane, shape) for frame in log.rest]) if has_rest else under_touch
        at_rest, touched = np.sqrt(untouched.node), np.sqrt(under_touch.node)
        x, y, z = used = np.maximum(np.maximum(at_rest, touched), LEAST_M)
        blocks = np.maximum(untouched.block, under_touch.block)
        length = correlation_nodes(float(np.mean(blocks / used**2)))
        job.noise = Noise(
            (float(x), float(y), float(z)), gauge_m=usual.gauge_m, tilt_m=usual.tilt_m, correlation_nodes=length
        )
        report = {"rest_um": (at_rest * 1e6).tolist() if has_rest else None, "rest_frames": len(log.rest),
                  "touched_um": (touched * 1e6).tolist(), "used_um": [1e6 * float(v) for v in used],
                  "correlation_nodes": length}  # fmt: skip
        rest = f", {_text(at_rest)} at rest ({len(log.rest)} frames)" if has_rest else ""
        return Outcome("fitted", f"displacement off by {_text(used)} um (x, y, z) under a touch{rest}, "
                       f"correlated over {length:.1f} nodes", report)  # fmt: skip

    def keep(self, job: Job) -> Outcome:
        """What `cal fit --only operator` takes without measuring."""
        job.noise = material_noise(job.board)
        return Outcome(
            "board", "as `cal fit --only operator` takes it: " + _text(np.array(job.noise.sigma_m)) + " um (x, y, z)"
        )


NOISE = NoiseEstimator()
