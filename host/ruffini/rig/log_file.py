"""The calibration log: one HDF5 file. SI units throughout, `unit` beside each array.

While it is collected every touch is a file of its own in LOG.h5.parts/, whole or not there, so that nothing that was
collected can be lost; the log is made of them at the end.

Attributes: `format`, `format_version`, `facts` (JSON: board, program, `tip`, bench) and `found` (JSON, below; missing
in older logs). One group `touch/NNNNN` a touch, with its own clock, `facts` (JSON: `temperatures_c`, `kind`, wanted
place, depth and shear, `contact_z_m`, `held_host_s`, `lifted_host_s`, `tare`, `tries`; `lost_packets` where the
reference numbers its packets) and these arrays:

stream_*      a row a frame: sensor's time, host's time of arrival without queueing, frame number, FlagBit mask, wrench
              about the pad's centre (NaN if not measured), Validity. Without a force also stream_activity,
              stream_motion (px)
reference_*, stage_*
              host's time; wrench in the reference's frame, tare removed; tip from the pad's centre (empty without a
              stage)
contact_*     a row for each contact in each frame: number, place on the unrolled skin, force, deviations, hardness
field_*, rest_field_*
              displacement (n_y, n_x, 3) at the nodes, in a few frames of the hold and before the touch
marker_*      displacement of each marker or target in `facts["marker_unit"]`, third column change of area (px^2;
              relative in logs of `cal convert`); marker_place: at rest
feature*      without markers or targets: the integers of the wrench (FEATURES of proto/README.md), 10 frames before
              the touch and 40 from it on
image*        B G R, each `image_step_px`-th pixel: before the touch, of the hold, and without the three above also of
              the way down

`found` (or `why_not`): `reference` (name, unit, full scale, uncertainty, rate stated and measured, `lost_packets` of
the touches that were kept); `checks` (unit,
axes, rate, tare: `ok` true, false, null, and `text`); `clocks` per `session`: reference time = stream time +
`offset_s` + `drift` (stream time - `middle_s`), `sigma_s`, `drift_sigma`; `frame` (`rotation`, `arm_m`, `hanging`);
`contacts` (`offset_m`, `spread_m`, `gain`, `gain_spread`). `found.reference_in_pad(log, touch)` and
`found.on_reference_clock` apply them.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from ruffini.device.results import INVALID
from ruffini.errors import InputError
from ruffini.files import dataset_values, lock_alone, readable, write_whole

Array = npt.NDArray[np.float64]

FORMAT, FORMAT_VERSION = "ruffini-calibration-log", 1
ARRAYS = {  # name: columns (None = one-dimensional), unit
    "stream_s": (None, "s"), "stream_host_s": (None, "s"), "stream_frame": (None, ""), "stream_flags": (None, ""),
    "stream_wrench": (6, "N, N m"), "stream_validity": (6, ""),
    "reference_s": (None, "s"), "reference_wrench": (6, "N, N m"),
    "stage_s": (None, "s"), "stage_place": (3, "m"),
}  # fmt: skip
OPTIONAL = {  # clock: array, number of dimensions, unit; a unit of None is facts["marker_unit"], px or m
    "field_s": ("field_displacement", 4, "m"),
    "rest_field_s": ("rest_field_displacement", 4, "m"),
    "marker_s": ("marker_displacement", 3, None),
    "image_s": ("image", 4, ""),
    "feature_s": ("feature", 2, ""),  # the board's integers, where it has no markers or targets
}
CONTACTS = {  # optional, all or none: a row for each contact in each frame; columns, unit
    "contact_s": (None, "s"), "contact_number": (None, ""), "contact_place": (2, "m"), "contact_force": (None, "N"),
    "contact_sigma": (2, "N, m"),
}  # fmt: skip
MARKER_PLACE, ACTIVITY, MOTION = "marker_place", "stream_activity", "stream_motion"
CONTACT_SHORE = "contact_shore"  # optional, beside the other contacts: hardness of the object, NaN where not valid
UNITS = {
    **{name: unit for name, (_, unit) in {**ARRAYS, **CONTACTS}.items()},
    **{clock: "s" for clock in OPTIONAL},
    **{name: unit for name, _, unit in OPTIONAL.values()},
    MARKER_PLACE: None,
    ACTIVITY: "px",
    MOTION: "px",
    CONTACT_SHORE: "Shore A",
}


class TouchRecord(NamedTuple):
    """One touch: what was wanted and found (`facts`, JSON), and its arrays by name."""

    facts: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]]


def stated_wrench(touch: TouchRecord) -> npt.NDArray[np.float64]:
    """(t, 6) N and N m that the sensor stated of a touch; NaN where it called them invalid."""
    return np.where(touch.arrays["stream_validity"] == INVALID, np.nan, touch.arrays["stream_wrench"])


class LogWriter:
    """Collects touches for a log; opening one that was begun goes on with it.

    Raises
    ------
    InputError
        What is there belongs to another plan, board, sensor or reference.
    """

    def __init__(self, path: Path, facts: dict[str, Any]) -> None:
        self.path, self._facts = path, facts
        self._folder = path.with_name(path.name + ".parts")
        begun = self._folder / "log.json"
        if path.exists():
            raise InputError(f"{path} exists and is complete: choose another name, or remove it")
        if begun.exists():
            before = _begun(begun)
            other = sorted(k for k in before.keys() | facts.keys() if before.get(k) != facts.get(k))
            if other:
                raise InputError(
                    f"{self._folder} was begun with another {', '.join(other)}: give the same, or another --out"
                )
        else:
            write_whole(begun, json.dumps(facts, indent=1).encode())

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other programs from collecting into this log. Raises InputError where one does."""
        try:
            lock = (self._folder / "log.json").open("r+b")
        except FileNotFoundError as error:
            raise InputError(f"{self.path}: another program has completed it: give another --out") from error
        with lock:
            lock_alone(lock, f"{self._folder}: another program collects into it now: give another --out")
            yield

    def done(self) -> set[int]:
        """Numbers of the touches that are there."""
        return {int(p.stem) for p in self._folder.glob("[0-9]*.h5")}

    def write(self, number: int, record: TouchRecord) -> None:
        """Keep one touch."""
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            _put(file, record)
        write_whole(self._folder / f"{number:05d}.h5", stream.getvalue())

    def touches(self) -> dict[int, TouchRecord]:
        """The touches that are there, by number."""
        return {int(p.stem): _get_file(p) for p in sorted(self._folder.glob("[0-9]*.h5"))}

    def doubt(self, numbers: Iterable[int]) -> None:
        """Set touches aside that must not be believed: they count as not done."""
        for number in numbers:
            (self._folder / f"{number:05d}.h5").replace(self._folder / f"doubtful-{number:05d}.h5")

    def side_file(self, name: str) -> Path:
        """A file that is kept beside the touches until the log is whole."""
        return self._folder / name

    def finish(self, found: dict[str, Any] | None = None) -> None:
        """Make the log of its touches, with what was estimated from all of them, and remove them."""
        write_log(self.path, Log(self._facts, list(self.touches().values()), found or {}))
        for part in self._folder.iterdir():
            part.unlink()
        self._folder.rmdir()


