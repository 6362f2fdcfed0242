"""The whole frame of a board whose features are blobs, and the equivalent OpenCV pipeline, turn by turn in one run.

OpenCV: cvtColor, GaussianBlur 5 x 5, threshold, connectedComponentsWithStats, one thread. Ours: everything that the
frame path does, through the C interface, with the wrench of the features; and the same with the pad's depth besides.
The pictures are the twin's: at rest, and moved by a load.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from benchmarks import COLOUR_OF_SLOPE

from ruffini.boards import Board, find_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.estimators.wrench.log import features_of
from ruffini.sim.bodies.connector import RANGES
from ruffini.sim.programs import Load, Rest
from ruffini.sim.scenario import Scenario
from ruffini.sim.story import play
from ruffini.sim.units import build_unit

Picture = npt.NDArray[np.uint8]
N_TURNS = 300
THRESHOLD = 45


def pictures(board: Board) -> tuple[Picture, Picture]:
    """Untouched, and under a third of the range of every axis."""
    unit = build_unit(board)
    scenario, renderer = Scenario(), unit.renderer()
    load = np.repeat(RANGES[None] * np.array([1, -1, -1, 1, 1, 1]) / 3, 2, axis=0)
    shown = []
    for i, moment in enumerate(play(unit, [Rest(1), Load(load, [True, True])])):
        shown.append(scenario.picture(renderer, i, moment.displacement, None, moment.tray))
    return shown[0], shown[-1]


def calibration(board: Board, *, has_depth: bool) -> bytes:
    """Tables of the right sizes; what they say does not change the time."""
    features = features_of(board)
    wrench: dict[str, npt.NDArray[Any]] = {
        "wrench.gain": np.full((6, features.n), 1000, np.int32), "wrench.shift": np.full(6, 12, np.uint8),
        "wrench.full_scale": np.full(6, 1 << 30, np.int32), "wrench.square": np.full((6, 21), 1000, np.int32),
        "wrench.error": np.full((2, 6, 6), 1000, np.int32), "wrench.forward": np.zeros((features.n, 27), np.int32),
        "wrench.tolerance": np.full(features.n, 1 << 26, np.int32),
        "wrench.relax_time_ms": np.array([300, 3000, 30000], np.int32),
        "wrench.relax_part": np.full((3, 6), 10_000, np.int32),
    }  # fmt: skip
    axis = np.linspace(-0.9, 0.9, 65)
    q_y, q_x = np.meshgrid(axis, axis, indexing="ij")
    unmix = np.zeros((13, 17, 2, 3), np.int16)
    unmix[..., 0, 0] = unmix[..., 1, 1] = round(4096 / COLOUR_OF_SLOPE)
    slope = np.round(np.stack([q_x, q_y], axis=2) * 4096).astype(np.int16)
    depth = {"photometric.unmix": unmix, "photometric.slope": slope} if has_depth else {}
    return pack({**wrench, **depth}, {**base_metadata(board), "wrench.features": features.sort}).data


def opencv(picture: Picture) -> object:
    """The pipeline that the papers' authors would write."""
    grey = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), (5, 5), 0)
    _, binary = cv2.threshold(grey, THRESHOLD, 255, cv2.THRESH_BINARY_INV)
    return cv2.connectedComponentsWithStats(binary)


def measure(board: Board) -> dict[str, Any]:
    """Median milliseconds of processor time of each, in turns: what else the machine does is not counted."""
    cv2.setNumThreads(1)
    rest, loaded = pictures(board)
    cores = {
        name: Pipeline(board, calibration(board, has_depth=name == "with depth")) for name in ("wrench", "with depth")
    }
    for core in cores.values():
        for _ in range(board.pipeline.n_rest_frames):
            core.process(rest)
    work: dict[str, Callable[[], object]] = {"opencv": partial(opencv, loaded)}
    work |= {name: partial(core.process, loaded) for name, core in cores.items()}
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(N_TURNS):
        for name, one in work.items():
            start = time.process_time()
            one()
            taken[name].append(1e3 * (time.process_time() - start))
    stages = cores["with depth"].process(loaded).stage_ns
    for core in cores.values():
        core.close()
    return {
        "board": board.name, "size": board.resolution, "ms": {name: float(np.median(t)) for name, t in taken.items()},
        "stages_ms": {name: stages[name] * 1e-6 for name in board.pipeline.stages},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", required=True)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    m = measure(find_board(arguments.board))
    if arguments.json:
        print(json.dumps(m))
        return
    ms = m["ms"]
    print(f"{m['board']}: {m['size']}, medians of {N_TURNS}, milliseconds of one core, SIMULATED pictures")
    print(f"  OpenCV, colour to labelled blobs     {ms['opencv']:.3f}")
    print(
        f"  ruffini, colour to wrench            {ms['wrench']:.3f}   {ms['opencv'] / ms['wrench']:.2f} times as fast"
    )
    print(f"  ruffini, and the depth of the pad    {ms['with depth']:.3f}   {ms['opencv'] / ms['with depth']:.2f}")
    print("  of one frame: " + ", ".join(f"{name} {value:.3f}" for name, value in m["stages_ms"].items()))


if __name__ == "__main__":
    main()
