"""Reader of wrenches in a CSV of another program: a time column, and columns named by axis and unit, or voltages."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.rig.reference import AXES
from ruffini.rig.units import force_factor, torque_factor

Array = npt.NDArray[np.float64]

COLUMN = re.compile(r"(f|t)([xyz])\s*(?:_|\[|\()\s*([A-Za-z·-]+)\s*[\])]?", re.IGNORECASE)
TIME = re.compile(r"(?:time|t|timestamp)\s*(?:_|\[|\()\s*(s|ms|us|ns)\s*[\])]?", re.IGNORECASE)
N_GAUGES = 6
MAX_CONDITION = 1e6  # of a matrix with rows of length 1: a sensor's is below 100
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class WrenchLog(NamedTuple):
    """Increasing times (t,) s on the log's own clock and wrenches (t, 6), N and N m; NaN for absent columns."""

    time_s: Array
    wrench: Array


class Gauges(NamedTuple):
    """Columns of the voltages of six gauges, and the matrix (6, 6) to Fx Fy Fz Tx Ty Tz, N and N m per volt."""

    columns: list[str]
    matrix: Array


def gauges_of(columns: object, matrix: object) -> Gauges:
    """Gauges from a file's `columns` (six names) and `matrix` (six rows of six numbers).

    Raises
    ------
    InputError
        One is missing or of another shape, a name occurs twice, or the matrix is not finite or singular.
    """
    if not _is_six(columns, str) or len(set(columns)) < N_GAUGES:
        raise InputError(f"columns must name the {N_GAUGES} columns of voltages, each once, in the order in which the "
                         f"certificate lists the gauges, not {columns!r}")  # fmt: skip
    if not _is_six(matrix, list) or not all(_is_six(row, (int, float)) for row in matrix):
        raise InputError("matrix must be six rows (Fx Fy Fz Tx Ty Tz) of six numbers, N and N m per volt: copy it "
                         "from the certificate")  # fmt: skip
    rows = np.array(matrix, np.float64)
    if not np.isfinite(rows).all():
        axis = AXES[int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])]
        raise InputError(f"matrix has a number in row {axis} that is not finite: copy it from the certificate")
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)  # forces and moments differ in unit
    if not sizes.all() or np.linalg.cond(rows / sizes) > MAX_CONDITION:
        raise InputError("matrix is singular: a row or column is zero, or depends on others: compare it with the "
                         "certificate")  # fmt: skip
    return Gauges(columns, rows)


def _is_six(values: object, kind: type | tuple[type, ...]) -> TypeGuard[list[Any]]:
    return (
        isinstance(values, list)
        and len(values) == N_GAUGES
        and all(isinstance(v, kind) and not isinstance(v, bool) for v in values)
    )


