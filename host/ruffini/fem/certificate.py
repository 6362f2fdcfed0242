"""What running an operator in integers costs against float64, along x, y and z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.fem.program import Program, shift_for

Array = npt.NDArray[np.float64]

DISPLACEMENT_LSB_NM = 125
CERTIFIED_UM = 1000  # displacement up to which the certificate bounds the error
CERTIFIED_STEPS = CERTIFIED_UM * 1000 // DISPLACEMENT_LSB_NM
ROWS_AT_ONCE = 1024


@dataclass(frozen=True)
class Certificate:
    """`worst_steps`: no displacement of at most CERTIFIED_UM anywhere changes an output along that axis by more,

    in output steps, every rounding included. `typical`: relative L2 error along that axis for displacements of
    independent places; `total` the same over all axes; `samples` the relative L2 error over the sample
    inputs, zero without samples.
    """

    worst_steps: tuple[float, float, float]
    typical: tuple[float, float, float]
    total: float
    samples: float


def certify(
    program: Program, matrix: Array, row_axis: npt.NDArray[np.int64], samples: Array | None = None
) -> Certificate:
    """Certificate of a program against its matrix (n_rows, n_cols), in output steps per input step.

    worst = max over rows of sum_j |q_rj - m_rj| u_max + what the kept vectors and the output round off;
    typical = |Q - M|_F / |M|_F over the rows of an axis. A scalar output counts as z.
    """
    axis = np.where(row_axis < 0, 2, row_axis)
    worst = _rounding(program)
    error, size = np.zeros(3), np.zeros(3)
    sample_error = sample_size = 0.0
    for first in range(0, len(matrix), ROWS_AT_ONCE):
        rows = slice(first, min(first + ROWS_AT_ONCE, len(matrix)))
        difference = effective_rows(program, rows, matrix.shape[1]) - matrix[rows]
        worst[rows] += np.abs(difference).sum(axis=1) * CERTIFIED_STEPS
        error += np.bincount(axis[rows], np.square(difference).sum(axis=1), 3)
        size += np.bincount(axis[rows], np.square(matrix[rows]).sum(axis=1), 3)
        if samples is not None:
            sample_error += float(np.square(difference @ samples).sum())
            sample_size += float(np.square(matrix[rows] @ samples).sum())
    worst_of = [float(worst[axis == a].max(initial=0)) for a in range(3)]
    typical = np.sqrt(error / np.where(size > 0, size, 1))
    return Certificate(
        (worst_of[0], worst_of[1], worst_of[2]),
        (float(typical[0]), float(typical[1]), float(typical[2])),
        float(np.sqrt(error.sum() / size.sum())),
        float(np.sqrt(sample_error / sample_size)) if sample_size > 0 else 0.0,
    )


def probed_error(program: Program, matrix: Array, samples: Array | None, n_rows: int) -> tuple[float, float]:
    """`total` and `samples` of the certificate, from about `n_rows` of all rows only."""
    step = max(len(matrix) // n_rows, 1)
    rows = slice(0, len(matrix), step + (step % 3 == 0))  # all three axes among them
    wanted = matrix[rows]
    difference = effective_rows(program, rows, matrix.shape[1]) - wanted
    on_samples = 0.0 if samples is None else _relative(difference @ samples, wanted @ samples)
    return _relative(difference, wanted), on_samples


def _relative(error: Array, size: Array) -> float:
    return float(np.linalg.norm(error)) / max(float(np.linalg.norm(size)), 1e-300)


def effective_rows(program: Program, rows: slice, n_in: int) -> Array:
    """Rows of the matrix that the program's tables are, backwards from the outputs, (n, n_in)."""
    unfold = program.unfold[rows]
    weights = [np.zeros((n, len(unfold))) for n in (len(program.fold), *program.stage[:, 0])]
    weights[-1] += _signed(unfold, len(weights[-1])).T
    for line, segments, matrix in reversed(list(program.panels())):
        stage, first_row, n_rows, source = (int(v) for v in line[:4])
        part = matrix.T @ weights[stage + 1][first_row : first_row + n_rows]
        at = 0
        for first, count in segments:
            weights[source][first : first + count] += part[at : at + count]
            at += count
    return np.asarray((_signed(program.fold, n_in).T @ weights[0]).T)


def _signed(table: npt.NDArray[np.int32], n: int) -> sp.csr_matrix:
    """A fold's lines as a matrix, (lines, n)."""
    line, place = np.nonzero(table)
    named = table[line, place]
    return sp.csr_matrix((np.sign(named).astype(float), (line, np.abs(named) - 1)), shape=(len(table), n))


def _rounding(program: Program) -> Array:
    """Largest error of each output from rounding vectors and the output itself, in output steps.

    A vector within B is kept in 16 bits with a step of 2^shift_for(B); half of it is lost at most, besides
    half a step where the sums are shifted.
    """
    bounds = [np.count_nonzero(program.fold, axis=1) * float(CERTIFIED_STEPS)]
    errors = [np.full(len(program.fold), _half_step(bounds[0], 0))]
    bounds += [np.zeros(n) for n in program.stage[:, 0]]
    errors += [np.zeros(n) for n in program.stage[:, 0]]
    done = 0
    for line, segments, matrix in program.panels():
        stage, first_row, n_rows, source = (int(v) for v in line[:4])
        for s in range(done, stage):
            errors[s + 1] += _half_step(bounds[s + 1] + errors[s + 1], program.fraction[s + 1])
        done = max(done, stage)
        columns = np.concatenate([np.arange(first, first + count) for first, count in segments])
        size = np.abs(matrix)
        bounds[stage + 1][first_row : first_row + n_rows] += size @ bounds[source][columns]
        errors[stage + 1][first_row : first_row + n_rows] += size @ errors[source][columns]
    return np.asarray(0.5 + abs(_signed(program.unfold, len(errors[-1]))) @ errors[-1])


def _half_step(bound: Array, fraction: int) -> float:
    shift = shift_for(int(bound.max() * 2.0**fraction) + 1)
    lost_in_shift = 0.5 if fraction else 0.0
    return float(((0.5 * 2.0**shift if shift else 0.0) + lost_in_shift) * 2.0**-fraction)
