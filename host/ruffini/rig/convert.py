"""A CSV from elsewhere as a calibration log: time, wrench, displacements of markers. README has a worked example.

Names of columns say what they are and in which unit: time_s, fx_N .. tz_Nmm, m0_dx_px, m0_dy_px, m0_da (relative
change of the marker's area), m0_dz_mm, m0_x_px, m0_y_px (where it is at rest), m0_x_mm, m0_y_mm (likewise, from the
pad's centre), x_mm y_mm z_mm (the tip), touch (number, 0 = nothing touches; without it touches are cut where the force
exceeds 0.09 N). With m0_dz_mm, the places in mm and a board the log gets the nodes' displacement, for `cal fit`. Other
names are renamed by a TOML file: our name = "theirs", with {i} for the marker's number. Its table [gauges], with
columns and matrix as in a bench's file, makes wrenches of six voltages; columns are named as after renaming, and
columns of force are then ignored.
"""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.older_python import tomllib
from ruffini.rig.csv_log import Gauges, Table, gauges_of, read_table, wrench_log
from ruffini.rig.cutting import Cut, cut, tare_of
from ruffini.rig.log_file import Log, TouchRecord

Array = npt.NDArray[np.float64]

METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
MARKER = re.compile(r"m(\d+)_(dx|dy|dz|da|x|y)(?:_(px|m|mm|um))?")
TIP = re.compile(r"([xyz])_(m|mm|um)")
TOUCH = "touch"
MOST_MARKERS = 100_000


class Markers(NamedTuple):
    """Displacement (t, n, 2 or 3: x, y, relative area), out of the plane (t, n) m or None, places (n, 2) or None."""

    displacement: Array
    out_m: Array | None
    place: Array | None
    unit: str


def convert(path: Path, columns: Path | None = None, board: Board | None = None) -> Log:
    """Read a CSV as a log. With `board`, displacements of all three axes, in metres, are also given at its nodes.

    Raises
    ------
    InputError
        No time, no force, a marker that lacks a column, columns in different units, or no touch.
    """
    names, gauges = _names(columns) if columns else ({}, None)
    table = read_table(path, names)
    time_s, wrench = wrench_log(table, gauges)
    markers, tip = _markers(table), _tip(table)
    if TOUCH in table.names:
        cuts = _numbered(str(path), time_s, table.column(TOUCH))
    else:
        wrench = wrench - tare_of(str(path), wrench)
        cuts = cut(str(path), time_s, wrench)
    facts: dict[str, Any] = {"board": board.name if board else None, "program": "convert", "source": path.name,
                             "marker_unit": markers.unit if markers else "px", "tip": None}  # fmt: skip
    touches = [_touch(time_s, wrench, markers, tip, board, one) for one in cuts]
    reference = {"name": path.name, "unit": "N", "sigma": None}  # fmt: skip
    return Log(facts, touches, {"reference": reference})


