"""Presses on a glowing skin with a load cell beside them: brightness of its taxels, frame by frame.

A folder holds a folder for each press, at any depth, each with `frames/` and either

    press.csv   a row for each frame: time_s, force_n into the skin (along its normal), x_mm, y_mm of the unrolled skin
    rig.npz     as the twin's benches write it (`ruffini reproduce --only recordings`): force (t, 6) N, place_m (2,)
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, Skin
from ruffini.errors import InputError
from ruffini.estimators.skin.openings import Openings
from ruffini.files import readable
from ruffini.frames import Frames
from ruffini.older_python import tomllib

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Progress = Callable[[float], None]

TOUCHED_N = 0.3  # of the reference: above it something presses
COLUMNS = ("time_s", "force_n", "x_mm", "y_mm")


@dataclass(frozen=True)
class Press:
    """One press: time (t,) s, force (t,) N into the skin, place (2,) mm.

    ratio : (t, n) light of each taxel over rest, less 1; what all of them have in common is taken off, as the firmware
    does. name : its folder.
    """

    name: str
    time_s: Array
    force_n: Array
    place_mm: Array
    ratio: Array


def skin_of(board: Board) -> Skin:
    """The board's [skin]. Raises InputError where it has none."""
    if board.skin is None or board.markers is None:
        raise InputError(f"board {board.name!r} has no glowing skin: board.toml needs [skin] and [markers]")
    return board.skin


def weighted(picture: npt.NDArray[np.generic], skin: Skin) -> Array:
    """The weighted sum of a picture's channels, (h, w)."""
    return np.asarray(picture.astype(np.float64) @ np.array(skin.weights, dtype=float))


def press_folders(root: Path, only: str = "*") -> list[Path]:
    """Folders of presses below `root`, or below those in it that `only` names, in order. Raises InputError for none."""
    tops = [root] if only == "*" else sorted(root.glob(only))
    found = sorted(p.parent for top in tops for p in top.rglob("frames") if p.is_dir())
    found = [p for p in found if (p / "press.csv").is_file() or (p / "rig.npz").is_file()]
    if not found:
        raise InputError(f"{root} holds no press: each is a folder with frames/ and press.csv")
    return found


def reference_of(folder: Path, board: Board) -> tuple[Array, Array, Array]:
    """Time (t,) s, force (t,) N into the skin, place (2,) mm of a press.

    Raises
    ------
    InputError
        The file is not as it should be, or nothing touches.
    """
    if (folder / "press.csv").is_file():
        with readable(folder / "press.csv").open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        try:
            time_s, force, x, y = (np.array([float(row[c] or "nan") for row in rows]) for c in COLUMNS)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{folder / 'press.csv'} needs the columns {', '.join(COLUMNS)} ({error})") from error
        if not (force > TOUCHED_N).any():
            raise InputError(f"{folder / 'press.csv'}: no frame is pressed with more than {TOUCHED_N} N")
        held = force > TOUCHED_N
        return time_s, force, np.array([np.nanmean(x[held]), np.nanmean(y[held])])
    skin = skin_of(board)
    with np.load(readable(folder / "rig.npz"), allow_pickle=False) as file:
        wrench, place = np.asarray(file["force"], dtype=float), np.asarray(file["place_m"], dtype=float) * 1e3
    settings = tomllib.loads(readable(folder / "recording.toml").read_text("ascii"))
    time_s = np.arange(len(wrench), dtype=float) * 1e3 / float(settings["rate_mhz"])
    return time_s, inward(skin, wrench, place), place


def inward(skin: Skin, wrench: Array, place_mm: Array) -> Array:
    """Force into the skin, (t,) N, of a wrench (t, 6) in the camera's axes at a place of the unrolled skin."""
    out = out_of(skin, place_mm)
    return np.asarray(-(wrench[:, :3] @ out))


def out_of(skin: Skin, place_mm: Array) -> Array:
    """Which way is out at a place of the unrolled skin, (3,), as firmware/stages/skin/skin_shape.h has it."""
    if skin.shape == "plane":
        return np.array([0.0, 0.0, 1.0])
    if skin.shape == "tube":
        angle = place_mm[0] * 1e3 / skin.radius_um
        return np.array([np.cos(angle), np.sin(angle), 0.0])
    way = float(np.hypot(*place_mm))
    angle = way * 1e3 / skin.radius_um
    return np.array([*(place_mm / max(way, 1e-9) * np.sin(angle)), np.cos(angle)])


def read_press(folder: Path, board: Board, openings: Openings) -> Press:
    """Light of every taxel in every frame of a press, over that of the frames before the first touch.

    Raises
    ------
    InputError
        The files are not as they should be, of another length, or no untouched frame comes first.
    """
    time_s, force, place = reference_of(folder, board)
    frames = Frames(folder)
    if len(frames) != len(force):
        raise InputError(f"{folder}: {len(frames)} frames, but {len(force)} readings of the reference")
    n_rest = n_untouched(folder, board, force)
    skin = skin_of(board)
    light = np.array([openings.light(weighted(picture, skin)) for picture in frames])
    return Press(folder.name, time_s, force, place, ratio_of(light, n_rest))


def n_untouched(folder: Path, board: Board, force: Array) -> int:
    """How many first frames of a press are its rest: as many as the sensor learns from, if that many come first.

    Not all before TOUCHED_N: a skin glows long before a load cell tells a touch from its noise.

    Raises
    ------
    InputError
        None is untouched.
    """
    n_before = int(np.argmax(force > TOUCHED_N))
    if n_before < 1:
        raise InputError(f"{folder}: the first frame is pressed already: begin with untouched frames")
    return min(n_before, board.pipeline.n_rest_frames)


def ratio_of(light: Array, n_rest: int) -> Array:
    """Light (t, n) over that of the first `n_rest` frames, less 1 and less what all taxels have in common."""
    change = light / light[:n_rest].mean(axis=0) - 1
    common = np.median(change, axis=1, keepdims=True)
    return np.asarray((change - common) / (1 + common))


def read_presses(
    root: Path, board: Board, openings: Openings, progress: Progress = lambda _: None, *, only: str = "*"
) -> list[Press]:
    """All presses below a folder, or below those in it that `only` names."""
    folders, out = press_folders(root, only), []
    for done, folder in enumerate(folders, 1):
        out.append(read_press(folder, board, openings))
        progress(done / len(folders))
    return out
