"""What the front end's displacement is off: at rest, and under a touch.

Untouched frames show the noise of camera, markers and colours. Under a touch the displacement is off by more: the dots
of a sheared patch, colours beyond what was pressed. How much follows from what the best forces on the contact leave
unexplained, u - C F with the fitted pad. The operator weighs displacements by the larger of the two, axis by axis.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
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


def unexplained_m(job: Job, log: TouchLog, noise: Noise) -> Array:
    """Root mean square (3,) over touches and nodes of what the second pass leaves of the displacement, metres."""
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
        left.append(_rms(u - (compliance @ force.ravel()).reshape(-1, 3), plane))
    return np.asarray(np.sqrt(np.square(left).mean(axis=0)))


def _planes(board: Board) -> Array:
    """The depth's constant and tilt at the observed nodes, (m, 3): they are told to the operator apart."""
    rows, columns = board.observed
    x, y = np.linspace(-1, 1, columns.stop - columns.start), np.linspace(-1, 1, rows.stop - rows.start)
    return np.stack([np.ones(len(x) * len(y)), np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)


def _rms(field: Array, plane: Array) -> Array:
    """Of a displacement (m, 3), without a constant and a tilt of its z, (3,)."""
    z = field[:, 2] - plane @ np.linalg.lstsq(plane, field[:, 2], rcond=None)[0]
    return np.asarray(np.sqrt([np.mean(field[:, 0] ** 2), np.mean(field[:, 1] ** 2), np.mean(z**2)]))


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
            touched = unexplained_m(job, log, usual)
        progress(1.0)
        plane = _planes(job.board)
        rest = np.array([_rms(frame, plane) for frame in log.rest]) if len(log.rest) >= MIN_REST else np.zeros((1, 3))
        at_rest = np.sqrt(np.square(rest).mean(axis=0))
        x, y, z = np.maximum(np.maximum(at_rest, touched), LEAST_M)
        job.noise = Noise((float(x), float(y), float(z)), gauge_m=usual.gauge_m, tilt_m=usual.tilt_m)
        rest_um = (at_rest * 1e6).tolist() if len(log.rest) >= MIN_REST else None
        report = {"rest_um": rest_um, "rest_frames": len(log.rest),
                  "touched_um": (touched * 1e6).tolist(), "used_um": [1e6 * float(v) for v in (x, y, z)]}  # fmt: skip
        return Outcome("fitted", "displacement off by " + ", ".join(f"{1e6 * v:.1f}" for v in (x, y, z))
                       + f" um (x, y, z) under a touch, {_text(at_rest)} at rest ({len(log.rest)} frames)",
                       report)  # fmt: skip

    def keep(self, job: Job) -> Outcome:
        """What `cal fit --only operator` takes without measuring."""
        job.noise = material_noise(job.board)
        return Outcome(
            "board", "as `cal fit --only operator` takes it: " + _text(np.array(job.noise.sigma_m)) + " um (x, y, z)"
        )


NOISE = NoiseEstimator()
