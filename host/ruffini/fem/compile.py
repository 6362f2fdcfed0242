"""float64 matrix -> the block-scaled int16 table of proto/CALIBRATION.md, with its certificate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

BLOCK = 32  # columns that share one scale
ENTRY_LIMIT = 16383  # 15 bits with sign: four products with int16 fit one int32 lane
DISPLACEMENT_LSB_NM = 125
BOUND_BITS = 62  # of the row accumulator
MAX_SHIFT = 27
CERTIFIED_UM = 1000  # displacement up to which the certificate bounds the error


@dataclass(frozen=True)
class BlockTable:
    """out[r] = (sum_b (sum_j q[r, j] u[j] << shift[r, b]) + half) >> out_shift, see CALIBRATION.md.

    `entry` (n_rows, n_cols_padded) int16, `shift` (n_rows, n_blocks) uint8; `error` is the relative
    L2 (Frobenius) error of the rounded matrix.
    """

    entry: npt.NDArray[np.int16]
    shift: npt.NDArray[np.uint8]
    out_shift: int
    error: float

    def to_float(self) -> npt.NDArray[np.float64]:
        """The rounded matrix, output steps per input step, (n_rows, n_cols_padded)."""
        scale = 2.0 ** (self.shift.astype(float) - self.out_shift)
        return np.asarray(self.entry * np.repeat(scale, BLOCK, axis=1))


@dataclass(frozen=True)
class Certificate:
    """What rounding an operator costs, along x, y and z, against float64.

    `worst_steps`: no displacement of at most CERTIFIED_UM anywhere changes a nodal force by more than this,
    in force steps. `typical`: relative L2 error for displacements of independent nodes.
    """

    worst_steps: tuple[float, float, float]
    typical: tuple[float, float, float]


def certificate(table: BlockTable, matrix: npt.NDArray[np.float64]) -> Certificate:
    """Certificate of a table for rows in the order x, y, z of one node after the other.

    worst = max over rows of sum_j |q_rj - m_rj| u_max + 1/2, the half for the rounding of the result;
    typical = |Q - M|_F / |M|_F over the rows of an axis.
    """
    difference = table.to_float()[:, : matrix.shape[1]] - matrix
    u_max = CERTIFIED_UM * 1000 / DISPLACEMENT_LSB_NM
    worst = [float(np.abs(difference[c::3]).sum(axis=1).max()) * u_max + 0.5 for c in range(3)]
    typical = [float(np.linalg.norm(difference[c::3]) / np.linalg.norm(matrix[c::3])) for c in range(3)]
    return Certificate((worst[0], worst[1], worst[2]), (typical[0], typical[1], typical[2]))


def force_steps(force_lsb_un: int) -> float:
    """Output steps per input step of an operator of 1 newton per metre."""
    return DISPLACEMENT_LSB_NM * 1e-9 / (force_lsb_un * 1e-6)


def compile_matrix(matrix: npt.NDArray[np.float64], what: str, *, max_error: float = 2e-3) -> BlockTable:
    """Round a matrix (n_rows, n_cols), in output steps per input step, to the board's table.

    Raises
    ------
    InputError
        When it is not finite, all zero, or cannot be held within `max_error` (relative L2).
    """
    if matrix.ndim != 2 or not np.isfinite(matrix).all() or not matrix.any():
        raise InputError(f"{what} is not a finite, non-zero matrix: nothing to compile")
    n_rows, n_cols = matrix.shape
    n_blocks = -(-n_cols // BLOCK)
    padded = np.zeros((n_rows, n_blocks * BLOCK))
    padded[:, :n_cols] = matrix
    blocks = padded.reshape(n_rows, n_blocks, BLOCK)
    peak = np.abs(blocks).max(axis=2)
    # Smallest exponent e with peak <= ENTRY_LIMIT 2^e.
    exponent = np.where(peak > 0, np.ceil(np.log2(np.maximum(peak, 1e-300) / ENTRY_LIMIT)), -np.inf)
    # The row sum is bounded by sum_b 2^(34 + shift): as much room as BOUND_BITS leaves.
    room = min(BOUND_BITS - 34 - int(np.ceil(np.log2(n_blocks))), MAX_SHIFT)
    out_shift = room - int(exponent.max())
    if not 1 <= out_shift <= 60:
        raise InputError(
            f"the largest entry of {what} needs an output shift of {out_shift}, outside 1..60: "
            "change [field] force_lsb_un in board.toml"
        )
    shift = np.clip(exponent + out_shift, 0, MAX_SHIFT)
    scaled = blocks / 2.0 ** (shift - out_shift)[:, :, None]
    entry = np.clip(np.floor(scaled + 0.5), -ENTRY_LIMIT, ENTRY_LIMIT)
    entries, shifts = entry.reshape(n_rows, -1).astype(np.int16), shift.astype(np.uint8)
    rounded = BlockTable(entries, shifts, out_shift, 0.0).to_float()[:, :n_cols]
    error = float(np.linalg.norm(rounded - matrix) / np.linalg.norm(matrix))
    if error > max_error:
        raise InputError(f"rounding {what} to 15 bits costs {error:.1e} (relative L2), more than {max_error:.1e}")
    return BlockTable(entries, shifts, out_shift, error)
