"""Pictures of the evaluations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ruffini.boards import Board
from ruffini.demo.pictures import COLOURS, PRESSURE_MAP, _figure, _save
from ruffini.estimators.photometric.presses import Press, PressSet
from ruffini.evaluate import flow
from ruffini.evaluate.markers import Tracks
from ruffini.evaluate.photometric import Surface, normal_error_deg
from ruffini.evaluate.warps import Picture, Warp
from ruffini.frames import read_image


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


def _shown_presses(result: dict[str, Any]) -> list[int]:
    """The best, a middling and the worst press by their normals; fewer where there are not three."""
    by_error = np.argsort([row["refitted"]["normal_deg"] for row in result["presses"]])
    return list(dict.fromkeys(int(by_error[i]) for i in (0, len(by_error) // 2, -1)))


def press_errors(presses: PressSet, surfaces: list[Surface], result: dict[str, Any]) -> Any:
    """Those presses as pictures with their circles, and the error of the normals inside them."""
    shown = _shown_presses(result)
    figure, axes = _figure(4.0 * len(shown), 7.4, nrows=2, ncols=len(shown), squeeze=False)
    turn = np.linspace(0, 2 * np.pi, 100)
    for column, index in enumerate(shown):
        row, seen, press = result["presses"][index], surfaces[index], presses.presses[index]
        dx, dy, dr = row["correction_px"]
        moved = Press(press.path, press.center_x_px + dx, press.center_y_px + dy, press.radius_px + dr)
        top, bottom = axes[0, column], axes[1, column]
        top.imshow(read_image(press.path)[..., ::-1])
        for circle, style, name in ((press, "k--", result["circles"]), (moved, "w-", "refitted")):
            x, y, r = circle.center_x_px, circle.center_y_px, circle.radius_px
            top.plot(x + r * np.cos(turn), y + r * np.sin(turn), style, linewidth=1, label=name)
        top.set(title=f"{row['image']}: normals {row['refitted']['normal_deg']:.1f} deg", xlabel="x, px")
        top.legend(loc="lower left", fontsize=8)
        error = normal_error_deg(presses, moved, seen)
        shades = bottom.imshow(error, vmin=0, vmax=20, cmap=PRESSURE_MAP)
        reach = 1.2 * moved.radius_px
        for axis in (top, bottom):
            axis.set(xlim=(moved.center_x_px - reach, moved.center_x_px + reach))
            axis.set(ylim=(moved.center_y_px + reach, moved.center_y_px - reach))
        figure.colorbar(shades, ax=bottom, label="error of the normal, degrees")
    return figure


def press_depths(presses: PressSet, surfaces: list[Surface], result: dict[str, Any]) -> Any:
    """Those presses: depth, and the profile through the ball beside it."""
    shown = _shown_presses(result)
    figure, axes = _figure(4.0 * len(shown), 7.0, nrows=2, ncols=len(shown), squeeze=False)
    scale, ball_mm = presses.px_per_mm, presses.ball_mm / 2
    for column, index in enumerate(shown):
        row, seen, press = result["presses"][index], surfaces[index], presses.presses[index]
        dx, dy, dr = row["correction_px"]
        x, y, radius = press.center_x_px + dx, press.center_y_px + dy, press.radius_px + dr
        top, bottom = axes[0, column], axes[1, column]
        shades = top.imshow(seen.depth_mm, cmap=PRESSURE_MAP)
        turn = np.linspace(0, 2 * np.pi, 100)
        top.plot(x + radius * np.cos(turn), y + radius * np.sin(turn), color="white", linewidth=1)
        top.set(
            title=f"{row['image']}: normals {row['refitted']['normal_deg']:.1f} deg", xlabel="x, px", ylabel="y, px"
        )
        figure.colorbar(shades, ax=top, label="depth, mm")
        profile = seen.depth_mm[int(np.clip(round(y), 0, len(seen.depth_mm) - 1))]
        away_mm = (np.arange(len(profile)) - x) / scale
        is_cap = np.abs(away_mm) < min(radius / scale, ball_mm)
        cap = -np.sqrt(ball_mm**2 - away_mm[is_cap] ** 2)
        cap += profile[is_cap].mean() - cap.mean()
        bottom.plot(away_mm, profile, color=COLOURS[2], label="device")
        bottom.plot(away_mm[is_cap], cap, "--", color=COLOURS[0], label="ball, offset removed")
        bottom.set(xlabel="from the ball's centre, mm", ylabel="depth, mm")
        bottom.set(title=f"cap {row['refitted']['cap_rms_mm']:.3f} mm RMS, "
                         f"height {row['refitted']['peak_to_edge']:.2f}")  # fmt: skip
        bottom.legend()
    return figure


def save(figure: Any, path: Path) -> Path:
    """Write a figure that a page could hold, too."""
    return _save(figure, path)


def flow_errors(path: Path, picture: Picture | None, board: Board | None, result: dict[str, Any]) -> Path:
    """One moved texture with the board's flow on it and its error there; errors and times of all methods."""
    figure, (left, middle, right) = _figure(15.0, 4.4, ncols=3, width_ratios=(1.2, 1.3, 1))
    rng = np.random.default_rng([flow.FIELD_SEED, 0])
    still = flow.speckle(rng) if picture is None and board is None else picture
    if still is None:
        assert board is not None
        still = flow.speckle(rng, (board.camera.height_px, board.camera.width_px))
    height, width = still.shape[:2]
    warp = Warp.random(rng, (width, height), flow.LARGEST_PX)
    moved = warp.render(still, rng)
    places, found, quality, _ = flow.followed(board or flow.board_for(still), still, moved)
    lost = quality == 0
    left.imshow(moved[..., ::-1])
    seen = ~lost
    left.quiver(*places[seen].T, *found[seen].T, angles="xy", scale_units="xy", scale=1, color="#F0E442", width=0.003)
    left.plot(*places[lost].T, "x", color="#D55E00", markersize=3)
    left.set(title="a moved texture, its flow; x: lost or without texture", xlabel="x, px", ylabel="y, px")
    error = np.linalg.norm(found - warp.forward(places), axis=1)
    shown = middle.scatter(*places[seen].T, c=error[seen], s=14, vmin=0, vmax=0.2, cmap=PRESSURE_MAP)
    middle.set(title="error at the patches", xlabel="x, px", ylabel="y, px", xlim=(0, width), ylim=(height, 0))
    figure.colorbar(shown, ax=middle, label="px")
    for index, (texture, row) in enumerate(result["textures"].items()):
        for name in ("ruffini", *flow.DIS):
            right.plot(row[name]["ms"], row[name]["dense_rms_px"], "os^"[index], color=COLOURS[index])
            right.annotate(f" {name}", (row[name]["ms"], row[name]["dense_rms_px"]), fontsize=8)
        right.plot([], [], "os^"[index], color=COLOURS[index], label=texture)
    right.set(xscale="log", yscale="log", xlabel="time, ms", ylabel="RMS error, all pixels, px")
    right.set(title="beside OpenCV's DIS")
    right.legend()
    return _save(figure, path)
