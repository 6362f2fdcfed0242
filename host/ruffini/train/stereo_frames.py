"""Presses on a fingertip as the stereo paper's network reads them: its region of both views, and six labels.

Labels are in the units of the wire, so that a network says what the device sends. They are what the bench read, as
`cal fit --only fingertip` takes it (ruffini.estimators.fingertip.presses). Of the paper's seven attributes D is Z
here. Not in paper: two untouched frames of each press, of force 0 and no other label, so that a network knows when
nothing touches.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.fingertip.presses import COLUMNS, FORCE, told_of
from ruffini.estimators.skin.presses import press_folders
from ruffini.frames import Frames

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Progress = Callable[[float], None]

ROI_ROWS, ROI_COLUMNS = slice(24, 216), slice(47, 271)  # of a view, what the paper's network sees
BINARY_LEVEL = 90  # of modes 2 and 3; the paper prints none
OUTPUTS = ("force_un", "way_um", "x_um", "y_um", "roll_urad", "pitch_urad")
UNITS = np.array([1e6, 1e3, 1e3, 1e3, *2 * [np.deg2rad(1) * 1e6]])  # of tip_presses.COLUMNS in those of OUTPUTS
GREY = (0.114, 0.587, 0.299)  # of B, G, R
MOST_N = 1.05  # the paper's 1 N of the thin tip and half a step: presses go on beyond it
N_UNTOUCHED = 2


@dataclass(frozen=True)
class Samples:
    """views (k, 2, 192, 224) grey, left then right; labels (k, 6) OUTPUTS, NaN where there is none; press (k,) numbers
    the presses: frames of one press are alike and belong on one side of a split.
    """

    views: Picture
    labels: Array
    press: npt.NDArray[np.int64]

    def digest(self, told: bytes = b"") -> str:
        """SHA-256 of `told` and all of this."""
        hashed = hashlib.sha256(told)
        hashed.update(self.views.data)
        hashed.update(self.labels.data)
        return hashed.hexdigest()

    def range_of(self, least_un: float) -> Array:
        """Least and most of each label, (6, 2), the force from `least_un`: what a network was taught."""
        low, high = np.nanmin(self.labels, axis=0), np.nanmax(self.labels, axis=0)
        low[0] = least_un
        return np.stack([low, high], axis=1)


def check_board(board: Board) -> None:
    """Raises InputError where frames are not two views that hold the paper's region."""
    camera, markers = board.camera, board.markers
    has_two = markers is not None and markers.layout == "views" and markers.n_y == 2
    if not has_two or camera.height_px < ROI_ROWS.stop or camera.width_px // 2 < ROI_COLUMNS.stop:
        raise InputError(
            f"board {board.name!r} has no two views of at least {ROI_COLUMNS.stop} x {ROI_ROWS.stop} pixels "
            '([markers] layout = "views"): the paper\'s network reads such'
        )


def views_of(picture: Picture) -> Picture:
    """The paper's region of both views of a frame (h, w, 3), grey, (2, 192, 224)."""
    width = picture.shape[1] // 2
    parts = (picture[ROI_ROWS, ROI_COLUMNS], picture[ROI_ROWS, width + ROI_COLUMNS.start : width + ROI_COLUMNS.stop])
    return np.stack([np.rint(part @ np.array(GREY)).astype(np.uint8) for part in parts])


def read_samples(
    board: Board, root: Path, only: str, *, most_n: float = MOST_N, progress: Progress = lambda _: None
) -> Samples:
    """Frames of at most `most_n` of all presses below a folder, or below those in it that `only` names.

    Raises
    ------
    InputError
        A file is not as it should be, or the board has no two views.
    """
    check_board(board)
    folders = press_folders(root, only)
    views, labels, press = [], [], []
    for number, folder in enumerate(folders):
        frames = Frames(folder / "frames")
        _, told = told_of(folder, len(frames))
        first = len(frames) - len(told)
        force = told[:, FORCE]
        rest = np.flatnonzero(np.isnan(force))[-N_UNTOUCHED:]
        wanted = {int(i) for i in (*rest, *np.flatnonzero(force <= most_n))}
        for i, picture in enumerate(frames):
            if i - first not in wanted:
                continue
            label = np.full(len(OUTPUTS), np.nan) if np.isnan(force[i - first]) else told[i - first, : len(OUTPUTS)]
            label = np.where(np.arange(len(OUTPUTS)) == FORCE, np.nan_to_num(label), label)
            views.append(views_of(picture))
            labels.append(label * UNITS)
            press.append(number)
        progress((number + 1) / len(folders))
    if not any(label[FORCE] > 0 for label in labels):
        raise InputError(f"{root}: no frame of these presses touches with at most {most_n:g} N: nothing to learn from")
    assert COLUMNS[: len(OUTPUTS)] == ("force_n", "way_mm", "x_mm", "y_mm", "roll_deg", "pitch_deg")
    return Samples(np.array(views), np.array(labels), np.array(press, dtype=np.int64))
