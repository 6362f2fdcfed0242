"""Videos of a pressed gel beside a load cell's CSV: a small wedge, a picture whose middle follows the force."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ruffini.boards import find_board

LEVELS_PER_N = 4.0


def small_wedge() -> str:
    """board.toml of the wedge with its picture four times smaller."""
    text = find_board("gelsight-wedge").text
    small = {"width_px = 640": "width_px = 160", "height_px = 480": "height_px = 120", "319500": "79500",
             "239500": "59500", "[67, 68], [465, 113]": "[10, 10], [150, 15]",
             "[475, 383], [73, 437]": "[148, 100], [12, 110]", "n_x = 10": "n_x = 4", "n_y = 8": "n_y = 3"}  # fmt: skip
    for large, little in small.items():
        assert large in text
        text = text.replace(large, little)
    return text


def write_video(
    video: Path, seen_n: Sequence[float], rows: Sequence[str], *, noise: float = 0.0, seed: int = 0
) -> Path:
    """A picture whose middle gets brighter by LEVELS_PER_N a newton, and the load cell's `rows` beside it."""
    rng = np.random.default_rng(seed)
    out = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (160, 120))
    for load in seen_n:
        image = np.full((120, 160, 3), 100.0)
        image[40:80, 50:110] += LEVELS_PER_N * load
        out.write(np.round(image + rng.normal(0, noise, image.shape)).astype(np.uint8))
    out.release()
    video.with_suffix(".csv").write_text("\n".join(["frame,load", *rows]) + "\n")
    return video
