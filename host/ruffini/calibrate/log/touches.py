"""Touches with a reference beside them, as the stages of a fit need them, whatever file they came in.

Two kinds of file: the log of `ruffini cal collect` (host/ruffini/rig/README.md), which holds what the sensor measured
while each touch was held, and a recording (a folder of frames with wrench.csv, or with a simulation's truth), which is
run through the board's own front end.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.log.reference import VALID, play, reference_wrench
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.material.fit import TOUCHED_N, force_size
from ruffini.files import readable
from ruffini.rig.found import on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, TouchRecord, read_log

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

NEAR_S = 0.05  # readings of the reference about a frame's time that are averaged
UNTOUCHED_N = 0.01  # of the reference: a frame of a recording in which nothing presses


@dataclass(frozen=True)
class Series:
    """One touch over time: s, what the device said and what the reference said, (t, 6) N and N m."""

    time_s: Array
    device: Array
    reference: Array


@dataclass(frozen=True)
class TouchLog:
    """Frames of held touches and untouched frames.

    displacement (t, m, 3) m at the observed nodes, wrench (t, 6) N and N m on the pad about its centre (NaN = not
    measured), touch (t,) number; rest (k, m, 3) m of untouched frames; `device` (t, 6) is what the sensor said with the
    calibration that was in force, NaN where unknown.
    """

    displacement: Array
    wrench: Array
    touch: npt.NDArray[np.int64]
    rest: Array
    device: Array
    series: list[Series] = field(default_factory=list)
    sources: dict[str, Any] = field(default_factory=dict)  # file name: SHA-256
    facts: list[dict[str, Any]] = field(default_factory=list)  # of each file: what it says of itself
    found: list[dict[str, Any]] = field(default_factory=list)
    touch_facts: list[dict[str, Any]] = field(default_factory=list)  # of each touch of the rig's logs

    @property
    def is_simulated(self) -> bool:
        """Whether a twin was pressed in some of the files."""
        return any(f.get("rig") == "sim" or f.get("simulated") for f in self.facts)

    @property
    def n_touches(self) -> int:
        """Number of touches."""
        return len(np.unique(self.touch))


def read_touch_log(
    paths: list[Path], board: Board, calibration: CalibrationFile | None, *, from_pictures: bool = False,
    progress: Progress = lambda _: None,
) -> TouchLog:  # fmt: skip
    """All touches of one unit, from one file or several.

    calibration : what turns the pictures of a recording into displacement (camera, colours); logs of the rig need none.
    from_pictures : compute a rig's log again from its pictures with `calibration`, whose colours differ.

    Raises
    ------
    InputError
        A file is neither, is of another board, holds no displacement, or a recording comes without calibration.
    """
    parts = []
    for i, path in enumerate(paths):
        if path.is_dir() or path.suffix in (".mp4", ".avi", ".mkv"):
            parts.append(_of_recording(path, board, calibration, partial(_part, progress, i, len(paths))))
        else:
            parts.append(_of_log(path, board, calibration if from_pictures else None))
        progress((i + 1) / len(paths))
    return _joined(parts)


def _part(progress: Progress, number: int, n: int, done: float) -> None:
    progress((number + done) / n)


def _joined(parts: list[TouchLog]) -> TouchLog:
    numbers, n = [], 0
    for part in parts:
        _, order = np.unique(part.touch, return_inverse=True)
        numbers.append(order + n)
        n += part.n_touches
    return TouchLog(
        np.concatenate([p.displacement for p in parts]), np.concatenate([p.wrench for p in parts]),
        np.concatenate(numbers), np.concatenate([p.rest for p in parts]), np.concatenate([p.device for p in parts]),
        [s for p in parts for s in p.series], {k: v for p in parts for k, v in p.sources.items()},
        [f for p in parts for f in p.facts], [f for p in parts for f in p.found],
        [f for p in parts for f in p.touch_facts],
    )  # fmt: skip


def _of_log(path: Path, board: Board, colours: CalibrationFile | None) -> TouchLog:
    log = read_log(path)
    if log.facts.get("board") != board.name:
        raise InputError(f"{path} was collected on board {log.facts.get('board')!r}, not {board.name!r}")
    rows, columns = board.observed
    shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
    n_nodes = shape[0] * shape[1]
    held: list[tuple[Array, Array, int, Array]] = []
    rest = [np.zeros((0, n_nodes, 3))]
    seen = None if colours is None else _in_pictures(path, log, board, colours)
    for number, touch in enumerate(log.touches):
        time_s, fields = _measured(touch) if seen is None else seen.get(number, (np.zeros(0), None))
        if fields is None:
            continue
        if fields.shape[1:] != shape:
            raise InputError(f"{path}, touch {number}: displacement at {fields.shape[1:]}, the board has {shape}")
        wrench, device = _at(log, touch, time_s)
        flat = fields.astype(np.float64).reshape(len(fields), n_nodes, 3)
        held += [(u, w, number, d) for u, w, d in zip(flat, wrench, device, strict=True)]
        if "rest_field_displacement" in touch.arrays and seen is None:
            rest.append(touch.arrays["rest_field_displacement"].astype(np.float64).reshape(-1, n_nodes, 3))
    if not held:
        raise InputError(f"{path} holds no displacement: the sensor measured none (no colours in its calibration?)")
    displacement, wrenches, numbers, devices = zip(*held, strict=True)
    return TouchLog(
        np.array(displacement), np.array(wrenches), np.array(numbers), np.concatenate(rest), np.array(devices),
        [_series(log, touch) for touch in log.touches], {path.name: file_sha256(path)}, [log.facts], [dict(log.found)],
        [touch.facts for touch in log.touches],
    )  # fmt: skip


def _measured(touch: TouchRecord) -> tuple[Array, Array | None]:
    """Times and displacement of the frames of the hold that the log keeps."""
    return touch.arrays.get("field_s", np.zeros(0)), touch.arrays.get("field_displacement")


def _in_pictures(path: Path, log: Log, board: Board, colours: CalibrationFile) -> dict[int, tuple[Array, Array | None]]:
    """Times and displacement (k, n_y, n_x, 3) m of each touch's pictures; the first of each is of the untouched pad."""
    touches = {i: t for i, t in enumerate(log.touches)
               if len(t.arrays.get("image", ())) > 1 and t.facts.get("image_step_px", 1) == 1}  # fmt: skip
    if not touches:
        raise InputError(
            f"{path} was measured with other colours and holds no whole pictures: flash these colours, collect again"
        )
    out: dict[int, tuple[Array, Array | None]] = {}
    with Pipeline(board, colours.data) as pipeline:
        for i, touch in touches.items():
            pictures, time_s = touch.arrays["image"], touch.arrays["image_s"]
            pipeline.set_rest(pictures[0])
            held = [(t, pipeline.displacement_m()) for t, picture in zip(time_s[1:], pictures[1:], strict=True)
                    if pipeline.process(picture).depth_validity == VALID]  # fmt: skip
            if held:
                out[i] = np.array([t for t, _ in held]), np.array([u for _, u in held])
    return out