def _begun(path: Path) -> dict[str, Any]:
    """What a log was begun with."""
    try:
        before = json.loads(readable(path).read_text())
        if isinstance(before, dict):
            return before
        why = "it is no JSON object"
    except (OSError, ValueError, RecursionError) as error:
        why = str(error)
    raise InputError(f"{path}: cannot be read ({why}): begin a new log in another place")


def write_log(path: Path, log: Log) -> None:
    """A whole log at once."""
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.attrs["format"], file.attrs["format_version"] = FORMAT, FORMAT_VERSION
        file.attrs["facts"], file.attrs["found"] = json.dumps(log.facts), json.dumps(dict(log.found))
        for number, touch in enumerate(log.touches):
            _put(file.create_group(f"touch/{number:05d}"), touch, log.facts.get("marker_unit", "px"))
    write_whole(path, stream.getvalue())


def _put(group: h5py.Group, record: TouchRecord, marker_unit: str = "px") -> None:
    group.attrs["facts"] = json.dumps(record.facts)
    for name, array in record.arrays.items():
        data = group.create_dataset(name, data=array, compression="gzip" if np.size(array) > 1000 else None)
        data.attrs["unit"] = marker_unit if UNITS[name] is None else UNITS[name]


def _get_file(path: Path) -> TouchRecord:
    try:
        with h5py.File(readable(path, None)) as file:
            return _get(file)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({error}): remove it, and it is collected again") from error


def _get(group: h5py.Group) -> TouchRecord:
    if not hasattr(group, "keys"):
        raise InputError(f"{group.name} is no group of arrays")
    arrays = {name: dataset_values(group[name], f"{group.name}/{name}") for name in group if name in UNITS}
    return TouchRecord(_tree(group, "facts"), arrays)


