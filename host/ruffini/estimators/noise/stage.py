"""What the front end's displacement is off: at rest, and under a touch.

Untouched frames show the noise of camera, markers and colours. Under a touch the displacement is off by more: the dots
of a sheared patch, colours beyond what was pressed. How much follows from what the best forces on the contact leave
unexplained, u - C F with the fitted pad. The operator weighs displacements by the larger of the two, axis by axis.

How much of it is correlated is told by means over BLOCK x BLOCK nodes, about as wide as a contact: they keep
1 / BLOCK^2 of the variance of white noise, and most of that of noise with long correlation. A wrench errs by that part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.log.touches import TouchLog
from ruffini.estimators.base import Estimator
from ruffini.estimators.material.fit import force_size
from ruffini.estimators.material.prior import has_finite_strain
from ruffini.estimators.material.stage import material_noise
from ruffini.estimators.operator.fit import (
    board_slab,
    board_window_m,
    finite_strain_of,
    observed_unknowns,
    second_pass,
)
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.operators import LONG_NODES, Noise, force_operator
from ruffini.fem.support import support_system
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]

MIN_REST = 10  # untouched frames
LEAST_M = 0.5e-6  # four steps of the displacement: what rounding and interpolation leave at best
MAX_TOUCHES = 60  # the strongest frame of each: more tell no more
BLOCK, MIN_BLOCKS = 6, 8  # nodes to a side; blocks of a grid


@dataclass(frozen=True)
class Power:
    """Of displacements, by axis (3,), m^2: mean square of nodes; of means over blocks, times a block's nodes.

    block: None where the grid has too few blocks.
    """

    node: Array
    block: Array | None

    @classmethod
    def mean(cls, parts: list[Power]) -> Power:
        blocks = [p.block for p in parts if p.block is not None]
        return cls(np.mean([p.node for p in parts], axis=0), np.mean(blocks, axis=0) if blocks else None)


def unexplained(job: Job, log: TouchLog, noise: Noise) -> Power:
    """Mean over touches of what the second pass leaves of the displacement."""
    board = job.board
    slab, observed = board_slab(board, job.material), observed_unknowns(board)
    condensed = condense(slab)
    matrix = force_operator(slab, "optimal", noise=noise, window_m=board_window_m(board))
    is_finite = has_finite_strain(board, is_asked=job.is_finite)
    beyond = finite_strain_of(board, slab) if is_finite else None
    estimate = second_pass(board, matrix, support_system(condensed, noise, observed, matrix), beyond)
    whole = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])
    compliance = whole[np.ix_(observed, observed)]
    rows, columns = board.observed
    shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
    plane = planes(board)
    strength = force_size(log.wrench)
    frames = [np.flatnonzero(log.touch == t) for t in np.unique(log.touch)]
    last = [touch[strength[touch].argmax()] for touch in frames]
    chosen = [last[i] for i in np.unique(np.linspace(0, len(last) - 1, MAX_TOUCHES).astype(int))]
    left = []
    for u in log.displacement[chosen]:
        force, _ = estimate(u.reshape(shape))
        linear = force if beyond is None else force - beyond.force(u.reshape(shape))
        left.append(power_of(u - (compliance @ linear.ravel()).reshape(-1, 3), plane, shape))
    return Power.mean(left)


def planes(board: Board) -> Array:
    """The depth's constant and tilt at the observed nodes, (m, 3): they are told to the operator apart."""
    rows, columns = board.observed
    x, y = np.linspace(-1, 1, columns.stop - columns.start), np.linspace(-1, 1, rows.stop - rows.start)
    return np.stack([np.ones(len(x) * len(y)), np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)


def power_of(field: Array, plane: Array, shape: tuple[int, ...]) -> Power:
    """Of a displacement (m, 3) metres of nodes `shape` (n_y, n_x, 3), without a constant and a tilt of its z."""
    z = field[:, 2] - plane @ np.linalg.lstsq(plane, field[:, 2], rcond=None)[0]
    whole = np.stack([field[:, 0], field[:, 1], z], axis=-1).reshape(shape)
    node = (whole**2).mean(axis=(0, 1))
    n_y, n_x = (n // BLOCK for n in shape[:2])
    if n_y * n_x < MIN_BLOCKS:
        return Power(node, None)
    blocks = whole[: n_y * BLOCK, : n_x * BLOCK].reshape(n_y, BLOCK, n_x, BLOCK, 3).mean(axis=(1, 3))
    kept = np.array([1, 1, 1 - plane.shape[1] / (n_y * n_x)])  # by taking the plane away
    return Power(node, BLOCK**2 * (blocks**2).mean(axis=(0, 1)) / kept)


def long_share(power: Power) -> tuple[float, float, float] | None:
    """Share of each axis's variance with which white noise and noise of long correlation have this block power."""
    if power.block is None:
        return None
    place = np.stack(np.meshgrid(np.arange(BLOCK), np.arange(BLOCK)), axis=-1).reshape(-1, 2)
    square = ((place[:, None] - place[None, :]) ** 2).sum(axis=-1)
    of_long = float(np.exp(-square / (4 * LONG_NODES**2)).sum() / BLOCK**2)
    x, y, z = np.clip((power.block / power.node - 1) / (of_long - 1), 0, 1)
    return float(x), float(y), float(z)


def _larger(a: Array | None, b: Array | None) -> Array | None:
    return None if a is None or b is None else np.maximum(a, b)


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
        plane, (rows, columns) = planes(job.board), job.board.observed
        shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
        untouched = Power.mean([power_of(frame, plane, shape) for frame in log.rest]) if has_rest else under_touch
        at_rest, touched = np.sqrt(untouched.node), np.sqrt(under_touch.node)
        x, y, z = used = np.maximum(np.maximum(at_rest, touched), LEAST_M)
        sees_depth = job.board.depth.source != "markers"  # else the error model draws the markers' noise
        share = long_share(Power(used**2, _larger(untouched.block, under_touch.block))) if sees_depth else None
        job.noise = Noise((float(x), float(y), float(z)), gauge_m=usual.gauge_m, tilt_m=usual.tilt_m, long_share=share)
        report = {"rest_um": (at_rest * 1e6).tolist() if has_rest else None, "rest_frames": len(log.rest),
                  "touched_um": (touched * 1e6).tolist(), "used_um": [1e6 * float(v) for v in used],
                  "long_share": share}  # fmt: skip
        rest = f", {_text(at_rest)} at rest ({len(log.rest)} frames)" if has_rest else ""
        far = "" if share is None else "; " + ", ".join(f"{100 * v:.0f}" for v in share) + " % of it correlated"
        return Outcome("fitted", f"displacement off by {_text(used)} um (x, y, z) under a touch{rest}{far}", report)

    def keep(self, job: Job) -> Outcome:
        """What `cal fit --only operator` takes without measuring."""
        job.noise = material_noise(job.board)
        return Outcome(
            "board", "as `cal fit --only operator` takes it: " + _text(np.array(job.noise.sigma_m)) + " um (x, y, z)"
        )


NOISE = NoiseEstimator()
