"""float64 operator -> the block-scaled int16 table of proto/CALIBRATION.md, with its certificate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

BLOCK = 32  # columns that share one scale
ENTRY_LIMIT = 16383  # 15 bits with sign: four products with int16 fit one int32 lane
DISPLACEMENT_LSB_NM = 125
BOUND_BITS = 62  # of the row accumulator


@dataclass(frozen=True)
class OperatorTable:
    """F[r] = (sum_b (sum_j q[r, j] u[j] << shift[r, b]) + half) >> out_shift, see CALIBRATION.md.

    `entry` (n_rows, n_cols_padded) int16, `shift` (n_rows, n_blocks) uint8; `error` is the relative
    L2 (Frobenius) error of the rounded matrix.
    """

    entry: npt.NDArray[np.int16]
    shift: npt.NDArray[np.uint8]
    out_shift: int
    force_lsb_un: int
    error: float

    def to_float(self) -> npt.NDArray[np.float64]:
        """The rounded operator, newton per metre, (n_rows, n_cols_padded)."""
        scale = 2.0 ** (self.shift.astype(float) - self.out_shift)
        unit = self.force_lsb_un * 1e-6 / (DISPLACEMENT_LSB_NM * 1e-9)
        return np.asarray(self.entry * np.repeat(scale, BLOCK, axis=1) * unit)


def compile_operator(
    operator: npt.NDArray[np.float64], *, force_lsb_un: int, max_error: float = 2e-3
) -> OperatorTable:
    """Round G (n_rows, n_cols) in newton per metre to the board's table.

    Raises
    ------
    InputError
        When G is not finite, all zero, or cannot be held within `max_error` (relative L2).
    """
    if operator.ndim != 2 or not np.isfinite(operator).all() or not operator.any():
        raise InputError("the operator is not a finite, non-zero matrix: nothing to compile")
    n_rows, n_cols = operator.shape
    n_blocks = -(-n_cols // BLOCK)
    unit = force_lsb_un * 1e-6 / (DISPLACEMENT_LSB_NM * 1e-9)
    padded = np.zeros((n_rows, n_blocks * BLOCK))
    padded[:, :n_cols] = operator / unit
    blocks = padded.reshape(n_rows, n_blocks, BLOCK)
    peak = np.abs(blocks).max(axis=2)
    # Smallest exponent e with peak <= ENTRY_LIMIT 2^e.
    exponent = np.where(
        peak > 0, np.ceil(np.log2(np.maximum(peak, 1e-300) / ENTRY_LIMIT)), -np.inf
    )
    # The row sum is bounded by sum_b 2^(34 + shift): as much room as BOUND_BITS leaves.
    room = BOUND_BITS - 34 - int(np.ceil(np.log2(n_blocks)))
    out_shift = room - int(exponent.max())
    shift = np.clip(exponent + out_shift, 0, 30)
    if not 1 <= out_shift <= 60:
        raise InputError(
            f"the operator's largest entry needs an output shift of {out_shift}, outside 1..60: "
            "change [field] force_lsb_un in board.toml"
        )
    scaled = blocks / 2.0 ** (shift - out_shift)[:, :, None]
    entry = np.clip(np.floor(scaled + 0.5), -ENTRY_LIMIT, ENTRY_LIMIT)
    table = OperatorTable(
        entry=entry.reshape(n_rows, -1).astype(np.int16),
        shift=shift.astype(np.uint8),
        out_shift=out_shift,
        force_lsb_un=force_lsb_un,
        error=0.0,
    )
    error = float(
        np.linalg.norm(table.to_float()[:, :n_cols] - operator) / np.linalg.norm(operator)
    )
    if error > max_error:
        raise InputError(
            f"rounding the operator to 15 bits costs {error:.1e} (relative L2), "
            f"more than {max_error:.1e}"
        )
    return OperatorTable(table.entry, table.shift, out_shift, force_lsb_un, error)
