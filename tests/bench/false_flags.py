"""How often a good frame is flagged, and how soon a bad one: through the core, on the twin's pictures. SIMULATED.

Good frames are drawn in bulk: of N_RENDERS pictures of the same state with noise of their own, untouched, pressed,
sheared and turned, each tile of TILE_PX is taken from one of them by chance. A sensor's noise and a JPEG's blocks know
nothing of each other from tile to tile: a frame drawn is as good as one rendered. In half of the frames the light
drifts by DRIFT and flickers by FLICKER. Without any flag in n frames the rate is below 3 / n (95 %). Flags that say
that there is no calibration do not count.

Flags of a live camera are on: repeated and broken pictures, lamps that are off.

Bad frames: the lens covered, daylight from one side, and a marker (or opening) painted over with what is beside it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import Conditions
from ruffini.sim.pose import Pose
from ruffini.sim.units import build_unit

Picture = npt.NDArray[np.uint8]

N_RENDERS, TILE_PX = 64, 16  # a few tiles side by side are never those of a frame before
STEPS, BALL_M, PLACE_M = 3, 5e-3, {"tube": (-36e-3, 5e-3, 2.4e-3)}  # how the touch is made; elsewhere in the middle
MIDDLE_M = (1e-3, -1e-3, 0.6e-3)
SHEAR_M, TURN_RAD = 0.3e-3, 0.1
DRIFT, DRIFT_FRAMES, FLICKER = 0.004, 3_000, 0.002  # of all light; a period of the drift
SAME_STATE = 25  # frames before the touch comes or goes
UNCALIBRATED, OVER_RANGE = 2 | 4, 32
MOST_FRAMES = 3  # a bad frame must be flagged within these
LEAK = 0.3  # of the mean level
PAINTED_PX = 2.2  # times the bright or dark blob's own size


def renders(board: Board, seed: int = 0) -> tuple[list[list[Picture]], dict[str, Picture]]:
    """Pictures of each state, N_RENDERS times, and of what is bad; the first state is untouched."""
    unit, rng = build_unit(board), np.random.default_rng([5, seed])
    rig, renderer = unit.rig(), unit.renderer()

    def seen(conditions: Conditions | None = None) -> Picture:
        return renderer.image(rig.displacement, rng, conditions=conditions, tray=rig.tray)

    rest = [seen() for _ in range(N_RENDERS)]
    bad = {"covered lens": seen(Conditions(is_capped=True)), "outside light": seen(Conditions(leak=LEAK))}
    bad["removed marker"] = painted_over(board, rest[0])
    rig.take(Indenter("sphere", BALL_M))
    x, y, depth = PLACE_M.get(unit.twin.shape.kind, MIDDLE_M)
    for step in range(STEPS):
        rig.advance(Pose(x, y, depth * (step + 1) / STEPS))
    pressed = [seen() for _ in range(N_RENDERS)]
    if unit.twin.shape.kind != "plane":
        return [rest, pressed], bad
    rig.advance(Pose(x + SHEAR_M, y, depth))
    sheared = [seen() for _ in range(N_RENDERS)]
    rig.advance(Pose(x + SHEAR_M, y, depth, turn_rad=TURN_RAD))
    return [rest, pressed, sheared, [seen() for _ in range(N_RENDERS)]], bad


def painted_over(board: Board, picture: Picture) -> Picture:
    """The picture with its clearest blob, and what touches it, hidden under its neighbourhood."""
    grey = cv2.GaussianBlur(picture.sum(axis=2).astype(np.float32), (0, 0), 2)
    odd = np.abs(grey - cv2.blur(grey, (101, 101)))
    margin = 60
    v, u = np.unravel_index(
        int(odd[margin:-margin, margin:-margin].argmax()), odd[margin:-margin, margin:-margin].shape
    )
    at = np.array([u, v]) + margin
    half = min(margin // 2, round(PAINTED_PX * 12))
    out = picture.copy()
    box = (slice(at[1] - half, at[1] + half), slice(at[0] - half, at[0] + half))
    out[box] = np.median(picture[box].reshape(-1, 3), axis=0) if board.targets is not None else 0
    return out


class Drawn:
    """Frames whose tiles are taken by chance from pictures of one state."""

    def __init__(self, pictures: list[Picture], rng: np.random.Generator) -> None:
        stack = np.array(pictures)
        n, height, width, _ = stack.shape
        self.rows, self.columns, self.rng = height // TILE_PX, width // TILE_PX, rng
        tiles = stack.reshape(n, self.rows, TILE_PX, self.columns, TILE_PX * 3).transpose(1, 3, 0, 2, 4)
        self.tiles = np.ascontiguousarray(tiles).reshape(self.rows * self.columns, n, TILE_PX, TILE_PX * 3)
        self.every = np.arange(len(self.tiles))

    def frame(self) -> Picture:
        chosen = self.tiles[self.every, self.rng.integers(self.tiles.shape[1], size=len(self.every))]
        lines = chosen.reshape(self.rows, self.columns, TILE_PX, TILE_PX * 3).transpose(0, 2, 1, 3)
        return np.ascontiguousarray(lines).reshape(self.rows * TILE_PX, self.columns * TILE_PX, 3)


def lit(picture: Picture, i: int, rng: np.random.Generator) -> Picture:
    """Under light that drifts and flickers; half a level of dither, as the light is scaled and not the picture."""
    gain = np.float32(1 + DRIFT * np.sin(2 * np.pi * i / DRIFT_FRAMES) + FLICKER * np.sin(2.1 * i))
    dithered = picture + rng.random(picture.shape, dtype=np.float32) - np.float32(0.5)
    return np.asarray(np.clip(np.rint(dithered * gain), 0, 255), dtype=np.uint8)


def measure(board: Board, calibration: bytes | None, n_frames: int, seed: int = 0) -> dict[str, Any]:
    """Flagged good frames, and how many frames each bad thing needs until it is flagged (0: never)."""
    if board.camera.height_px % TILE_PX or board.camera.width_px % TILE_PX:
        raise SystemExit(f"board {board.name!r}: {board.resolution} is not whole tiles of {TILE_PX} px")
    states, bad = renders(board, seed)
    drawn = [Drawn(pictures, np.random.default_rng([6, i, seed])) for i, pictures in enumerate(states)]
    flagged: dict[int, int] = {}
    of_state = [{"frames": 0, "flagged": 0, "over_range": 0} for _ in drawn]
    drift = np.random.default_rng([7, seed])
    soon: dict[str, int] = {}
    time_s = 0.0
    with Pipeline(board, calibration) as core:
        core.set_live()

        def shown(picture: Picture) -> int:
            nonlocal time_s
            time_s += 1e3 / board.camera.rate_mhz
            return core.process(picture, time_s).flags & ~UNCALIBRATED

        for _ in range(board.pipeline.n_rest_frames + 2):
            shown(drawn[0].frame())
        for i in range(n_frames):
            step = i // SAME_STATE  # every second one is untouched
            state = 0 if step % 2 == 0 else 1 + step // 2 % (len(drawn) - 1)
            picture = drawn[state].frame()
            flags = shown(lit(picture, i, drift) if step // 2 % 2 else picture)
            of_state[state]["frames"] += 1
            of_state[state]["flagged"] += int(flags != 0)
            of_state[state]["over_range"] += int(flags == OVER_RANGE)
            if flags:
                flagged[flags] = flagged.get(flags, 0) + 1
        core.set_live(is_live=False)  # a bad picture is shown again as it is
        for name, picture in bad.items():
            while shown(drawn[0].frame()):  # good again
                pass
            soon[name] = next((i for i in range(1, MOST_FRAMES + 1) if shown(picture)), 0)
    n = sum(flagged.values())
    return {"board": board.name, "frames": n_frames, "flagged": n, "of_state": of_state,
            "by_mask": {str(k): v for k, v in flagged.items()},
            "rate_below": float(chi2.ppf(0.95, 2 * (n + 1))) / 2 / n_frames, "frames_until_flagged": soon}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", required=True)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    file = arguments.calibration
    result = measure(find_board(arguments.board), None if file is None else file.read_bytes(), arguments.frames)
    if arguments.json:
        print(json.dumps(result))
        return
    print(f"{result['board']}: SIMULATED, {'no calibration' if file is None else file.name}")
    print(f"  good frames flagged: {result['flagged']} of {result['frames']} (flag masks {result['by_mask']}), "
          f"so fewer than {result['rate_below']:.1e} of them (95 %)")  # fmt: skip
    for name, n in result["frames_until_flagged"].items():
        print(f"  {name}: " + (f"flagged in frame {n}" if n else f"NOT flagged within {MOST_FRAMES} frames"))


if __name__ == "__main__":
    main()
