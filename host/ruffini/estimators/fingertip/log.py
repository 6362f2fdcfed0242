"""Presses on a fingertip out of a log of `ruffini cal collect`, as the folders of presses that a fit takes.

A log keeps a picture at every stop of the way down. The sensor learns its rest from more untouched pictures than one
touch has: those of the touches next to it in time stand in.
"""

from __future__ import annotations

import contextlib
import csv
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.fingertip.presses import COLUMNS, face_area
from ruffini.rig.found import on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, TouchRecord, read_log

Array = npt.NDArray[np.float64]
Pictures = npt.NDArray[np.uint8]

MORE_REST = 2  # than the sensor learns from
FELT_N = 0.03  # surely a touch


@contextlib.contextmanager
def press_roots(paths: list[Path], board: Board) -> Iterator[list[Path]]:
    """Folders of presses: those of `paths`, and for each log one that is there inside this context.

    Raises
    ------
    InputError
        Another board's log, or one without pictures of the way down.
    """
    with tempfile.TemporaryDirectory(prefix="ruffini-") as folder:
        roots = []
        for number, path in enumerate(paths):
            if path.suffix == ".h5":
                root = Path(folder) / f"{number}-{path.stem}"
                unpack(path, board, root)
                roots.append(root)
            else:
                roots.append(path)
        yield roots


def unpack(path: Path, board: Board, root: Path) -> None:
    """Write the presses of a log as folders with `frames/` and `press.csv`; raises as `press_roots`."""
    log = read_log(path)
    if log.facts.get("board") != board.name:
        raise InputError(f"{path} was collected on board {log.facts.get('board')!r}, not {board.name!r}")
    pressed = [touch for touch in log.touches if touch.facts.get("is_pictured") and "image" in touch.arrays]
    if not pressed:
        raise InputError(f"{path}: no press of a known tool has pictures of its way down: collect it with "
                         "`ruffini cal collect --program indenters`")  # fmt: skip
    if any(touch.facts["image_step_px"] > 1 for touch in pressed):
        raise InputError(f"{path}: its pictures are of each n-th pixel, too few to follow pins")
    free = [touch.arrays["image"][_when(log, touch) < touch.facts["touched_host_s"]] for touch in pressed]
    rest, n_rest = np.concatenate(free), board.pipeline.n_rest_frames + MORE_REST
    if not len(rest):
        raise InputError(f"{path}: it has no picture of the untouched fingertip")
    ends = np.cumsum([len(pictures) for pictures in free])
    for number, touch in enumerate(pressed):
        first = max(int(ends[number]) - n_rest, 0)
        chosen, told = _stops(log, touch)
        _write(root / f"{number:05d}", rest[(first + np.arange(n_rest)) % len(rest)], chosen, told)


def _when(log: Log, touch: TouchRecord) -> Array:
    """Of each picture, on the reference's clock."""
    return touch.arrays["image_s"] + float(np.median(on_reference_clock(log, touch) - touch.arrays["stream_s"]))


def _stops(log: Log, touch: TouchRecord) -> tuple[Pictures, Array]:
    """The last picture of each stop of the way down, and what the bench knew of it, (t, 7)."""
    a, tool = touch.arrays, touch.facts["tool"]
    when, came_s, left_s = _when(log, touch), a["stage_s"][:-1], a["stage_s"][1:]
    stands = (np.diff(a["stage_place"], axis=0) == 0).all(axis=1)
    last = [np.flatnonzero((when > s) & (when < e)) for s, e in zip(came_s[stands], left_s[stands], strict=True)]
    at = np.array([i[-1] for i in last if len(i)], int)
    force = np.interp(when[at], a["reference_s"], -reference_in_pad(log, touch)[:, 2])
    x_mm, y_mm, z_mm = (1e3 * np.interp(when[at], a["stage_s"], column) for column in a["stage_place"].T)
    approach_m, approach_n = np.array(touch.facts["way_down"][:-1]).reshape(-1, 2).T
    way = touched_mm(np.append(1e3 * approach_m, z_mm), np.append(approach_n, force)) - z_mm
    roll_deg, pitch_deg = touch.facts["tilt_deg"]
    area = face_area(str(tool["shape"]), 1e3 * float(tool["radius_m"]))
    told = np.column_stack([force, way, x_mm, y_mm, np.tile([roll_deg, pitch_deg, area], (len(at), 1))])
    return a["image"][at], told


def touched_mm(z_mm: Array, force_n: Array) -> float:
    """Height at which a press began, from those of its stops: a shell's first force grows with its dent.

    A stop that is surely felt and the one after it tell it; a press that has none began at its first stop.
    """
    i = int(np.argmax(force_n > FELT_N))
    if force_n[i] <= FELT_N or i + 1 == len(z_mm) or force_n[i + 1] <= force_n[i]:
        return float(z_mm[i])
    return float(z_mm[i] + force_n[i] * (z_mm[i] - z_mm[i + 1]) / (force_n[i + 1] - force_n[i]))


def _write(folder: Path, untouched: Pictures, pressed: Pictures, told: Array) -> None:
    (folder / "frames").mkdir(parents=True)
    for number, picture in enumerate([*untouched, *pressed]):
        cv2.imwrite(str(folder / "frames" / f"{number:05d}.png"), picture)
    with (folder / "press.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        rows.writerows([[""] * len(COLUMNS)] * len(untouched) + told.tolist())