def _names(path: Path) -> tuple[dict[str, str], Gauges | None]:
    """Our name of each of their columns and what gauges there are, as a TOML file says it."""
    try:
        file = tomllib.loads(readable(path).read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    ours, n_markers = file.get("columns", {}), file.get("n_markers", 0)
    unknown = sorted(file.keys() - {"columns", "n_markers", "first", "gauges"})
    if unknown or not isinstance(ours, dict) or not all(isinstance(v, str) for v in ours.values()):
        raise InputError(f"{path}: {unknown[0] if unknown else 'columns'}: unknown, or no table of names: "
                         'give [columns] with lines such as fz_N = "Load"')  # fmt: skip
    first, out = file.get("first", 0), {}
    if type(n_markers) is not int or not 0 <= n_markers <= MOST_MARKERS or type(first) is not int:
        raise InputError(f"{path}: n_markers and first are whole numbers, n_markers at most {MOST_MARKERS}")
    for name, theirs in ours.items():
        if "{i}" in name:
            out.update({
                theirs.replace("{i}", str(first + i)): name.replace("{i}", str(i)) for i in range(n_markers)
            })  # fmt: skip
        else:
            out[theirs] = name
    return out, _gauges(path, file.get("gauges"))


def _gauges(path: Path, found: object) -> Gauges | None:
    if found is None:
        return None
    if not isinstance(found, dict) or found.keys() != {"columns", "matrix"}:
        raise InputError(f"{path}: gauges: give [gauges] with columns and matrix, and nothing else")
    try:
        return gauges_of(found["columns"], found["matrix"])
    except InputError as error:
        raise InputError(f"{path}: gauges: {error}") from error


def _markers(table: Table) -> Markers | None:
    columns: dict[str, dict[int, int]] = {}  # by quantity: column by number of the marker
    units: dict[str, set[str]] = {}
    for i, name in enumerate(table.names):
        match = MARKER.fullmatch(name)
        if match:
            columns.setdefault(match[2], {})[int(match[1])] = i
            units.setdefault("z" if match[2] == "dz" else "area" if match[2] == "da" else "xy", set()).add(match[3])
    if not columns:
        return None
    n = 1 + max(k for by_number in columns.values() for k in by_number)
    for quantity in sorted({"dx", "dy", *columns}):
        there = columns.get(quantity, {}).keys()
        if len(there) < n:
            missing = next(k for k in itertools.count() if k not in there)
            raise InputError(f"{table.path}: marker {missing} has no column m{missing}_{quantity}: "
                             "each marker needs the same columns, dx and dy at least")  # fmt: skip
    (unit, *others) = units["xy"]
    if others or unit is None:
        raise InputError(f"{table.path}: m0_dx and all others along x and y need one unit: _px, _mm, _um or _m")
    scale = METRES.get(unit, 1.0)

    def read(quantity: str) -> Array:
        return table.columns([columns[quantity][k] for k in range(n)])

    parts = [read("dx") * scale, read("dy") * scale, *([read("da")] if "da" in columns else [])]
    place = np.column_stack([read("x")[0], read("y")[0]]) * scale if {"x", "y"} <= columns.keys() else None
    out_m = read("dz") * METRES[_metric(table, units["z"])] if "dz" in columns else None
    return Markers(np.stack(parts, axis=-1), out_m, place, "m" if unit in METRES else "px")


def _metric(table: Table, units: set[str]) -> str:
    (unit, *others) = units
    if others or unit not in METRES:
        raise InputError(f"{table.path}: m0_dz and all others along z need one unit of length: _mm, _um or _m")
    return unit


def _tip(table: Table) -> Array | None:
    """Places of the tip, (t, 3) m."""
    found = {m[1]: (i, METRES[m[2]]) for i, name in enumerate(table.names) if (m := TIP.fullmatch(name))}
    if set(found) != set("xyz"):
        return None
    return table.columns([found[a][0] for a in "xyz"]) * [found[a][1] for a in "xyz"]


def _numbered(where: str, time_s: Array, number: Array) -> list[Cut]:
    """Touches as the file counts them; held is their second half."""
    cuts = []
    for value in sorted(set(number[number > 0].tolist())):
        rows = np.flatnonzero(number == value)
        if (np.diff(rows) > 1).any() or len(rows) < 2:
            raise InputError(f"{where}: the rows of touch {value:g} do not follow each other, or are less than two")
        begin, end = time_s[rows[0]], time_s[rows[-1]]
        half_step_s = (end - begin) / (len(rows) - 1) / 2
        cuts.append(Cut(begin - half_step_s, begin, (begin + end) / 2 - half_step_s, end + half_step_s,
                        end + half_step_s))  # fmt: skip
    if not cuts:
        raise InputError(f"{where}: column touch is 0 everywhere: give each touch a number from 1 on")
    return cuts


def _touch(
    time_s: Array, wrench: Array, markers: Markers | None, tip: Array | None, board: Board | None, one: Cut
) -> TouchRecord:
    kept = (time_s > one.start_s) & (time_s < one.end_s)
    t = time_s[kept]
    is_held = (t > one.held_s) & (t < one.lifted_s)
    arrays: dict[str, npt.NDArray[Any]] = {
        "stream_s": t, "stream_host_s": t, "stream_frame": np.flatnonzero(kept),
        "stream_flags": np.zeros(len(t), np.int64), "stream_wrench": np.full((len(t), 6), np.nan),
        "stream_validity": np.zeros((len(t), 6), np.int64), "reference_s": t, "reference_wrench": wrench[kept],
        "stage_s": t if tip is not None else np.zeros(0),
        "stage_place": tip[kept] if tip is not None else np.zeros((0, 3)),
    }  # fmt: skip
    if markers is not None:
        arrays.update(marker_s=t, marker_displacement=markers.displacement[kept])
        arrays.update({"marker_place": markers.place} if markers.place is not None else {})
        if board is not None and markers.out_m is not None and markers.place is not None and markers.unit == "m":
            moved = np.dstack([markers.displacement[kept][is_held][..., :2], markers.out_m[kept][is_held]])
            arrays.update(field_s=t[is_held], field_displacement=at_nodes(board, markers.place, moved))
    facts = {"kind": "converted", "touched_host_s": one.touched_s, "held_host_s": one.held_s,
             "lifted_host_s": one.lifted_s, "session": ""}  # fmt: skip
    return TouchRecord(facts, arrays)


def at_nodes(board: Board, place_m: Array, displacement_m: Array) -> npt.NDArray[np.float32]:
    """Displacements (f, n, 3) of markers at places (n, 2) from the pad's centre, at the board's observed nodes.

    A smooth surface through the markers; beyond the outermost it goes on as it is there.
    """
    from scipy.interpolate import RBFInterpolator

    grid, pad, (rows, columns) = board.grid, board.pad, board.observed
    x = (np.linspace(-0.5, 0.5, grid.n_x) * pad.size_x_um * 1e-6)[columns]
    y = (np.linspace(-0.5, 0.5, grid.n_y) * pad.size_y_um * 1e-6)[rows]
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    flat = displacement_m.transpose(1, 0, 2).reshape(len(place_m), -1)
    surface = RBFInterpolator(place_m, flat, kernel="thin_plate_spline")(nodes)
    out = surface.reshape(len(y), len(x), len(displacement_m), 3).transpose(2, 0, 1, 3)
    return np.asarray(out, np.float32)
