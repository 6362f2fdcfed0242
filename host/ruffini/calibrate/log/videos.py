r"""Videos of a pressed gel, beside each a CSV of the same name with the readings of a load cell, one row a frame.

What the load cell reads while rest is learned, in the first frames, is its zero. A small TOML file names the columns:

    force = "force_n"                 # of the load along the pad's normal, positive where it presses
    unit = "N"
    frame = "frame"                   # optional: number of the video's frame, from 0; else a row for each frame
    recording = '(.*)_\d+'             # optional: regular expression of the video's name; those with the same first
                                      # group are of one object, and left out together; else each video is alone
    largest_jump = 10.0               # optional, in the unit, above zero: readings of neighbouring frames that differ
                                      # by more are glitches, left out
    rigid = ["steel_ball"]            # for stage softness only: rigid objects (first group of `recording`) that it is
                                      # fitted to; needs `squeeze_n`
    squeeze_n = [0.7, 3.0]            # only with `rigid`: forces between which a squeeze is judged, N
    modulus_pa = { foam = 40000 }     # optional, with `rigid`: moduli of objects over 1 - nu^2; default: the scale of
                                      # the board's pad
    like = [["foam", "hard_foam"]]    # optional, with `rigid`: objects of one shape, the softest first, whose order
                                      # judges the fit
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.wrench.log import LOST_OR_DARK, FeatureRun
from ruffini.files import readable
from ruffini.frames import read_frames
from ruffini.older_python import tomllib
from ruffini.rig.csv_log import read_table
from ruffini.rig.units import force_factor

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
SAID_ZERO = 0.01  # of the largest reading: a load cell's zero beyond it is said
MAX_NUMBER = 1e12
SUFFIXES = (".avi", ".mp4", ".mkv", ".mov")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not abs(value) >= MAX_NUMBER


def _is_jump(value: Any) -> bool:
    return _is_number(value) or value == float("inf")


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _is_range(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)) and 0 < value[0] < value[1]


_TEXT: tuple[Callable[[Any], bool], str] = (lambda value: isinstance(value, str), "text")
_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "force": _TEXT, "unit": _TEXT, "frame": _TEXT, "recording": _TEXT,
    "largest_jump": (_is_jump, "a number"),
    "rigid": (_are_names, "a list of names of objects"), "squeeze_n": (_is_range, "two rising forces above zero, N"),
    "modulus_pa": (lambda value: isinstance(value, dict) and all(_is_number(v) and v > 0 for v in value.values()),
                   "a table of moduli above zero, Pa"),
    "like": (lambda value: isinstance(value, list) and all(map(_are_names, value)), "lists of names of objects"),
}  # fmt: skip


@dataclass(frozen=True)
class VideoColumns:
    """Names of the columns; the module's docstring explains each."""

    force: str
    unit: str = "N"
    frame: str = ""
    recording: str = ""
    largest_jump: float = float("inf")
    rigid: tuple[str, ...] = ()
    squeeze_n: tuple[float, float] | None = None
    modulus_pa: dict[str, float] = field(default_factory=dict)
    like: tuple[tuple[str, ...], ...] = ()

    @classmethod
    def read(cls, path: Path) -> VideoColumns:
        """Read the mapping file; raises InputError where it is not one."""
        try:
            file = tomllib.loads(readable(path).read_text())
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        for name, value in file.items():
            if name not in _CHECKS:
                raise InputError(f"{path}: {name}: unknown; known are {', '.join(_CHECKS)}")
            is_right, what = _CHECKS[name]
            if not is_right(value):
                raise InputError(f"{path}: {name} must be {what}")
        if "force" not in file:
            raise InputError(f"{path}: force is not named: which column of the CSV files is it?")
        if "rigid" in file and "squeeze_n" not in file:
            raise InputError(f"{path}: rigid needs squeeze_n, the two forces between which a squeeze is judged")
        if doubled := [group for group in file.get("like", []) if len(set(group)) < len(group)]:
            raise InputError(f"{path}: like names an object twice in one group: {', '.join(doubled[0])}")
        if not file.get("rigid") and (without := sorted({"squeeze_n", "modulus_pa", "like"} & file.keys())):
            raise InputError(f"{path}: {without[0]} needs rigid, the names of rigid objects")
        made = cls(**{**file, "rigid": tuple(file.get("rigid", ())),
                      "squeeze_n": tuple(file["squeeze_n"]) if "squeeze_n" in file else None,
                      "like": tuple(map(tuple, file.get("like", ())))})  # fmt: skip
        if not made.largest_jump > 0:
            raise InputError(f"{path}: largest_jump must be above zero, is {made.largest_jump:g}")
        force_factor(made.unit)
        try:
            n_groups = re.compile(made.recording).groups
        except re.error as error:
            raise InputError(f"{path}: recording {made.recording!r} is no regular expression: {error}") from error
        if made.recording and n_groups < 1:
            raise InputError(f"{path}: recording {made.recording!r} has no group: put what is the object into (...)")
        return made

    def check_names(self, recorded: Iterable[str]) -> None:
        """Raises InputError where rigid, modulus_pa or like names an object of which there is no recording."""
        known = sorted(set(recorded))
        for key, names in (("rigid", self.rigid), ("modulus_pa", self.modulus_pa), ("like", sum(self.like, ()))):
            if unknown := sorted(set(names) - set(known)):
                raise InputError(f"{key}: there is no recording of {', '.join(unknown)}, only of {', '.join(known)}")


class VideoLog(NamedTuple):
    """Recordings; sentences on frames that were left out."""

    runs: list[FeatureRun]
    remarks: list[str]


