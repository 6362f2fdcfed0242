"""Presses of a log whose indenters were changed: what `cal fit --only contact` fits, with a bench's knowledge alone.

The sensor's side is its own stream: shifts of the patches in thousandths of a pixel. How deep the gel is nobody
measures; `Press.known_gel_mm` has it from travel, force and what the indenter is.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.contact_model.flow import center_of, fall_of, flow_um
from ruffini.estimators.contact_model.log import HERTZIAN, LEAST_STEP_MM, LOST_OR_DARK, Press
from ruffini.estimators.contact_model.profile import radial_um
from ruffini.rig.found import on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, TouchRecord, read_log

Array = npt.NDArray[np.float64]

LEAST_FRAMES = 3
STEP_MM = 1.5 * LEAST_STEP_MM
FELT_N, RISING_PART = 0.15, 0.5  # of a press: where its force tells where it began, up to a part of the largest


def presses_of_log(path: Path, board: Board) -> list[Press]:
    """Every press of an indenter that is known.

    Raises
    ------
    InputError
        Another board's log, or none of its touches has an indenter and the patches' shifts.
    """
    log = read_log(path)
    if log.facts.get("board") != board.name:
        raise InputError(f"{path} was collected on board {log.facts.get('board')!r}, not {board.name!r}")
    found = [_press(board, f"{path.name}/{i}", log, touch) for i, touch in enumerate(log.touches)]
    presses = [press for press in found if press is not None]
    if not presses:
        raise InputError(f"{path}: no touch has both an indenter of known shape and hardness and the patches' shifts: "
                         "collect it with `ruffini cal auto`")  # fmt: skip
    return presses


def _press(board: Board, name: str, log: Log, touch: TouchRecord) -> Press | None:
    a, tool = touch.arrays, touch.facts.get("tool")
    if tool is None or "marker_displacement" not in a:
        return None
    offset_s = float(np.median(on_reference_clock(log, touch) - a["stream_s"]))
    when_s = a["marker_s"] + offset_s
    travel_mm = 1e3 * (touch.facts["contact_z_m"] - np.interp(when_s, a["stage_s"], a["stage_place"][:, 2]))
    force = np.stack([np.interp(when_s, a["reference_s"], column) for column in reference_in_pad(log, touch).T], axis=1)
    goes_down = when_s <= a["stage_s"][-1]
    travel_mm = travel_mm + felt_after_mm(str(tool["shape"]), travel_mm[goes_down], force[goes_down, 2])
    is_pressed = goes_down & _goes_on(travel_mm)
    if is_pressed.sum() < LEAST_FRAMES:
        return None
    flow = a["marker_displacement"][is_pressed].astype(np.float64).reshape(int(is_pressed.sum()), -1)
    falls = np.array([fall_of(board, flow_um(board, row)) for row in flow])
    center = np.array([center_of(board, fall) for fall in falls])
    radial = np.round(radial_um(board, flow, center) * 16).astype(np.int64)
    size = np.sqrt((radial**2).sum(axis=1)).astype(np.int64)
    fall = np.maximum(np.round(65536 * falls.max(axis=(1, 2))), 0).astype(np.int64)
    at = np.searchsorted(a["stream_s"], a["marker_s"][is_pressed]).clip(0, len(a["stream_s"]) - 1)
    is_good = (a["stream_flags"][at] & LOST_OR_DARK) == 0
    nothing = np.full(len(flow), np.nan)
    return Press(name, str(touch.facts.get("session", "")), str(tool["shape"]), 1e3 * float(tool["radius_m"]),
                 float(tool["shore_a"]), flow, radial, size, fall, center, np.asarray(is_good),
                 np.nan_to_num(force[is_pressed]),
                 travel_mm[is_pressed], nothing, nothing)  # fmt: skip


def _goes_on(travel_mm: Array) -> npt.NDArray[np.bool_]:
    """Frames of a press that are each deeper than the one before: a stage stands still between its steps."""
    out, deepest = np.zeros(len(travel_mm), np.bool_), 0.0
    for i, travel in enumerate(travel_mm):
        out[i] = travel > deepest + STEP_MM
        deepest = max(deepest, travel) if out[i] else deepest
    return out


def felt_after_mm(shape: str, travel_mm: Array, force_n: Array) -> float:
    """How far a press had come before the reference felt it, which takes 0.09 N: half a millimetre of a soft ball.

    The force grows with the depth under a face, with its power 3/2 under a ball (Hertz), from where it began.
    """
    power = 2 / 3 if shape in HERTZIAN else 1.0
    size = np.abs(force_n)
    used = (size > FELT_N) & (size < RISING_PART * size.max(initial=0.0))
    if used.sum() < LEAST_FRAMES or np.ptp(travel_mm[used]) <= 0:
        return 0.0
    slope, offset = np.polyfit(travel_mm[used], size[used] ** power, 1)
    return float(max(offset / slope, 0.0)) if slope > 0 else 0.0
