"""Pictures of the evaluations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ruffini.demo.pictures import COLOURS, _figure, _save
from ruffini.evaluate.markers import Tracks
from ruffini.evaluate.warps import Picture


def marker_tracks(path: Path, frames: list[Picture], tracks: Tracks, result: dict[str, Any]) -> Path:
    """The frame of the largest displacement with every marker's way from rest; displacement over the recording."""
    figure, (left, right) = _figure(13.0, 4.6, ncols=2, width_ratios=(1, 1.3))
    frame = int(np.argmax(tracks.largest_px))
    left.imshow(frames[frame][..., ::-1])
    seen, rest = tracks.is_seen[frame], tracks.rest_px
    moved = tracks.moved_px[frame]
    left.quiver(
        rest[seen][:, 0], rest[seen][:, 1], moved[seen][:, 0], moved[seen][:, 1],
        angles="xy", scale_units="xy", scale=1, width=0.004, color="#F0E442",
    )  # fmt: skip
    place = (rest + moved)[~seen]
    left.plot(place[:, 0], place[:, 1], "x", color="#D55E00", label="lost: filled from neighbours")
    if len(place):
        left.legend(loc="lower left")
    left.set(title=f"frame {frame}: displacement from rest", xlabel="x, px", ylabel="y, px")
    left.set(xlim=(0, frames[frame].shape[1]), ylim=(frames[frame].shape[0], 0))
    right.plot(result["largest_px"], color=COLOURS[2], label="largest displacement")
    right.plot(result["step_px"], color=COLOURS[0], label="largest motion since the frame before")
    right.set(title=f"{result['board']}: {result['frames']} frames", xlabel="frame", ylabel="px")
    right.legend()
    return _save(figure, path)
