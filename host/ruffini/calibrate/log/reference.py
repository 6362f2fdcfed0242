"""Recordings with a reference wrench beside them, and the small files of what was fitted to them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import Gate, of_stage
from ruffini.core.pipeline import Frame, Pipeline
from ruffini.errors import InputError
from ruffini.files import readable, write_whole
from ruffini.frames import read_frames
from ruffini.rig.csv_log import read_rows

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
Fit = TypeVar("Fit")

VALID = 1  # Validity of ruffini.proto
COLUMNS = ("fx", "fy", "fz", "tx", "ty", "tz")
WANTED = (*COLUMNS, "celsius")


class Played(NamedTuple):
    """Of the frames that a board believes: number in the recording (t,), what was taken of each, reference (t, 6)."""

    frame: npt.NDArray[np.int64]
    taken: Array
    wrench: Array


def play(
    board: Board,
    calibration: CalibrationFile,
    recording: Path,
    reference: Path | None,
    take: Callable[[Pipeline, Frame], Array],
    *,
    is_believed: Callable[[Frame], bool] = lambda frame: frame.force_z_validity == VALID,
    what: str = "has a valid force",
    progress: Progress,
) -> Played:
    """Run a recording through the board's own pipeline; `take` is called where the frame is believed.

    `what` such a frame has, by default a valid normal force, is for the message where there is none. The reference is
    `reference`, or `wrench.csv` in the recording's folder, or a simulated recording's truth.

    Raises
    ------
    InputError
        No reference, another number of rows than frames, or no valid frame.
    """
    wrench = reference_wrench(recording, reference)
    frames = read_frames(recording)
    if len(frames) != len(wrench):
        raise InputError(f"{recording} has {len(frames)} frames, the reference {len(wrench)} rows: one row a frame")
    kept, taken, has_rest = [], [], False
    with Pipeline(board, calibration.data) as pipeline:
        for i, image in enumerate(frames):
            frame = pipeline.process(image)
            has_rest = has_rest or frame.has_reference
            if frame.has_reference and is_believed(frame):
                kept.append(i)
                taken.append(take(pipeline, frame))
            progress((i + 1) / len(frames))
    if not has_rest:
        raise InputError(
            f"{recording} has {len(frames)} pictures, rest is learned from {board.pipeline.n_rest_frames} that are not "
            "dark: record more before the first touch"
        )
    if not kept:
        raise InputError(f"{recording}: no frame {what}: is it this board, with its colours calibrated?")
    return Played(np.array(kept), np.array(taken), wrench[kept])


def reference_wrench(recording: Path, reference: Path | None) -> Array:
    """Reference wrench of each frame, (t, 6) N and N m: `reference`, or the recording's `wrench.csv`, or its truth.

    Raises
    ------
    InputError
        There is none, or it cannot be read.
    """
    if reference is None and (recording / "wrench.csv").is_file():
        reference = recording / "wrench.csv"
    if reference is not None:
        return read_wrench_csv(reference)
    if (recording / "truth.npz").is_file():
        return np.asarray(np.load(readable(recording / "truth.npz"))["wrench"], dtype=np.float64)
    raise InputError(f"{recording} has no wrench.csv: give the load cell's wrenches with --reference")


def read_wrench_csv(path: Path) -> Array:
    """Reference wrench of each frame from a CSV with the columns fx,fy,fz (N), tx,ty,tz (N mm), (t, 6) N and N m.

    Raises
    ------
    InputError
        The file cannot be read, lacks a column, or holds something that is no number.
    """
    table = _csv_table(path)
    missing = [c for c in COLUMNS if c not in table]
    if missing:
        raise InputError(f"{path} lacks the columns {', '.join(missing)}")
    return np.stack([table[c] for c in COLUMNS], axis=1) * ([1.0] * 3 + [1e-3] * 3)


def celsius_of_csv(path: Path) -> Array | None:
    """Column `celsius` (t,) of a wrench.csv; None where there is no such file or column.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    if not path.is_file():
        return None
    table = _csv_table(path)
    return table.get("celsius")


def _csv_table(path: Path) -> dict[str, Array]:
    """Columns (t,) by name; NaN where a cell is empty."""
    names, rows = read_rows(path)
    if not rows:
        raise InputError(f"{path}: has no row of numbers: the reference needs one a frame")
    names[0] = names[0].lstrip("# ")
    cells = [[cell.strip() for cell in column] for column in zip(*rows, strict=True)]
    return {name: _column(path, name, column) for name, column in zip(names, cells, strict=True) if name in WANTED}


def _column(path: Path, name: str, cells: list[str]) -> Array:
    try:
        return np.array([float(cell or "nan") for cell in cells])
    except ValueError as error:
        raise InputError(f"{path}: {name}: a cell is no number: {error}") from error


def write_fit(
    path: Path, board: Board, report: dict[str, Any], stage: str = "", gates: Sequence[Gate] = ()
) -> list[Gate]:
    """A fit's report and the stage's gates as JSON, whole or not at all; returns the gates, marked as the stage's."""
    own = of_stage(stage, gates)
    tree = {"board": board.name, **report, "gates": [gate._asdict() for gate in own]}
    write_whole(path, json.dumps(tree, indent=1).encode() + b"\n")
    return own


def read_fit(path: Path, board: Board, verb: str, parse: Callable[[dict[str, Any]], Fit]) -> Fit:
    """What `write_fit` wrote, as `parse` makes it of the report; `verb` names the command in messages.

    Raises
    ------
    InputError
        Unreadable, not of this kind, or of another board.
    """
    try:
        tree = json.loads(readable(path).read_text())
        fit = parse(tree)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no file of `ruffini {verb}`: {error}") from error
    if tree.get("board") != board.name:
        raise InputError(f"{path}: was measured on board {tree.get('board')!r}, not {board.name!r}")
    return fit
