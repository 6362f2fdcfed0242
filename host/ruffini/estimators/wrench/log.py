"""Image features with a reference wrench beside them: what `ruffini cal fit --only wrench` fits and judges on.

The features are the core's own integers (`Pipeline.features`), whatever their sort and the file: a folder of frames
with `wrench.csv`, a run of `ruffini reproduce --only recordings` with what its bench read, a folder of such runs, a
`cal collect` log, or a CSV of features and reference (`calibrate.log.columns.PLAIN`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, parse_board
from ruffini.calibrate.log.columns import MOST_RAW, read_plain_log
from ruffini.calibrate.log.reference import celsius_of_csv, reference_wrench
from ruffini.calibrate.log.warmth import CELSIUS
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.wrench.run import UNNAMED
from ruffini.estimators.wrench.run import FeatureRun as FeatureRun
from ruffini.estimators.wrench.warmth import Degrees
from ruffini.files import readable
from ruffini.frames import read_frames
from ruffini.native import stage_slots
from ruffini.rig.found import is_held, on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, TouchRecord, read_log
from ruffini.rig.placed_weight import NAME as PLACED

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
LEAST_REST, ZERO_SIGMAS = 8, 12.0  # frames, and standard errors by which a zero must be off to be one
LOST_OR_DARK = 8 | 64 | 128  # of FlagBit: markers lost, dark, overexposed
WRENCH_NAMES = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")  # of [board] not_measured
# Sorts that a log has as places in the picture; of any other as FEATURES sends it. Steps: the core's, px Q16, px^2 Q8.
STEPS = {"targets": (65536.0, 65536.0, 256.0), "markers": (65536.0, 65536.0)}
COLUMNS = "columns"  # sort of a log without a board


class Features(NamedTuple):
    """What the features of a log are, and how many numbers a frame has (`core.pipeline.Features`)."""

    sort: str
    n: int
    grid: tuple[int, int, int] | None = None  # planes, rows, columns
    needs_tables: bool = False  # the board computes them only with a calibration of its unit

    @property
    def is_of_gel(self) -> bool:
        """Whether they are no places of markers or targets: logs have them as FEATURES sends them."""
        return self.sort not in (*STEPS, COLUMNS)


def features_of(board: Board) -> Features:
    """What the stage feature_wrench of a board reads.

    Raises
    ------
    InputError
        None of its stages writes features.
    """
    return _features_of(board.text, board.name)


@lru_cache
def _features_of(text: str, name: str) -> Features:
    with Pipeline(parse_board(text.encode(), name)) as pipeline:
        found, is_computed = pipeline.feature_sort(), "features" in pipeline.slots
    if found is None:
        writers = [stage for stage, slots in stage_slots().items() if "features" in slots]
        raise InputError(f"board {name!r} has no stage {', '.join(writers)}: nothing to make a wrench of")
    return Features(*found, needs_tables=not is_computed)


def measured_axes(board: Board) -> Array:
    """1 for each axis that the board measures, else 0, (6,): a gel without markers tells no shear."""
    return np.array([float(name not in board.board.not_measured) for name in WRENCH_NAMES])


def read_feature_runs(paths: list[Path], board: Board, *, progress: Progress = lambda _: None) -> list[FeatureRun]:
    """Every run of the files and folders.

    Raises
    ------
    InputError
        Nothing to read, another board's log, or a reference that does not fit its frames.
    """
    features_of(board)
    sources = [run for path in paths for run in _runs_below(path)]
    out: list[FeatureRun] = []
    for i, source in enumerate(sources):
        if source.is_file() and source.suffix == ".csv":
            out += _of_csv(source, board)
        else:
            out += (
                _of_log(source, board) if source.is_file() and source.suffix == ".h5" else [_of_frames(source, board)]
            )
        progress((i + 1) / len(sources))
    return out


def _runs_below(path: Path) -> list[Path]:
    if not path.is_dir() or (path / "frames").is_dir() or (path / "wrench.csv").is_file():
        return [path]
    runs = sorted({folder.parent for folder in path.glob("**/frames")})
    if not runs:
        raise InputError(
            f"{path} holds no recording: give frames with wrench.csv, videos with --only wrench --videos FILE, or runs "
            "of ruffini reproduce --only recordings"
        )
    return runs


def check_tell_features(path: Path, board: Board) -> None:
    """Raises InputError if pictures do not tell the board's features without a calibration of their unit."""
    features = features_of(board)
    if features.needs_tables:
        raise InputError(
            f"{path}: board {board.name!r} makes its features of {features.sort}, which pictures without a calibration "
            "of their unit do not tell: give a log of ruffini cal collect"
        )


