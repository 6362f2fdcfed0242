"""Force logs from elsewhere as they are: HDF5 or CSV, with named columns of time, features and wrench.

A small TOML file or the command line names the columns:

    time = "vision/timestamp"            # seconds, rising
    features = ["vision/dxyz"]           # datasets or columns; * matches: "taxel_*"
    unit = "mm"                          # of displacements: px, mm, um, m; leave out for anything else
    wrench = "force/values"              # six columns, or a list of six names, "" for an axis without a sensor
    wrench_unit = ["N", "N m"]
    touch = "force/segment_id"           # optional: one number a touch, 0 untouched
    recording = "session"                # optional: else each file is a recording
    tip = "object"                       # optional: what pressed, by any name

PLAIN names them for a CSV of a board's own features.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.estimators.wrench.run import UNNAMED, FeatureRun
from ruffini.files import dataset_values, readable
from ruffini.older_python import tomllib
from ruffini.rig.csv_log import read_rows
from ruffini.rig.units import force_factor, torque_factor

Array = npt.NDArray[np.float64]

STEP = 65536.0  # raw units in a px or mm
LARGEST_RAW = 1 << 20  # of a feature without a unit
MOST_RAW = 1 << 26  # of a board's own integers
MOST_TEXTS = 10_000_000  # rows of a column of names
LENGTHS_MM = {"mm": 1.0, "um": 1e-3, "m": 1e3}
# A displacement beyond these was given in another unit: no soft pad moves so little under load, or so far.
LEAST = {"mm": 0.02, "px": 0.02}
MOST = {"mm": 100.0, "px": 2000.0}
MOST_ARM_MM, LEAST_ARM_MM = 1000.0, 0.05  # torque over force of a sensor that a hand can press
TURNED = 3.0  # mean of a shear force over that of the normal force that means swapped columns
MOST_FORCE_N = 1074.0  # of the board's table, root mean square
SLOW_S = 10.0  # between frames of a touch
# Of a recording's axes, by a linear map of the others' features: what is surely another axis, the same, another unit.
SURE, UNSURE, OTHER_UNIT = 0.7, 0.5, 10.0
LEAST_ROWS, LIKE_RIDGE = 50, 1e-3
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass(frozen=True)
class Columns:
    """Names of the columns of a log; the module's docstring explains each."""

    time: str = ""
    features: tuple[str, ...] = ()
    unit: str = ""
    wrench: tuple[str, ...] = ()
    wrench_unit: tuple[str, ...] = ("N", "N m")
    touch: str = ""
    recording: str = ""
    tip: str = ""

    @classmethod
    def read(cls, path: Path) -> Columns:
        """Read the mapping file; raises InputError where it is not one."""
        try:
            file = tomllib.loads(readable(path).read_text())
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        return cls.of(file, str(path))

    @classmethod
    def of(cls, values: dict[str, Any], where: str) -> Columns:
        """Check names and types; text stands for a list of one."""
        lists = {"features", "wrench", "wrench_unit"}
        unknown = sorted(values.keys() - {f.name for f in fields(cls)})
        if unknown:
            raise InputError(f"{where}: {unknown[0]}: unknown; known are {', '.join(f.name for f in fields(cls))}")
        out: dict[str, Any] = {}
        for name, value in values.items():
            value = [value] if name in lists and isinstance(value, str) else value
            if not (all(isinstance(v, str) for v in value) if name in lists else isinstance(value, str)):
                raise InputError(f"{where}: {name} is no name of a column: give text")
            out[name] = tuple(value) if name in lists else value
        made = cls(**out)
        missing = [name for name in ("time", "features", "wrench") if not getattr(made, name)]
        if missing:
            raise InputError(f"{where}: {missing[0]} is not named: which columns of the log are it?")
        if made.unit not in ("", "px", *LENGTHS_MM):
            raise InputError(f"{where}: unit {made.unit!r}: px, mm, um, m, or none for features of another kind")
        return made


PLAIN = Columns("time", ("feature_*",), wrench=WRENCH, touch="touch", recording="recording", tip="tip")


