"""A linear map as a program of block-scaled integer products: proto/CALIBRATION.md, "Programs".

A `Plan` is the program in float64; `quantise` rounds it to the board's integers with the scales that
make no accumulator overflow, whatever the inputs. The board's loader proves the same again from the
tables it gets (firmware/solve/block_program_load.cpp).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

BLOCK = 32  # columns that share one scale
ROWS = 8  # rows that lie interleaved
ENTRY_LIMIT = 16383  # 15 bits with sign: four products with int16 fit one int32 lane
INPUT_LIMIT = 32768
SUM_BITS = 62  # of an accumulator
KEPT_BITS = 34  # of a vector before it is kept in 16 bits: inputs of three steps still lose nothing
MAX_SHIFT = 40
MAX_VALUES = 65_536  # of one vector


@dataclass(frozen=True)
class Panel:
    """`matrix` (n_rows, n_cols) times the listed (first, count) segments of vector `source`, added to the rows

    from `first_row` on of the vector that stage `stage` makes.
    """

    stage: int
    first_row: int
    source: int
    segments: tuple[tuple[int, int], ...]
    matrix: Array

    @property
    def n_entries(self) -> int:
        """With padding."""
        n_rows, n_cols = self.matrix.shape
        return int(n_rows * -(-n_cols // BLOCK) * BLOCK)


@dataclass(frozen=True)
class Plan:
    """Stages of panels between a fold of the inputs and an unfold to the outputs.

    `fold` (n_slots, k) and `unfold` (n_out, k): +-(index + 1), 0 for none, k at most 4. `sizes`: values of
    each stage's vector. Panels are in the order of their stages.
    """

    fold: Int32
    unfold: Int32
    sizes: tuple[int, ...]
    panels: list[Panel]

    @property
    def n_entries(self) -> int:
        return sum(panel.n_entries for panel in self.panels)


@dataclass(frozen=True)
class Program:
    """The tables of proto/CALIBRATION.md."""

    fold: Int32
    unfold: Int32
    stage: Int32
    panel: Int32
    segment: Int32
    entry: npt.NDArray[np.int16]
    shift: npt.NDArray[np.uint8]
    out_shift: int
    fraction: tuple[int, ...] = field(default=())  # bits of each vector: value = integer / 2^fraction

    @property
    def n_bytes(self) -> int:
        return sum(t.nbytes for t in self.tensors("").values())

    def tensors(self, name: str) -> dict[str, npt.NDArray[np.generic]]:
        return {
            f"{name}.entry": self.entry, f"{name}.shift": self.shift, f"{name}.fold": self.fold,
            f"{name}.unfold": self.unfold, f"{name}.stage": self.stage, f"{name}.panel": self.panel,
            f"{name}.segment": self.segment,
        }  # fmt: skip

    def panels(self) -> Iterator[tuple[Int32, Int32, Array]]:
        """Each panel's line, its segments, and its rounded matrix in units of the plan (n_rows, n_cols)."""
        at = 0
        for line in self.panel:
            stage, _, n_rows, source, first, count = (int(v) for v in line)
            segments = self.segment[first : first + count]
            n_cols = int(segments[:, 1].sum())
            n_blocks = -(-n_cols // BLOCK)
            size = n_rows * n_blocks
            fraction = self._sum_fraction(stage) - self.fraction[source]
            scale = np.ldexp(1.0, self.shift[at : at + size].astype(int) - fraction)
            values = self.entry[at * BLOCK : (at + size) * BLOCK].reshape(size, BLOCK) * scale[:, None]
            yield line, segments, _ungroup(values, n_rows, n_blocks)[:, :n_cols]
            at += size

    def _sum_fraction(self, stage: int) -> int:
        """Fraction bits of a stage's accumulators."""
        is_last = stage + 1 == len(self.stage)
        return self.out_shift if is_last else self.fraction[stage + 1] + int(self.stage[stage, 1])


def quantise(plan: Plan, what: str) -> Program:
    """Round a plan, from input steps to output steps, to integers that cannot overflow.

    Raises
    ------
    InputError
        When no output shift fits.
    """
    bound = [_kept(INPUT_LIMIT * plan.fold.shape[1])]
    fraction, stages, entries, shifts = [0], [], [], []
    for stage, n_values in enumerate(plan.sizes):
        panels = [p for p in plan.panels if p.stage == stage]
        is_last = stage + 1 == len(plan.sizes)
        bits = SUM_BITS - (plan.unfold.shape[1].bit_length() - 1 if is_last else 0)
        sum_fraction, scales = _sum_fraction(panels, n_values, bound, fraction, bits)
        row_bound = np.zeros(n_values)
        for panel, exponent in zip(panels, scales, strict=True):
            entry, shift, weight = _round(panel.matrix, exponent, sum_fraction - fraction[panel.source])
            row_bound[panel.first_row : panel.first_row + len(weight)] += weight * bound[panel.source]
            entries.append(entry)
            shifts.append(shift)
        largest = float(row_bound.max())
        if largest > 2.0**bits:
            raise AssertionError(f"{what}: stage {stage} may reach {largest:.3g}")
        keep_shift = 0 if is_last else max(int(np.ceil(np.log2(largest))) - KEPT_BITS, 0)
        stages.append((n_values, keep_shift))
        if is_last:
            out_shift = sum_fraction
        else:
            fraction.append(sum_fraction - keep_shift)
            bound.append(_kept(int(largest) // 2**keep_shift + 2))
    if not 1 <= out_shift <= 60:
        raise InputError(
            f"the largest entry of {what} needs an output shift of {out_shift}, outside 1..60: "
            "change [field] force_lsb_un in board.toml"
        )
    segments = [s for p in plan.panels for s in p.segments]
    first = np.cumsum([0] + [len(p.segments) for p in plan.panels])
    lines = [
        (p.stage, p.first_row, len(p.matrix), p.source, first[i], len(p.segments)) for i, p in enumerate(plan.panels)
    ]
    return Program(
        plan.fold, plan.unfold, np.array(stages, np.int32), np.array(lines, np.int32), np.array(segments, np.int32),
        np.concatenate(entries), np.concatenate(shifts), out_shift, tuple(fraction),
    )  # fmt: skip


def shift_for(largest: int) -> int:
    """Of a vector up to `largest` that is kept in 16 bits, see firmware/solve/block_float.h."""
    return max((largest + (largest >> 14)).bit_length() - 15, 0)


def _kept(bound: int) -> int:
    """Largest value of a vector within `bound` after it was kept in 16 bits."""
    return bound + (1 << shift_for(bound))


def _sum_fraction(
    panels: list[Panel], n_values: int, bound: list[int], fraction: list[int], bits: int
) -> tuple[int, list[npt.NDArray[np.int64]]]:
    """Most fraction bits of a stage's sums within `bits`, and each panel's block exponents (n_rows, n_blocks).

    An exponent e is the smallest with peak <= ENTRY_LIMIT 2^e; very low for an empty block.
    """
    reach = np.zeros(n_values)
    exponents, largest = [], -1100
    for panel in panels:
        peak, weight = _peak_and_weight(panel.matrix)
        exponent = np.where(peak > 0, np.ceil(np.log2(np.maximum(peak, 1e-300) / ENTRY_LIMIT)), -1100).astype(np.int64)
        rows = slice(panel.first_row, panel.first_row + len(peak))
        # Rounding may add half a step to each entry, and a step is peak / (ENTRY_LIMIT / 2) at most.
        reach[rows] += weight * (1 + 1 / 256) * (bound[panel.source] * 2.0 ** -fraction[panel.source])
        largest = max(largest, int(exponent.max()) - fraction[panel.source])
        exponents.append(exponent)
    room = bits - int(np.ceil(np.log2(reach.max())))
    return min(room, MAX_SHIFT - largest), exponents


def _peak_and_weight(matrix: Array) -> tuple[Array, Array]:
    """Of each row: the largest magnitude in each block, and the sum of a bound of all magnitudes."""
    starts = np.arange(0, matrix.shape[1], BLOCK)
    peak = np.empty((len(matrix), len(starts)))
    weight = np.empty(len(matrix))
    for rows in _chunks(len(matrix)):
        size = np.abs(matrix[rows])
        peak[rows] = np.maximum.reduceat(size, starts, axis=1)
        # Half a step of rounding for each entry beside the entries themselves.
        weight[rows] = size.sum(axis=1) + peak[rows].sum(axis=1) * BLOCK / ENTRY_LIMIT
    return peak, weight


def _chunks(n_rows: int) -> Iterator[slice]:
    """Slices of rows, whole groups each, so that temporaries stay small."""
    step = 64 * ROWS
    for first in range(0, n_rows, step):
        yield slice(first, min(first + step, n_rows))


def _round(
    matrix: Array, exponent: npt.NDArray[np.int64], fraction: int
) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.uint8], Array]:
    """Entries and shifts as the board reads them, and sum |q| 2^shift of each row."""
    n_rows, n_blocks = exponent.shape
    entries, shifts, weight = [], [], np.empty(n_rows)
    for rows in _chunks(n_rows):
        shift = np.clip(exponent[rows] + fraction, 0, MAX_SHIFT)
        padded = np.zeros((len(shift), n_blocks * BLOCK))
        padded[:, : matrix.shape[1]] = matrix[rows]
        blocks = padded.reshape(len(shift), n_blocks, BLOCK)
        blocks *= np.ldexp(1.0, fraction - shift)[:, :, None]
        q = np.clip(np.floor(blocks + 0.5), -ENTRY_LIMIT, ENTRY_LIMIT)
        weight[rows] = (np.abs(q).sum(axis=2) * np.ldexp(1.0, shift)).sum(axis=1)
        entries.append(_group(q.astype(np.int16)))
        shifts.append(_group(shift.astype(np.uint8)))
    return np.concatenate(entries), np.concatenate(shifts), weight


def _group(rows: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """(n_rows, n_blocks, ...) -> flat, block by block within groups of ROWS rows."""
    parts = [rows[i : i + ROWS].swapaxes(0, 1).ravel() for i in range(0, len(rows), ROWS)]
    return np.concatenate(parts)


def _ungroup(values: Array, n_rows: int, n_blocks: int) -> Array:
    """Inverse of `_group` for (n_rows n_blocks, BLOCK) -> (n_rows, n_blocks BLOCK)."""
    out = np.empty((n_rows, n_blocks, BLOCK))
    at = 0
    for i in range(0, n_rows, ROWS):
        n = min(ROWS, n_rows - i)
        out[i : i + n] = values[at : at + n * n_blocks].reshape(n_blocks, n, BLOCK).swapaxes(0, 1)
        at += n * n_blocks
    return out.reshape(n_rows, n_blocks * BLOCK)