class Readings(NamedTuple):
    """Force of each frame (t,), N, and whether it is used; frames without a row are not."""

    force: Array
    is_used: npt.NDArray[np.bool_]


class Videos(NamedTuple):
    """Those with a CSV beside them, and those without one."""

    read: list[Path]
    without_csv: list[Path]


def videos_in(paths: list[Path]) -> Videos:
    """The videos of folders, by name, and those that are given.

    Raises
    ------
    InputError
        A path that is not there or that holds no video with a CSV, or two videos of one name.
    """
    videos = Videos([], [])
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: there is no such file or folder: give a video, or a folder of videos")
        found = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        beside = [video for video in found if video.with_suffix(".csv").is_file()]
        if not beside:
            raise InputError(f"{path}: {'holds' if path.is_dir() else 'is'} no video with a CSV file of the same name "
                             "beside it")  # fmt: skip
        videos.read.extend(beside)
        videos.without_csv.extend(video for video in found if video not in beside)
    by_name = dict[str, Path]()
    for video in videos.read:
        if (other := by_name.setdefault(video.stem, video)) is not video:
            raise InputError(f"{video}: {other} has the same name, and recordings are told apart by name: rename one")
    return videos


def recording_of(video: Path, columns: VideoColumns) -> str:
    """Name of the object in a video.

    Raises
    ------
    InputError
        The expression does not match the name.
    """
    if not columns.recording:
        return video.stem
    match = re.fullmatch(columns.recording, video.stem)
    if match is None:
        raise InputError(f"{video}: its name does not match recording {columns.recording!r} of the mapping file")
    return match[1]


def readings_of(video: Path, columns: VideoColumns, n_frames: int) -> Readings:
    """The load cell's readings beside a video, whose rows may be in any order where they are numbered.

    Raises
    ------
    InputError
        A column or every row is missing, or a row is of no frame of the video.
    """
    path = video.with_suffix(".csv")
    table = read_table(path, {name: name for name in (columns.force, columns.frame) if name})
    force = table.column(columns.force) * force_factor(columns.unit)
    if not len(force):
        raise InputError(f"{path}: has a header and no rows: write the load cell's readings into it")
    if columns.frame:
        number = table.column(columns.frame)
    elif len(force) == n_frames:
        number = np.arange(float(n_frames))
    else:
        raise InputError(
            f"{path}: has {len(force)} rows, the video {n_frames} frames: name the column of the frame's number"
        )
    if not np.isin(number, np.arange(n_frames)).all() or len(np.unique(number)) < len(number):
        raise InputError(f"{path}: {columns.frame}: numbers must be whole, 0 to {n_frames - 1}, each once")
    order = np.argsort(number)
    frame, force = number[order].astype(np.intp), force[order]
    jumps = np.abs(np.diff(force)) > columns.largest_jump * force_factor(columns.unit)
    is_glitch = np.concatenate([jumps, [False]]) | np.concatenate([[False], jumps])
    out = Readings(np.zeros(n_frames), np.zeros(n_frames, bool))
    out.force[frame], out.is_used[frame] = force, ~is_glitch
    return out


def read_video_log(
    paths: list[Path], board: Board, columns: VideoColumns, *, progress: Progress = lambda _: None
) -> VideoLog:
    """The features of every video, in the core's integers, and the force beside them.

    Raises
    ------
    InputError
        Nothing to read, a video of another size, or readings that do not fit their frames.
    """
    runs, remarks = list[FeatureRun](), list[str]()
    videos, without_csv = videos_in(paths)
    remarks += [f"{video.name}: left out, no {video.stem}.csv is beside it" for video in without_csv]
    for i, video in enumerate(videos):
        features, n_frames = _features(video, board)
        readings = readings_of(video, columns, n_frames)
        used = [k for k in features if readings.is_used[k]]
        if not used:
            raise InputError(f"{video}: no frame after the rest has a reading: is it this board?")
        left_out = np.flatnonzero(~readings.is_used)
        if len(left_out):
            remarks.append(f"{video.name}: frames left out, their readings jump or are missing: "
                           f"{', '.join(map(str, left_out))}")  # fmt: skip
        zero = zero_of_rest(readings, min(features))
        if abs(zero) > SAID_ZERO * np.abs(readings.force[used]).max():
            remarks.append(f"{video.name}: the load cell read {zero:.2f} N while rest was learned: "
                           "taken off as its zero")  # fmt: skip
        time_s = np.array(used) * (1000.0 / board.camera.rate_mhz)
        wrench = np.zeros((len(used), 6))
        wrench[:, 2] = zero - readings.force[used]
        rows = np.array([features[k] for k in used])
        object_name = recording_of(video, columns)
        runs.append(FeatureRun(video.stem, time_s, rows, np.ones(len(used), bool), time_s, wrench,
                               recording=object_name, kind=object_name))  # fmt: skip
        progress((i + 1) / len(videos))
    return VideoLog(runs, remarks)


def zero_of_rest(readings: Readings, n_rest: int) -> float:
    """What the load cell read in the frames in which rest was learned, N."""
    at_rest = readings.force[:n_rest][readings.is_used[:n_rest]]
    return float(np.median(at_rest)) if len(at_rest) else 0.0


def _features(video: Path, board: Board) -> tuple[dict[int, Array], int]:
    """Of each good frame after the rest, by its number; and how many frames there are, whatever the file states."""
    features, n_frames = dict[int, Array](), 0
    with Pipeline(board) as pipeline:
        for image in read_frames(video):
            frame = pipeline.process(image)
            if frame.has_reference and not frame.flags & LOST_OR_DARK:
                features[n_frames] = pipeline.features().astype(np.float64)
            n_frames += 1
    return features, n_frames
