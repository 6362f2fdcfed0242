"""Videos of a pressed gel, beside each a CSV of the same name with the readings of a load cell, one row a frame.

A small TOML file names the columns:

    force = "force_n"                 # of the load along the pad's normal, positive where it presses
    unit = "N"
    frame = "frame"                   # optional: number of the video's frame, from 0; else a row for each frame
    recording = '(.*)_\\d+'            # optional: regular expression of the video's name; those with the same first
                                      # group are of one object, and left out together; else each video is alone
    largest_jump = 10.0               # optional, in the unit: neighbours that differ by more are glitches, left out
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.wrench.log import LOST_OR_DARK, FeatureRun
from ruffini.files import readable
from ruffini.frames import read_frames
from ruffini.rig.csv_log import read_table
from ruffini.rig.units import force_factor

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
SUFFIXES = (".avi", ".mp4", ".mkv", ".mov")


@dataclass(frozen=True)
class VideoColumns:
    """Names of the columns; the module's docstring explains each."""

    force: str
    unit: str = "N"
    frame: str = ""
    recording: str = ""
    largest_jump: float = float("inf")

    @classmethod
    def read(cls, path: Path) -> VideoColumns:
        """Read the mapping file; raises InputError where it is not one."""
        try:
            file = tomllib.loads(readable(path).read_text())
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        known = {f.name: float if f.name == "largest_jump" else str for f in fields(cls)}
        for name, value in file.items():
            if name not in known:
                raise InputError(f"{path}: {name}: unknown; known are {', '.join(known)}")
            if not isinstance(value, (int, float) if known[name] is float else str) or isinstance(value, bool):
                raise InputError(f"{path}: {name} must be {'a number' if known[name] is float else 'text'}")
        if "force" not in file:
            raise InputError(f"{path}: force is not named: which column of the CSV files is it?")
        made = cls(**file)
        force_factor(made.unit)
        try:
            n_groups = re.compile(made.recording).groups
        except re.error as error:
            raise InputError(f"{path}: recording {made.recording!r} is no regular expression: {error}") from error
        if made.recording and n_groups < 1:
            raise InputError(f"{path}: recording {made.recording!r} has no group: put what is the object into (...)")
        return made


class VideoLog(NamedTuple):
    """Recordings; sentences on frames that were left out."""

    runs: list[FeatureRun]
    remarks: list[str]


class Readings(NamedTuple):
    """Force of each frame (t,), N, and whether it is used; frames without a row are not."""

    force: Array
    is_used: npt.NDArray[np.bool_]


def videos_in(path: Path) -> list[Path]:
    """The videos of a folder that have a CSV beside them, by name, or the one that is given.

    Raises
    ------
    InputError
        There is none.
    """
    found = sorted(p for p in path.iterdir() if p.suffix in SUFFIXES) if path.is_dir() else [path]
    found = [video for video in found if video.with_suffix(".csv").is_file()]
    if not found:
        raise InputError(f"{path}: holds no video with a CSV file of the same name beside it")
    return found


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
    """The load cell's readings beside a video.

    Raises
    ------
    InputError
        A column is missing, or a row is of no frame of the video.
    """
    path = video.with_suffix(".csv")
    table = read_table(path, {name: name for name in (columns.force, columns.frame) if name})
    force = table.column(columns.force) * force_factor(columns.unit)
    if columns.frame:
        frame = table.column(columns.frame).astype(np.intp)
    elif len(force) == n_frames:
        frame = np.arange(n_frames)
    else:
        raise InputError(
            f"{path}: has {len(force)} rows, the video {n_frames} frames: name the column of the frame's number"
        )
    if len(np.unique(frame)) < len(frame) or frame.min() < 0 or frame.max() >= n_frames:
        raise InputError(f"{path}: {columns.frame}: numbers must be 0 to {n_frames - 1}, each once")
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
    videos = [video for path in paths for video in videos_in(path)]
    for i, video in enumerate(videos):
        frames = read_frames(video)
        readings = readings_of(video, columns, len(frames))
        rows, used = list[Array](), list[int]()
        with Pipeline(board) as pipeline:
            for k, image in enumerate(frames):
                frame = pipeline.process(image)
                if frame.has_reference and readings.is_used[k] and not frame.flags & LOST_OR_DARK:
                    rows.append(pipeline.features().astype(np.float64))
                    used.append(k)
        if not rows:
            raise InputError(f"{video}: no frame after the rest has a reading: is it this board?")
        left_out = np.flatnonzero(~readings.is_used)
        if len(left_out):
            remarks.append(f"{video.name}: frames left out, their readings jump or are missing: "
                           f"{', '.join(map(str, left_out))}")  # fmt: skip
        time_s = np.array(used) * (1000.0 / board.camera.rate_mhz)
        wrench = np.zeros((len(used), 6))
        wrench[:, 2] = -readings.force[used]
        runs.append(FeatureRun(video.stem, time_s, np.array(rows), np.ones(len(used), bool), time_s, wrench,
                               recording=recording_of(video, columns)))  # fmt: skip
        progress((i + 1) / len(videos))
    return VideoLog(runs, remarks)