def _at(log: Log, touch: TouchRecord, frame_s: Array) -> tuple[Array, Array]:
    """What reference and device said at frames of the stream, (k, 6) each: on one clock, for holds are never still."""
    a = touch.arrays
    frame = np.abs(a["stream_s"] - frame_s[:, None]).argmin(axis=1)
    reference, reference_s = _reference(log, touch), a["reference_s"]
    wrench = []
    for when in on_reference_clock(log, touch)[frame]:
        near = np.abs(reference_s - when) < NEAR_S
        wrench.append(reference[near].mean(axis=0) if near.any() else
                      np.array([np.interp(when, reference_s, column) for column in reference.T]))  # fmt: skip
    return np.array(wrench), a["stream_wrench"][frame]


def _reference(log: Log, touch: TouchRecord) -> Array:
    """The reference's wrench on the pad; without its moments where the log could not tell where it stands."""
    wrench = reference_in_pad(log, touch)
    if "why_not" in log.found.get("frame", {}):
        wrench = np.column_stack([wrench[:, :3], np.full((len(wrench), 3), np.nan)])
    return np.asarray(wrench)


def _series(log: Log, touch: TouchRecord) -> Series:
    time_s, reference = on_reference_clock(log, touch), _reference(log, touch)
    at = [np.interp(time_s, touch.arrays["reference_s"], column) for column in reference.T]
    return Series(time_s, touch.arrays["stream_wrench"], np.stack(at, axis=1))


def _of_recording(path: Path, board: Board, calibration: CalibrationFile | None, progress: Progress) -> TouchLog:
    if calibration is None:
        raise InputError(f"{path} is a recording: its pictures need a calibration with colours")
    played = play(
        board, calibration, path, None, lambda pipeline, _: pipeline.displacement_m().reshape(-1, 3),
        is_believed=lambda frame: frame.depth_validity == VALID, what="shows depth", progress=progress,
    )  # fmt: skip
    loads_n = force_size(reference_wrench(path, None))
    numbers = np.cumsum(np.diff((loads_n > TOUCHED_N).astype(int), prepend=0) == 1) - 1
    size, number = loads_n[played.frame], numbers[played.frame]
    touched, free = size > TOUCHED_N, size < UNTOUCHED_N
    unknown = np.full((int(touched.sum()), 6), np.nan)
    displacement, wrench = played.taken, played.wrench
    return TouchLog(displacement[touched], wrench[touched], number[touched], displacement[free], unknown,
                    sources={path.name: file_sha256(path)}, facts=[{"board": board.name}], found=[{}])  # fmt: skip


def file_sha256(path: Path) -> str:
    """Of a file, or of what a recording or a folder of them says beside its frames."""
    files = [path] if path.is_file() else [p for p in sorted(path.iterdir()) if p.is_file()]
    files = files or [p for p in sorted(path.rglob("*")) if p.is_file() and p.parent.name != "frames"]
    digest = hashlib.sha256()
    for file in files:
        digest.update(readable(file).read_bytes())
    return digest.hexdigest()