@dataclass
class Source:
    """An opened log: the values of a column by its name, (t,) or (t, ...)."""

    path: Path
    columns: dict[str, Any]

    def named(self, name: str) -> list[tuple[str, Array]]:
        """Columns that a name or pattern means, each (t,), with a name for messages.

        Raises
        ------
        InputError
            There is none, or it is not made of numbers.
        """
        found = [name] if name in self.columns else fnmatch.filter(self.columns, name)
        if not found:
            raise InputError(f"{self.path}: has no column {name!r}, only {_listed(self.columns)}")
        out = []
        for each in sorted(found, key=_by_number):
            try:
                values = np.asarray(self.columns[each], np.float64)
            except ValueError:
                values = np.array([_number(self.path, each, row, v) for row, v in enumerate(self.columns[each], 1)])
            flat = values.reshape(len(values), -1)
            labels = [""] if values.ndim == 1 else [str(list(i)) for i in np.ndindex(values.shape[1:])]
            out += [(f"{each}{label}", column) for label, column in zip(labels, flat.T, strict=True)]
        return out

    def text(self, name: str) -> list[str]:
        """A column of names.

        Raises
        ------
        InputError
            There is none.
        """
        if name not in self.columns:
            raise InputError(f"{self.path}: has no column {name!r}, only {_listed(self.columns)}")
        return [str(value) for value in self.columns[name]]

    def one(self, name: str) -> Array:
        """The only column of a name."""
        found = self.named(name)
        if len(found) > 1:
            raise InputError(f"{self.path}: {name} has {len(found)} columns, one is needed")
        return found[0][1]


class ColumnLogs(NamedTuple):
    """Recordings; raw units in one unit of each feature (n,); names of the features; remarks for the user."""

    runs: list[FeatureRun]
    step: Array
    names: list[str]
    remarks: list[str]


def read_plain_log(path: Path) -> ColumnLogs:
    """A CSV with columns named as in PLAIN: a board's features in its own integers, as FEATURES sends them.

    Columns touch, recording and tip may be absent; of the wrench, those of axes that nothing measured.
    """
    source = _opened(path)
    wrench = tuple(name if name in source.columns else "" for name in WRENCH)
    if not any(wrench):
        raise InputError(f"{path}: has no column of {', '.join(WRENCH)}: add the reference, N and N m")
    touch, recording, tip = (name if name in source.columns else "" for name in ("touch", "recording", "tip"))
    columns = replace(PLAIN, wrench=wrench, touch=touch, recording=recording, tip=tip)
    return read_column_logs([path], columns, is_raw=True)


def read_column_logs(paths: Sequence[Path], columns: Columns, *, is_raw: bool = False) -> ColumnLogs:
    """Every recording of the files. is_raw : features are a board's own integers already.

    Raises
    ------
    InputError
        A file or column is missing, a cell is no number, time does not rise, files differ in their features, or units
        cannot be right. The message names file, column, row and remedy.
    """
    sources = [_opened(path) for path in _files(paths)]
    tables = [_features(source, columns) for source in sources]
    names = tables[0][0]
    for source, (others, _) in zip(sources, tables, strict=True):
        if others != names:
            first = next((n for n in [*others, *names] if (n in others) != (n in names)), others[0])
            raise InputError(
                f"{source.path}: column {first}: {len(others)} features, {sources[0].path.name} has {len(names)}: "
                "a recording of another sensor; fit each sensor separately"
            )
    step = np.ones(len(names))
    if not is_raw:
        for source, (_, values) in zip(sources, tables, strict=True):
            _check_size(source.path, names, values, columns.unit)
        step = _steps(np.concatenate([values for _, values in tables]), columns.unit)
    else:
        for source, (_, values) in zip(sources, tables, strict=True):
            _check_raw(source.path, names, values)
    by_file = [_runs(source, columns, values, step) for source, (_, values) in zip(sources, tables, strict=True)]
    _check_alike(sources, columns, by_file)
    runs, remarks = [run for each in by_file for run in each], list[str]()
    pressing = np.concatenate([run.reference for run in runs])
    if pressing[:, 2].mean() > 0:
        remarks.append("Fz is positive on average: pressing must be negative (forces act on the pad, +z out of it)")
    for run in runs:
        between = np.zeros(0) if run.touch is None else np.diff(run.time_s)[np.diff(run.touch) == 0]
        if len(between) and (slow := float(np.median(between))) > SLOW_S:
            remarks.append(f"{run.name}: {columns.time}: frames of a touch are {slow:.3g} s apart: is it in ms?")
    return ColumnLogs(runs, step, names, remarks)


