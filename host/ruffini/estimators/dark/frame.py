"""The dark frame: what a camera shows with its lamps off, black level and daylight that leaks in.

Colours tell slopes by how much of the lamps' light comes back, so that what is not of the lamps must not count:
d = (I - rest) / (rest - dark). Without it slopes come out too small by the share of rest that is dark.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

MIN_FRAMES = 8
LIT_LEVEL = 96.0  # grey levels that a hundredth of a dark frame may reach: more is a lamp that is on
SIXTEENTHS = 16


@dataclass(frozen=True)
class DarkFrame:
    """`image` (h, w, 3) float64, grey levels B G R; `noise` of one frame, grey levels."""

    image: Array
    noise: float
    n_frames: int

    def tensors(self) -> container.Tensors:
        """The kind `dark` of proto/CALIBRATION.md."""
        return {"dark.image": np.round(self.image * SIXTEENTHS).astype(np.uint16)}

    def report(self) -> dict[str, Any]:
        """For the manifest and the screen."""
        return {
            "frames": self.n_frames, "level_bgr": [round(float(v), 3) for v in self.image.mean(axis=(0, 1))],
            "brightest": round(float(self.image.max()), 2), "noise": round(self.noise, 3),
        }  # fmt: skip


def dark_frame(
    board: Board, frames: Iterable[npt.NDArray[np.uint8]], *, progress: Callable[[float], None] = lambda _: None
) -> DarkFrame:
    """Mean of frames with the lamps off.

    Raises
    ------
    InputError
        A frame of another size than the board's, too few frames, or lamps that are on.
    """
    shape = (board.camera.height_px, board.camera.width_px, 3)
    total, squares, n = np.zeros(shape), np.zeros(shape), 0
    for frame in frames:
        if frame.shape != shape:
            raise InputError(
                f"frame {n} is {frame.shape[1]}x{frame.shape[0]}, board {board.name!r} needs {board.resolution}"
            )
        total += frame
        squares += np.square(frame, dtype=float)
        n += 1
        progress(n / (n + MIN_FRAMES))
    if n < MIN_FRAMES:
        raise InputError(f"{n} frames: a dark frame is the mean of at least {MIN_FRAMES}")
    image = total / n
    bright = float(np.quantile(image.max(axis=2), 0.99))
    if bright > LIT_LEVEL:
        raise InputError(f"a hundredth of the picture is above {bright:.0f} grey levels: are the lamps off?")
    noise = float(np.sqrt(np.maximum(squares / n - image**2, 0).mean() * n / (n - 1)))
    return DarkFrame(image, noise, n)


def dark_of(tensors: container.Tensors) -> Array | None:
    """Grey levels (h, w, 3) of the kind `dark`; None where the tensors have none."""
    image = tensors.get("dark.image")
    return None if image is None else image.astype(float) / SIXTEENTHS
