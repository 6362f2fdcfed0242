"""Programs of block-scaled integer products, straight from proto/CALIBRATION.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64, round_shift

BLOCK, ROWS = 32, 8


@dataclass(frozen=True)
class Panel:
    stage: int
    rows: slice
    source: int
    columns: I64  # of the source vector
    weight: npt.NDArray[np.object_]  # (n_rows, n_cols) q 2^shift, unbounded integers


class Program:
    """`<name>.*` of a calibration file. Sums on Python's integers, so that an overflow of the core would show."""

    def __init__(self, tensors: dict[str, npt.NDArray[np.generic]], metadata: dict[str, str], name: str) -> None:
        def table(what: str) -> I64:
            return tensors[f"{name}.{what}"].astype(np.int64)

        self.fold, self.unfold, self.stage = table("fold"), table("unfold"), table("stage")
        self.out_shift = int(metadata[f"{name}.out_shift"])
        self.panels, at = [], 0
        entry, shift, segment = table("entry").reshape(-1, BLOCK), table("shift"), table("segment")
        for stage, first_row, n_rows, source, first, count in table("panel"):
            columns = np.concatenate([np.arange(a, a + n) for a, n in segment[first : first + count]])
            n_blocks = -(-len(columns) // BLOCK)
            weight = np.zeros((n_rows, n_blocks, BLOCK), object)
            for r in range(n_rows):
                in_group, group = r % ROWS, r - r % ROWS
                size = min(ROWS, n_rows - group)
                lines = at + group * n_blocks + np.arange(n_blocks) * size + in_group
                weight[r] = entry[lines].astype(object) << shift[lines].astype(object)[:, None]
            at += n_rows * n_blocks
            flat = weight.reshape(n_rows, -1)[:, : len(columns)]
            self.panels.append(Panel(int(stage), slice(first_row, first_row + n_rows), int(source), columns, flat))

    def times(self, u: I64) -> I64:
        """All outputs, not saturated."""
        vectors = [_kept(_signed_sums(self.fold, u.astype(object)))]
        for stage, (n_values, shift) in enumerate(self.stage):
            total = np.zeros(n_values, object)
            for panel in self.panels:
                if panel.stage == stage:
                    values, exponent = vectors[panel.source]
                    total[panel.rows] += (panel.weight @ values[panel.columns]) * (1 << exponent)
            if stage + 1 < len(self.stage):
                vectors.append(_kept(round_shift(total, int(shift)) if shift else total))
        return np.asarray(round_shift(_signed_sums(self.unfold, total), self.out_shift).astype(np.int64))


def _signed_sums(table: I64, values: npt.NDArray[np.object_]) -> npt.NDArray[np.object_]:
    padded = np.concatenate([[0], values])
    return np.asarray((padded[np.abs(table)] * np.sign(table)).sum(axis=1))


def _kept(values: npt.NDArray[np.object_]) -> tuple[npt.NDArray[np.object_], int]:
    """In 16 bits with one exponent: the smallest with which rounding cannot reach 32768."""
    largest = max(abs(int(v)) for v in values)
    shift = max((largest + (largest >> 14)).bit_length() - 15, 0)
    return (round_shift(values, shift) if shift else values), shift