def _tree(node: Any, name: str, default: str | None = None) -> dict[str, Any]:
    """An attribute that holds a JSON object."""
    tree = json.loads(node.attrs[name] if default is None else node.attrs.get(name, default))
    if not isinstance(tree, dict):
        raise InputError(f"{name} is no JSON object")
    return tree


class Log(NamedTuple):
    """A log as read; `found` is what was estimated and checked over all touches, empty in logs that do not say."""

    facts: dict[str, Any]
    touches: list[TouchRecord]
    found: Mapping[str, Any] = MappingProxyType({})


def is_log(path: Path) -> bool:
    """True of a file that says it is such a log, whether or not it can be read."""
    try:
        with h5py.File(readable(path, None)) as file:
            return bool(file.attrs.get("format") == FORMAT)
    except OSError:
        return False


def read_log(path: Path) -> Log:
    """Read a log of any program.

    Raises
    ------
    InputError
        Not such a file; an array missing, of another length or shape, or not finite; times that do not rise.
    """
    try:
        with h5py.File(readable(path, None)) as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("format_version") != FORMAT_VERSION:
                raise InputError(f"{path} is no {FORMAT} of version {FORMAT_VERSION}")
            facts, found = _tree(file, "facts"), _tree(file, "found", "{}")
            group = file.get("touch", {})
            if not hasattr(group, "keys"):
                raise InputError("touch is no group")
            touches = [_get(group[name]) for name in sorted(group)]
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise InputError(f"{path} cannot be read as a calibration log: {error}") from error
    if not touches:
        raise InputError(f"{path} has no touch")
    for i, touch in enumerate(touches):
        _check(f"{path}, touch {i}", touch.arrays)
    return Log(facts, touches, found)


def _check(where: str, arrays: dict[str, npt.NDArray[Any]]) -> None:
    table = {**ARRAYS, **(CONTACTS if not CONTACTS.keys().isdisjoint(arrays) else {})}
    missing = [name for name in table if name not in arrays]
    if missing:
        raise InputError(f"{where} lacks {', '.join(missing)}")
    if not len(arrays["reference_s"]):
        raise InputError(f"{where}: the reference is empty: collect it again, with the reference connected")
    for name, (columns, _) in table.items():
        clock = f"{name.split('_')[0]}_s"
        wanted = (len(arrays[clock]),) if columns is None else (len(arrays[clock]), columns)
        if arrays[name].shape != wanted:
            raise InputError(f"{where}: {name} is {arrays[name].shape}, {clock} asks for {wanted}")
    for clock, (name, n_dimensions, _) in OPTIONAL.items():
        if (clock in arrays) != (name in arrays):
            raise InputError(f"{where}: {clock} and {name} belong together: give both or none")
        if name in arrays and (arrays[name].ndim, len(arrays[name])) != (n_dimensions, len(arrays[clock])):
            raise InputError(f"{where}: {name} is {arrays[name].shape}, {clock} asks for {len(arrays[clock])} in "
                             f"{n_dimensions} dimensions")  # fmt: skip
    if ACTIVITY in arrays and arrays[ACTIVITY].shape != arrays["stream_s"].shape:
        raise InputError(
            f"{where}: stream_activity is {arrays[ACTIVITY].shape}, one value for each stream_s is asked for"
        )
    if CONTACT_SHORE in arrays and arrays[CONTACT_SHORE].shape != arrays.get("contact_s", np.zeros(0)).shape:
        raise InputError(
            f"{where}: contact_shore is {arrays[CONTACT_SHORE].shape}, one value for each contact_s is asked for"
        )
    if MOTION in arrays and arrays[MOTION].shape[:1] != arrays["stream_s"].shape:
        raise InputError(f"{where}: stream_motion is {arrays[MOTION].shape}, one row for each stream_s is asked for")
    if MARKER_PLACE in arrays:
        n_markers = arrays["marker_displacement"].shape[1] if "marker_displacement" in arrays else 0
        if arrays[MARKER_PLACE].shape != (n_markers, 2):
            raise InputError(f"{where}: marker_place is {arrays[MARKER_PLACE].shape}, {(n_markers, 2)} is asked for")
    for clock in ("stream_s", "reference_s"):
        if not np.isfinite(arrays[clock]).all() or (np.diff(arrays[clock]) <= 0).any():
            raise InputError(f"{where}: {clock} stands still or goes back: its stamps cannot be used")
