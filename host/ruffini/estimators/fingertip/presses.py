"""Presses on a fingertip, as the host reads them: what its pins did, and what the bench knew.

A folder holds a folder for each press, at any depth, each with `frames/` and either

    press.csv   a row for each frame: force_n along the tool's axis, way_mm since it touched, x_mm and y_mm of that axis
                from the fingertip's in the tool's axes, roll_deg and pitch_deg of the fingertip under it, area_mm2 of
                its face; empty where nothing touches
    rig.npz     with run.json, as the twin's benches write them (`ruffini reproduce --only recordings`)
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.skin.presses import press_folders
from ruffini.files import readable
from ruffini.frames import Frames

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

COLUMNS = ("force_n", "way_mm", "x_mm", "y_mm", "roll_deg", "pitch_deg", "area_mm2")
FORCE, WAY, X, Y, ROLL, PITCH, AREA = range(7)
# Area of a tool's flat face over the square of half its width (triangle: half a side), as the twin's benches name them.
FACES = {"flat": np.pi, "square": 4.0, "hexagon": 2 * 3**0.5, "triangle": 3**0.5, "ring": 0.64 * np.pi}


@dataclass(frozen=True)
class Press:
    """One press. rest (2, n, 2) px and moved (t, 2, n, 2) px of all frames after rest was learned; told (t, 7) COLUMNS,
    NaN where nothing touches. name : its folder; tool : its shape, where it is known.
    """

    name: str
    tool: str
    rest: Array
    moved: Array
    told: Array


def axes(roll_rad: float, pitch_rad: float) -> Array:
    """The tool's axes in the fingertip's frame, as columns: rolled about x, then pitched about y."""
    (cr, sr), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (roll_rad, pitch_rad))
    return np.array([[cp, sp * sr, sp * cr], [0, cr, -sr], [-sp, cp * sr, cp * cr]])


def face_area(shape: str, radius_mm: float) -> float:
    """mm^2 of a flat face; NaN of another tool."""
    return FACES.get(shape, float("nan")) * radius_mm**2


def told_of(folder: Path, n_frames: int) -> tuple[str, Array]:
    """The tool's shape and what the bench knew of each frame, (t, 7).

    Raises
    ------
    InputError
        A file is not as it should be.
    """
    if (folder / "press.csv").is_file():
        with readable(folder / "press.csv").open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        try:
            told = np.array([[float(row[c] or "nan") for c in COLUMNS] for row in rows])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{folder / 'press.csv'} needs the columns {', '.join(COLUMNS)} ({error})") from error
        if len(told) != n_frames:
            raise InputError(f"{folder / 'press.csv'} has {len(told)} rows for {n_frames} frames")
        return "", told
    chosen = json.loads(readable(folder / "run.json").read_text("utf-8"))["chosen"]
    with np.load(readable(folder / "rig.npz"), allow_pickle=False) as file:
        force, way = np.asarray(file["force"], dtype=float)[:, :3], np.asarray(file["depth_m"], dtype=float) * 1e3
        place = np.asarray(file["place_m"], dtype=float) * 1e3
    roll, pitch = (1e-3 * float(a) for a in chosen.get("tilt_mrad", (0, 0)))
    told = np.full((len(way), 7), np.nan)
    told[:, FORCE], told[:, WAY] = -force @ axes(roll, pitch)[:, 2], way
    told[:, [X, Y]], told[:, [ROLL, PITCH]] = place, np.rad2deg([roll, pitch])
    told[:, AREA] = face_area(str(chosen["indenter"]), float(chosen["radius_um"]) * 1e-3)
    told[~np.isfinite(way)] = np.nan
    return str(chosen["indenter"]), told


def read_press(board: Board, folder: Path) -> Press:
    """Follow the pins of one press. Raises InputError where a file is not as it should be."""
    frames = Frames(folder / "frames")
    tool, told = told_of(folder, len(frames))
    rest, moved = np.zeros(0), []
    with Pipeline(board) as path:  # nothing is calibrated: pins are followed
        for picture in frames:
            if not path.process(picture).has_reference:
                continue
            rest, shift, _ = path.markers()
            moved.append(shift)
    return Press(str(folder), tool, rest, np.array(moved), told[len(told) - len(moved) :])


def read_presses(board: Board, root: Path, only: str, progress: Progress) -> list[Press]:
    """All presses below a folder, or below those in it that `only` names. Raises InputError."""
    folders, out = press_folders(root, only), []
    for done, folder in enumerate(folders, 1):
        out.append(read_press(board, folder))
        progress(done / len(folders))
    return out