def _of_frames(path: Path, board: Board) -> FeatureRun:
    check_tell_features(path, board)
    rig = path / "rig.npz"
    wrench = np.load(readable(rig))["force"] if rig.is_file() else reference_wrench(path, None)
    frames = read_frames(path)
    if len(frames) != len(wrench):
        raise InputError(f"{path} has {len(frames)} frames, the reference {len(wrench)} rows: one row a frame")
    rows, good, kept = [], [], list[int]()
    with Pipeline(board) as pipeline:
        for i, image in enumerate(frames):
            frame = pipeline.process(image)
            if frame.has_reference:
                kept.append(i)
                rows.append(pipeline.features())
                good.append(not frame.flags & LOST_OR_DARK)
    if not any(good):
        raise InputError(f"{path}: all frames lack targets or markers, are dark or overexposed: is it this board?")
    period_s = 1000.0 / board.camera.rate_mhz
    return FeatureRun(
        f"{path.parent.name}/{path.name}", np.array(kept) * period_s, np.array(rows, dtype=np.float64), np.array(good),
        np.arange(len(wrench), dtype=np.float64) * period_s,
        (wrench - zero_of(wrench[: kept[0]])) * measured_axes(board),
        _degrees_of_frames(path, board, kept),
    )  # fmt: skip


def zero_of(at_rest: Array) -> Array:
    """What a reference reads (6,) while rest is learned, (t, 6): where it is more than its noise there, else 0."""
    if len(at_rest) < LEAST_REST:
        return np.zeros(6)
    mean, noise = at_rest.mean(axis=0), at_rest.std(axis=0, ddof=1) / np.sqrt(len(at_rest))
    return np.asarray(np.where(np.abs(mean) > ZERO_SIGMAS * noise, mean, 0.0))


def _degrees_of_frames(path: Path, board: Board, kept: list[int]) -> Degrees | None:
    """Of the kept frames: of a bench's readings, or of the column `celsius` of wrench.csv."""
    rig = path / "rig.npz"
    celsius = np.load(readable(rig)).get("celsius") if rig.is_file() else celsius_of_csv(path / "wrench.csv")
    if celsius is None or board.temperature is None:
        return None
    return Degrees(celsius[kept], np.full(len(kept), celsius[max(kept[0] - 1, 0)]))


def _of_csv(path: Path, board: Board) -> list[FeatureRun]:
    log = read_plain_log(path)
    check_number(path, len(log.names), board)
    return [on_board(run, board) for run in log.runs]


def check_number(path: Path, n: int, board: Board) -> None:
    """Raises InputError if a log's rows have another number of features than the board's."""
    features = features_of(board)
    if features.n != n:
        raise InputError(
            f"{path}: has {n} features, board {board.name!r} makes {features.n} of its {features.sort}: another "
            "sensor, or leave --board out"
        )


def on_board(run: FeatureRun, board: Board) -> FeatureRun:
    """A run of a log from elsewhere with zero for what the board does not measure.

    Raises
    ------
    InputError
        Features beyond a board's integers.
    """
    if np.abs(run.features).max(initial=0.0) > MOST_RAW:
        raise InputError(f"{run.name}: features beyond {MOST_RAW:g} steps of board {board.name!r}: check --unit")
    reference = run.reference * measured_axes(board)
    return replace(run, reference=reference)