class Table(NamedTuple):
    """A CSV as read; only the cells of requested columns must be numbers."""

    path: Path
    names: list[str]
    rows: list[list[str]]

    def column(self, name: str) -> Array:
        """One column; raises InputError if a cell is not a number."""
        return self.columns([self.names.index(name)])[:, 0]

    def columns(self, wanted: list[int]) -> Array:
        """Some columns, (t, n); raises as `column`."""
        rows = [_numbers(self.path, i + 2, row, wanted) for i, row in enumerate(self.rows)]
        return np.array(rows).reshape(-1, len(wanted))


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Names and rows of a CSV, with one cell per name in each row; blank rows are skipped.

    Raises
    ------
    InputError
        Unreadable, empty, or a row of another length.
    """
    try:
        with readable(path).open(newline="", encoding="utf-8-sig") as stream:  # with or without a byte-order mark
            numbered = [(i, row) for i, row in enumerate(csv.reader(stream), 1) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV: {error}") from error
    if not numbered:
        raise InputError(f"{path}: is empty: its first row must name the columns")
    names = [name.strip() for name in numbered[0][1]]
    for i, row in numbered[1:]:
        if len(row) != len(names):
            why = (
                "is a comma the decimal mark? Write 1.5, not 1,5" if len(row) > len(names) else "complete or delete it"
            )
            raise InputError(f"{path}: row {i} has {len(row)} cells, the header {len(names)}: {why}")
    return names, [row for _, row in numbered[1:]]


def read_table(path: Path, renamed: Mapping[str, str] | None = None) -> Table:
    """Read a CSV; `renamed` maps its column names to ours.

    Raises
    ------
    InputError
        Unreadable, or a column that is to be renamed is not there.
    """
    names, rows = read_rows(path)
    missing = [theirs for theirs in renamed or {} if theirs not in names]
    if missing:
        raise InputError(f"{path}: has no column {missing[0]!r}, only {', '.join(names)}")
    return Table(path, [(renamed or {}).get(name, name) for name in names], rows)


def read_csv_log(path: Path, gauges: Gauges | None = None) -> WrenchLog:
    """Read columns such as time_s, fz_N, tx_Nmm or "Fz [lbf]", or `gauges`; raises as `read_table`, `wrench_log`."""
    return wrench_log(read_table(path), gauges)


def wrench_log(table: Table, gauges: Gauges | None = None) -> WrenchLog:
    """Time and wrench of a table; of the voltages of `gauges` where they are given.

    Raises
    ------
    InputError
        No time, no force, a gauge's column missing, a column without unit, times that do not rise, or a cell that is
        no number.
    """
    path = table.path
    time_column, scale = _time(path, table.names)
    axes = {} if gauges else _columns(path, table.names)
    values = table.columns([time_column, *(_places(table, gauges) if gauges else axes)])
    if len(values) < 2:
        raise InputError(f"{path}: has {len(values)} rows of numbers: a log needs at least two")
    time_s = values[:, 0] * scale
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if len(back):
        raise InputError(f"{path}, line {back[0] + 3}: time stands still or goes back: one recording a file")
    if gauges:
        return WrenchLog(time_s, values[:, 1:] @ gauges.matrix.T)
    wrench = np.full((len(values), 6), np.nan)
    for place, (axis, factor) in enumerate(axes.values(), start=1):
        wrench[:, axis] = values[:, place] * factor
    return WrenchLog(time_s, wrench)


def _time(path: Path, header: list[str]) -> tuple[int, float]:
    for i, name in enumerate(header):
        match = TIME.fullmatch(name.strip())
        if match:
            return i, SECONDS[match[1].lower()]
    raise InputError(f"{path}: no column of time among {', '.join(header)}: a log needs time_s (or _ms, _us, _ns), "
                     "the time at which each row was measured")  # fmt: skip


def _places(table: Table, gauges: Gauges) -> list[int]:
    """Where the gauges' columns are."""
    for name in gauges.columns:
        if (n := table.names.count(name)) != 1:
            raise InputError(f"{table.path}: has {n or 'no'} column{'s' * (n > 1)} {name!r}, only "
                             f"{', '.join(table.names)}: correct columns")  # fmt: skip
    return [table.names.index(name) for name in gauges.columns]


def _columns(path: Path, header: list[str]) -> dict[int, tuple[int, float]]:
    """Axis and factor to N or N m by column."""
    found: dict[int, tuple[int, float]] = {}
    for i, name in enumerate(header):
        match = COLUMN.fullmatch(name.strip())
        if match:
            kind, axis, unit = match[1].lower(), match[2].lower(), match[3]
            found[i] = AXES.index(kind + axis), (force_factor if kind == "f" else torque_factor)(unit)
        elif name.strip().lower() in AXES:
            raise InputError(f"{path}: column {name.strip()!r} has no unit: name it e.g. {name.strip()}_N or _lbf")
    axes = [axis for axis, _ in found.values()]
    if 2 not in axes:
        raise InputError(f"{path}: no column of the normal force, e.g. fz_N, among {', '.join(header)}")
    if len(set(axes)) < len(axes):
        raise InputError(f"{path}: an axis has two columns among {', '.join(header)}: leave one")
    return found


def _numbers(path: Path, line: int, row: list[str], columns: list[int]) -> list[float]:
    try:
        values = [float(row[i]) for i in columns]
    except (ValueError, IndexError):
        values = []
    if not values or not np.isfinite(values).all():
        raise InputError(f"{path}, line {line}: a cell is missing or no number: {','.join(row)!r}")
    return values
