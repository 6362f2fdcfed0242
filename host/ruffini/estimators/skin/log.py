"""Presses on a glowing skin out of a log of `ruffini cal collect`: its pictures, and the reference's force beside each.

A log keeps one picture of the untouched skin, a few of the way down and of the hold, often of each n-th pixel only. The
skin's memory starts where the tip touched, with no load then: there a row without light is put in. Without pictures of
the way down (logs of 0.1.0) memories shorter than a hold are not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.skin.openings import Openings
from ruffini.estimators.skin.presses import TOUCHED_N, Press, Progress, ratio_of, skin_of, weighted
from ruffini.rig.found import on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, TouchRecord, read_log

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


class PicturedPress(NamedTuple):
    """One touch: pictures (t, h, w, 3), the first `n_rest` untouched; time (t,) s, force (t,) N into the skin.

    pictures : as the log keeps them, of each `step_px`-th pixel (`whole`); touched_s : when the tip touched; place (2,)
        mm of the unrolled skin.
    """

    name: str
    pictures: Picture
    step_px: int
    n_rest: int
    time_s: Array
    force_n: Array
    touched_s: float
    place_mm: Array


def read_skin_log(path: Path, board: Board) -> Log:
    """A log of this board. Raises InputError for another's, or none."""
    log = read_log(path)
    if log.facts.get("board") != board.name:
        raise InputError(f"{path} was collected on board {log.facts.get('board')!r}, not {board.name!r}")
    return log


def pictured_presses(log: Log, name: str, board: Board) -> Iterator[PicturedPress]:
    """Touches with a picture before and one while pressed, a known place, and enough force, one after the other."""
    for number, touch in enumerate(log.touches):
        a, place_mm = touch.arrays, _place_mm(touch)
        if len(a.get("image", ())) < 2 or place_mm is None:
            continue
        time_s = a["image_s"] + float(np.median(on_reference_clock(log, touch) - a["stream_s"]))
        into_n = -np.interp(time_s, a["reference_s"], reference_in_pad(log, touch)[:, 2])
        n_light = int(np.argmax(into_n > TOUCHED_N))
        if n_light < 1:  # never pressed hard enough, or before the first picture
            continue
        touched_s = float(touch.facts.get("touched_host_s", -np.inf))
        n_rest = int(np.clip((time_s < touched_s).sum(), 1, n_light)) if np.isfinite(touched_s) else n_light
        step_px = int(touch.facts.get("image_step_px", 1))
        touched_s = min(max(touched_s, time_s[n_rest - 1]), time_s[n_rest])
        yield PicturedPress(f"{name}/{number}", a["image"], step_px, n_rest, time_s, into_n, touched_s, place_mm)


def log_presses(
    log: Log, name: str, board: Board, openings: Openings, progress: Progress = lambda _: None
) -> list[Press]:
    """Light of every taxel in every picture of a log's touches.

    Raises
    ------
    InputError
        Not one touch can be used.
    """
    skin, out = skin_of(board), []
    for one in pictured_presses(log, name, board):
        wholes = (whole(picture, one.step_px, board) for picture in one.pictures)
        light = np.array([openings.light(weighted(picture, skin)) for picture in wholes])
        ratio, n = ratio_of(light, one.n_rest), one.n_rest
        rows = (one.time_s, one.force_n, ratio)
        time_s, force, ratio = (
            np.insert(column, n, value, axis=0) for column, value in zip(rows, (one.touched_s, 0.0, 0.0), strict=True)
        )
        out.append(Press(one.name, time_s, force, one.place_mm, ratio))
        progress(len(out) / len(log.touches))
    if not out:
        raise InputError(
            f"{name} holds no press that tells a skin: each needs a picture before it and one of more than "
            f"{TOUCHED_N} N, and the place of the tip"
        )
    return out


def untouched_of(log: Log, name: str, board: Board) -> Array:
    """Mean of the untouched pictures of a log, (h, w, 3): in one alone noise hides what is black.

    Raises
    ------
    InputError
        It has none.
    """
    total, n = np.zeros((board.camera.height_px, board.camera.width_px, 3)), 0
    for one in pictured_presses(log, name, board):
        for picture in one.pictures[: one.n_rest]:
            total += whole(picture, one.step_px, board)
            n += 1
    if not n:
        raise InputError(f"{name} holds no pictures of a press: collect the log again with `ruffini cal collect`")
    return total / n


def whole(picture: Picture, step_px: int, board: Board) -> Picture:
    """A picture of each `step_px`-th pixel in the camera's own grid, linear between."""
    size = (board.camera.width_px, board.camera.height_px)
    if step_px > 1:
        scale = np.array([[1 / step_px, 0, 0], [0, 1 / step_px, 0]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        picture = np.asarray(cv2.warpAffine(picture, scale, size, flags=flags, borderMode=cv2.BORDER_REPLICATE))
    if picture.shape[:2] != size[::-1]:
        raise InputError(f"a picture of the log is {picture.shape[1]} x {picture.shape[0]} px at every {step_px}. pixel"
                         f", the board's is {size[0]} x {size[1]} px")  # fmt: skip
    return picture


def _place_mm(touch: TouchRecord) -> Array | None:
    """Where the tip stood, else where it was asked for, on the unrolled skin."""
    if len(touch.arrays["stage_place"]):
        return np.asarray(touch.arrays["stage_place"][-1, :2] * 1e3)
    facts: dict[str, Any] = touch.facts
    return np.array([facts["x_m"], facts["y_m"]]) * 1e3 if {"x_m", "y_m"} <= facts.keys() else None