def _of_log(path: Path, board: Board) -> list[FeatureRun]:
    log = read_log(path)
    if log.facts.get("board") != board.name:
        raise InputError(f"{path} was collected on board {log.facts.get('board')!r}, not {board.name!r}")
    wanted = features_of(board)
    out, rest_celsius = [], dict[str, float]()
    for number, touch in enumerate(log.touches):
        found = _rows_of(log, touch, wanted.sort)
        if found is None:
            continue
        time_s, rows = found
        if rows.shape[1] != wanted.n:
            raise InputError(f"{path}, touch {number}: {rows.shape[1]} numbers of {wanted.sort} a frame, the board has "
                             f"{wanted.n}")  # fmt: skip
        celsius = _celsius_of_touch(touch, board)
        at_rest = rest_celsius.setdefault(str(touch.facts.get("session")), celsius)
        time_s = time_s + float(np.median(on_reference_clock(log, touch) - touch.arrays["stream_s"]))
        reference_s = touch.arrays["reference_s"]
        reference = np.nan_to_num(reference_in_pad(log, touch)) * measured_axes(board)
        if log.found.get("reference", {}).get("name") == PLACED:
            time_s, rows, reference = _placed(touch, time_s, rows, reference)
            reference_s = time_s
        kind = _kind_of({**log.facts, **touch.facts})
        out.append(FeatureRun(f"{path.name}/{number}", time_s, rows, np.asarray(np.isfinite(rows).all(axis=1)),
                              reference_s, reference, Degrees(np.full(len(rows), celsius), np.full(len(rows), at_rest)),
                              np.full(len(rows), number), f"{path}/{touch.facts.get('session', '')}",
                              kind))  # fmt: skip
    if not out:
        kept = f"features of its {wanted.sort}" if wanted.is_of_gel else f"{wanted.sort} in pixels"
        if wanted.needs_tables:
            raise InputError(f"{path} holds no {kept}, which a unit sends once it is calibrated: collect it again")
        raise InputError(f"{path} holds no {kept}: give recordings of frames instead, or collect it again")
    return out


def _kind_of(facts: Mapping[str, Any]) -> str:
    """What pressed: the tip that the log names. All logs that name none may have been pressed with the same thing."""
    tip = facts.get("tip")
    return json.dumps(tip, sort_keys=True) if tip else UNNAMED


def _rows_of(log: Log, touch: TouchRecord, sort: str) -> tuple[Array, Array] | None:
    """The sensor's times (t,) and the features (t, n) in the board's integers; None where a touch has none."""
    if sort not in STEPS:
        rows = touch.arrays.get("feature")
        return None if rows is None else (touch.arrays["feature_s"], rows.astype(np.float64))
    moved, columns = touch.arrays.get("marker_displacement"), STEPS[sort]
    if moved is None or log.facts.get("marker_unit", "px") != "px" or moved.shape[2] != len(columns):
        return None
    return touch.arrays["marker_s"], (moved.astype(np.float64) * columns).reshape(len(moved), -1)


def _placed(touch: TouchRecord, time_s: Array, rows: Array, reference: Array) -> tuple[Array, Array, Array]:
    """Times, features and wrench of a weight that a person placed or read off a scale: at rest, and over the hold.

    That number is right while it is held and says nothing of the way there, so that all of a hold are one row.
    """
    held = is_held(time_s, touch.facts)
    load = np.median(reference[is_held(touch.arrays["reference_s"], touch.facts)], axis=0)
    if not held.any():
        return time_s[:1], rows[:1], np.zeros((1, 6))
    return (
        np.array([time_s[0], time_s[held].mean()]), np.stack([rows[0], rows[held].mean(axis=0)]),
        np.stack([np.zeros(6), load]),
    )  # fmt: skip


def _celsius_of_touch(touch: TouchRecord, board: Board) -> float:
    """By the board's thermometer; NaN: not measured. A session's rest is as warm as its first touch."""
    place = board.temperature.place if board.temperature else ""
    return float(touch.facts.get(CELSIUS, {}).get(place, np.nan))
