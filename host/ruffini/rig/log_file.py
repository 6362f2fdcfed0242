"""The calibration log: one HDF5 file, described in host/ruffini/rig/README.md. SI units throughout.

While it is collected every touch is a file of its own beside it, whole or not there, so that nothing that was
collected can be lost; the log is made of them at the end.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.files import write_whole

Array = npt.NDArray[np.float64]

FORMAT, FORMAT_VERSION = "ruffini-calibration-log", 1
ARRAYS = {  # name: columns (None = one-dimensional), unit
    "stream_s": (None, "s"), "stream_host_s": (None, "s"), "stream_frame": (None, ""), "stream_flags": (None, ""),
    "stream_wrench": (6, "N, N m"), "stream_validity": (6, ""),
    "reference_s": (None, "s"), "reference_wrench": (6, "N, N m"),
    "stage_s": (None, "s"), "stage_place": (3, "m"),
}  # fmt: skip
OPTIONAL = {"field_s": "s", "field_displacement": "m"}


class TouchRecord(NamedTuple):
    """One touch: what was wanted and found (`facts`, JSON), and its arrays by name."""

    facts: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]]


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
            before = json.loads(begun.read_text())
            other = sorted(k for k in before.keys() | facts.keys() if before.get(k) != facts.get(k))
            if other:
                raise InputError(
                    f"{self._folder} was begun with another {', '.join(other)}: give the same, or another --out"
                )
        else:
            write_whole(begun, json.dumps(facts, indent=1).encode())

    def done(self) -> set[int]:
        """Numbers of the touches that are there."""
        return {int(p.stem) for p in self._folder.glob("[0-9]*.h5")}

    def write(self, number: int, record: TouchRecord) -> None:
        """Keep one touch."""
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            _put(file, record)
        write_whole(self._folder / f"{number:05d}.h5", stream.getvalue())

    def finish(self) -> None:
        """Make the log of its touches, and remove them."""
        parts = sorted(self._folder.glob("[0-9]*.h5"))
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            file.attrs["format"], file.attrs["format_version"] = FORMAT, FORMAT_VERSION
            file.attrs["facts"] = json.dumps(self._facts)
            for part in parts:
                with h5py.File(part) as one:
                    _put(file.create_group(f"touch/{part.stem}"), _get(one))
        write_whole(self.path, stream.getvalue())
        for part in [*parts, self._folder / "log.json"]:
            part.unlink()
        self._folder.rmdir()


def _put(group: h5py.Group, record: TouchRecord) -> None:
    group.attrs["facts"] = json.dumps(record.facts)
    for name, array in record.arrays.items():
        data = group.create_dataset(name, data=array, compression="gzip" if np.size(array) > 1000 else None)
        data.attrs["unit"] = ARRAYS[name][1] if name in ARRAYS else OPTIONAL[name]


def _get(group: h5py.Group) -> TouchRecord:
    return TouchRecord(json.loads(group.attrs["facts"]), {name: group[name][()] for name in group})


class Log(NamedTuple):
    """A log as read."""

    facts: dict[str, Any]
    touches: list[TouchRecord]


def read_log(path: Path) -> Log:
    """Read a log, whoever wrote it.

    Raises
    ------
    InputError
        Not such a file; an array missing, of another length or shape, or not finite; times that do not rise.
    """
    try:
        with h5py.File(path) as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("format_version") != FORMAT_VERSION:
                raise InputError(f"{path} is no {FORMAT} of version {FORMAT_VERSION}")
            facts = json.loads(file.attrs["facts"])
            touches = [_get(file["touch"][name]) for name in sorted(file.get("touch", {}))]
    except (OSError, KeyError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} cannot be read as a calibration log: {error}") from error
    if not touches:
        raise InputError(f"{path} has no touch")
    for i, touch in enumerate(touches):
        _check(f"{path}, touch {i}", touch.arrays)
    return Log(facts, touches)


def _check(where: str, arrays: dict[str, npt.NDArray[Any]]) -> None:
    missing = [name for name in ARRAYS if name not in arrays]
    if missing:
        raise InputError(f"{where} lacks {', '.join(missing)}")
    for name, (columns, _) in ARRAYS.items():
        clock = f"{name.split('_')[0]}_s"
        wanted = (len(arrays[clock]),) if columns is None else (len(arrays[clock]), columns)
        if arrays[name].shape != wanted:
            raise InputError(f"{where}: {name} is {arrays[name].shape}, {clock} asks for {wanted}")
    for clock in ("stream_s", "reference_s"):
        if not np.isfinite(arrays[clock]).all() or (np.diff(arrays[clock]) <= 0).any():
            raise InputError(f"{where}: {clock} stands still or goes back: its stamps cannot be used")