def _files(paths: Sequence[Path]) -> list[Path]:
    out = list[Path]()
    for path in paths:
        found = sorted(p for p in path.iterdir() if p.suffix in (".h5", ".hdf5", ".csv")) if path.is_dir() else [path]
        if not found:
            raise InputError(f"{path}: holds no .h5, .hdf5 or .csv file")
        out += found
    return out


def _opened(path: Path) -> Source:
    if path.suffix == ".csv":
        header, rows = read_rows(path)
        return Source(path, {name: [row[i] for row in rows] for i, name in enumerate(header)})
    import h5py

    found: dict[str, Any] = {}
    try:
        with h5py.File(readable(path, None)) as file:
            for name, node in _datasets(file):
                is_text = node.dtype.kind in "OS"
                found[name] = node.asstr()[:].tolist() if is_text else dataset_values(node, f"{path}: {name}")
    except (OSError, RuntimeError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read as HDF5: {error}") from error
    return Source(path, found)


def _datasets(file: Any) -> list[tuple[str, Any]]:
    """Arrays of numbers, and columns of text, of an HDF5 file, by name."""
    import h5py

    found: list[tuple[str, Any]] = []

    def look(name: str, node: Any) -> None:
        if not hasattr(node, "dtype") or not node.shape:
            return
        is_text = h5py.check_string_dtype(node.dtype) is not None and node.ndim == 1 and node.size <= MOST_TEXTS
        if node.dtype.kind in "fiub" or is_text:
            found.append((name, node))

    file.visititems(look)
    return found


def _features(source: Source, columns: Columns) -> tuple[list[str], Array]:
    named = [each for name in columns.features for each in source.named(name)]
    names, values = [name for name, _ in named], np.stack([v for _, v in named], axis=1)
    _check_finite(source.path, names, values)
    return names, values * LENGTHS_MM.get(columns.unit, 1.0)


def _runs(source: Source, columns: Columns, values: Array, step: Array) -> list[FeatureRun]:
    path, time_s, wrench = source.path, source.one(columns.time), _wrench(source, columns)
    _check_finite(path, [columns.time], time_s[:, None])
    if len({len(time_s), len(wrench), len(values)}) > 1:
        raise InputError(f"{path}: {columns.time} has {len(time_s)} rows, the features {len(values)}, the wrench "
                         f"{len(wrench)}: one row a frame in each")  # fmt: skip
    touch = _whole(source, columns.touch) if columns.touch else None
    session = _whole(source, columns.recording) if columns.recording else np.zeros(len(time_s), int)
    if len({len(time_s), len(time_s if touch is None else touch), len(session)}) > 1:
        raise InputError(f"{path}: {columns.touch or columns.recording} has other rows than {columns.time}: one row a "
                         "frame in each")  # fmt: skip
    tip = np.array(source.text(columns.tip) if columns.tip else [""] * len(time_s), dtype=str)
    if len(tip) != len(time_s):
        raise InputError(f"{path}: {columns.tip} has {len(tip)} rows, {columns.time} {len(time_s)}: one row a frame in "
                         "each")  # fmt: skip
    out = []
    for number, kind in sorted(set(zip(session.tolist(), tip.tolist(), strict=True))):
        rows = np.flatnonzero((session == number) & (tip == kind))
        back = np.flatnonzero(np.diff(time_s[rows]) < 0)
        if len(back):
            raise InputError(f"{path}: {columns.time}, row {rows[back[0] + 1] + 1}: time runs backwards: is this the "
                             "column of time? Give each recording a file of its own, or name --recording")  # fmt: skip
        name, of_file = (
            f"{where}/{number}" if columns.recording else f"{where}" for where in (path.name, path.resolve())
        )
        when = time_s[rows]
        # Errors on tips left out are those of another tip.
        of_recording = of_file if columns.recording or not kind else f"{of_file}, {kind}"
        out.append(FeatureRun(
            name, when, np.round(values[rows] * step), np.ones(len(rows), bool), when, wrench[rows],
            touch=None if touch is None else touch[rows], recording=of_recording, kind=kind or UNNAMED,
        ))  # fmt: skip
    return out


def _wrench(source: Source, columns: Columns) -> Array:
    """N and N m, (t, 6)."""
    path = source.path
    named = [each for name in columns.wrench for each in (source.named(name) if name else [("", None)])]
    if len(named) != 6:
        raise InputError(f"{path}: the wrench has {len(named)} columns: name six, fx fy fz tx ty tz, with '' for an "
                         "axis that nothing measures")  # fmt: skip
    n = next(len(v) for _, v in named if v is not None)
    values = np.stack([np.zeros(n) if v is None else v for _, v in named], axis=1)
    names = [name for name, _ in named]
    _check_finite(path, names, values)
    units = columns.wrench_unit if len(columns.wrench_unit) == 2 else ()
    if not units:
        raise InputError("wrench_unit needs two: of forces and of torques, such as N and N m")
    wrench = np.asarray(values * ([force_factor(units[0])] * 3 + [torque_factor(units[1])] * 3))
    _check_wrench(path, names, wrench, units)
    return wrench


def _check_raw(path: Path, names: list[str], values: Array) -> None:
    """Refuse features that are no integers of a board: relative changes, per cent, pixels."""
    wrong = (values != np.round(values)) | (np.abs(values) > MOST_RAW)
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        raise InputError(f"{path}: column {names[column]}, row {row + 1}: {values[row, column]:g} is none of the "
                         "board's integers: give the numbers of FEATURES, or leave --board out")  # fmt: skip


def _whole(source: Source, name: str) -> npt.NDArray[np.intp]:
    """A column of numbers of touches or recordings."""
    values = source.one(name)
    _check_finite(source.path, [name], values[:, None])
    if (wrong := np.flatnonzero(values != np.round(values))).size:
        raise InputError(f"{source.path}: column {name}, row {wrong[0] + 1}: {values[wrong[0]]:g} is no whole number: "
                         "number touches and recordings")  # fmt: skip
    return np.asarray(values.astype(np.intp))


def _check_alike(sources: list[Source], columns: Columns, by_file: list[list[FeatureRun]]) -> None:
    """Refuse a recording whose axes are swapped, turned round or in another unit against those of the others.

    The same sensor makes the same wrench of the same features: what a linear map of the others' features says of a
    recording's axes must be like these. Axes that are hardly loaded, or not linear enough, are not judged.
    """
    for i in reversed(range(len(sources))):
        own, others = by_file[i], [run for j, runs in enumerate(by_file) if j != i for run in runs]
        if min(sum(len(run.time_s) for run in part) for part in (own, others)) < LEAST_ROWS:
            continue
        x, y = (np.concatenate([getattr(run, name) for run in others]) for name in ("features", "reference"))
        truth = np.concatenate([run.reference for run in own])
        scale = np.maximum(x.std(axis=0), 1e-9)
        z = (x - x.mean(axis=0)) / scale
        gain = np.linalg.solve(z.T @ z + LIKE_RIDGE * len(z) * np.eye(z.shape[1]), z.T @ (y - y.mean(axis=0)))
        said = (np.concatenate([run.features for run in own]) - x.mean(axis=0)) / scale @ gain
        _check_axes(sources[i], columns, said, truth, sources[0 if i else 1].path.name)


def _check_axes(source: Source, columns: Columns, said: Array, truth: Array, other: str) -> None:
    """`said` by the other recordings' map and `truth`, (t, 6)."""
    spread, spread_said = truth.std(axis=0), said.std(axis=0)
    ok = np.outer(spread_said > 0, spread > 0)
    size = np.maximum(np.outer(spread_said, spread), 1e-30)
    like = np.where(ok, (said - said.mean(axis=0)).T @ (truth - truth.mean(axis=0)) / len(said) / size, 0.0)
    names = [label for name in columns.wrench for label, _ in (source.named(name) if name else [("", truth[:, 0])])]
    for a in range(6):
        row = 1 + int(np.abs(truth[:, a]).argmax())
        where = f"{source.path}: {names[a]}, row {row}"
        if like[a, a] < -SURE:
            raise InputError(f"{where}: {WRENCH[a]} has the other sign than in {other}: turn it round in one of them")
        for b in range(a + 1, 6):
            if min(abs(like[a, b]), abs(like[b, a])) > SURE and max(abs(like[a, a]), abs(like[b, b])) < UNSURE:
                raise InputError(f"{where}: {WRENCH[a]} and {WRENCH[b]} look swapped against {other}: name --wrench in "
                                 "the order fx fy fz tx ty tz, separately for each file if they differ")  # fmt: skip
        times = spread[a] / max(spread_said[a], 1e-30)
        if like[a, a] > SURE and not 1 / OTHER_UNIT < times < OTHER_UNIT:
            raise InputError(f"{where}: {WRENCH[a]} is {times:.3g} times what the same features make in {other}: bring "
                             "both to one unit (--wrench-unit), or fit each sensor separately")  # fmt: skip


def _check_wrench(path: Path, names: list[str], wrench: Array, units: Sequence[str]) -> None:
    force, torque = (float(np.sqrt((wrench[:, part] ** 2).sum(axis=1).mean())) for part in (slice(0, 3), slice(3, 6)))
    if torque > 0 and force > 0 and not LEAST_ARM_MM < 1e3 * torque / force < MOST_ARM_MM:
        column = 3 + int(np.abs(wrench[:, 3:]).max(axis=0).argmax())
        row = 1 + int(np.abs(wrench[:, column]).argmax())
        arm_mm = 1e3 * torque / force
        what = (
            "forces and torques look swapped: name --wrench in the order fx fy fz tx ty tz"
            if LEAST_ARM_MM < 1e3 * force / torque < MOST_ARM_MM and force < 1
            else "they look like N mm: give --wrench-unit N,Nmm" if arm_mm > MOST_ARM_MM
            else "they look like N m: give --wrench-unit N,Nm"
        )  # fmt: skip
        raise InputError(f"{path}: {names[column]}, row {row}: torques read as {units[1]} are {arm_mm:.3g} mm times "
                         f"the forces; {what}")  # fmt: skip
    if force > MOST_FORCE_N:
        column = int(np.abs(wrench[:, :3]).max(axis=0).argmax())
        row = 1 + int(np.abs(wrench[:, column]).argmax())
        raise InputError(f"{path}: {names[column]}, row {row}: forces read as {units[0]} are {force:.3g} N: are they "
                         "in mN? Give --wrench-unit mN,...")  # fmt: skip
    mean = np.abs(wrench[:, :3].mean(axis=0))
    side = int(mean[:2].argmax())
    if mean[side] > TURNED * mean[2] and mean[side] > 0.5 * float(np.sqrt((wrench[:, side] ** 2).mean())):
        row = 1 + int(np.abs(wrench[:, side]).argmax())
        raise InputError(f"{path}: {names[side]}, row {row}: {WRENCH[side]} presses on average, fz hardly: columns "
                         "look swapped; name --wrench in the order fx fy fz tx ty tz, z out of the pad")  # fmt: skip


def _check_size(path: Path, names: list[str], values: Array, unit: str) -> None:
    if not unit:
        return
    kind = "px" if unit == "px" else "mm"
    row, column = np.unravel_index(int(np.abs(values).argmax()), values.shape)
    largest = float(np.abs(values[row, column]))
    if LEAST[kind] <= largest <= MOST[kind]:
        return
    guess = "m or another unit" if largest < LEAST[kind] else "um or px"
    raise InputError(f"{path}: {names[column]}, row {row + 1}: the largest displacement, read as {unit}, is "
                     f"{largest:.3g} {kind}: is it in {guess}? Give --unit")  # fmt: skip


def _check_finite(path: Path, names: list[str], values: Array) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise InputError(f"{path}: {names[column]}, row {row + 1} is not a number: delete that row, or the column")


def _steps(values: Array, unit: str) -> Array:
    """Raw units in one of each feature: of displacements fixed, of others by the largest value in the log."""
    if unit:
        return np.full(values.shape[1], STEP)
    largest = np.maximum(np.abs(values).max(axis=0), 1e-30)
    return np.asarray(2.0 ** np.floor(np.log2(LARGEST_RAW / largest)))


def _number(path: Path, name: str, row: int, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise InputError(f"{path}: {name}, row {row}: {cell!r} is no number: correct or delete that row") from None


def _by_number(name: str) -> tuple[object, ...]:
    """m2 before m10."""
    return tuple(int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name))


def _listed(names: dict[str, Any]) -> str:
    shown = list(names)[:12]
    return ", ".join(shown) + (f" and {len(names) - 12} others" if len(names) > 12 else "")
