"""The whole frame of a glowing skin, and the equivalent OpenCV pipeline, turn by turn in one run.

OpenCV: cvtColor, GaussianBlur of 2 px, threshold, connectedComponentsWithStats, one thread. Ours: everything that the
frame path does, through the C interface: difference, the same smoothing, peak, regions, place and force by tables; and,
with --calibration, by taxels instead, of two balls side by side too, which costs a search. The pictures are the twin's.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, find_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core import Pipeline
from ruffini.estimators.skin.openings import TubeView
from ruffini.sim.indenters import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.units import build_unit

Picture = npt.NDArray[np.uint8]
CURVE_STEP_Q2, CURVE_SIZE = 16, 513  # of firmware/stages/skin/skin_image.h
PLACE_STEP_LOG2 = 2
MAX_PLACE_UM = 1_000_000
N_TURNS = 200
LEVEL = 40
TOUCH = Pose(-36e-3, 5e-3, 3e-3)
APART_M = 15e-3


def pictures(board: Board) -> list[Picture]:
    """Untouched, under a ball 3 mm deep, and under two of them."""
    unit, rng = build_unit(board), np.random.default_rng(1)
    renderer, ball = unit.renderer(), Indenter("sphere", 5e-3)
    made = [renderer.image(unit.rig().displacement, rng)]
    for tool in (ball, Indenter.two(ball, ball, APART_M)):
        rig = unit.rig()
        rig.take(tool)
        for part in (0.4, 0.7, 1.0):
            rig.advance(Pose(TOUCH.x_m, TOUCH.y_m, part * TOUCH.depth_m))
        made.append(renderer.image(rig.displacement, rng))
    return made


def paper_file(board: Board, view: TubeView, curve: npt.NDArray[np.float64]) -> CalibrationFile:
    """The calibration of the paper's own method: eq. (3) and F(I) = curve[0] I^2 + curve[1] I + curve[2], N."""
    height, width = board.camera.height_px, board.camera.width_px
    lines = [np.arange(((n - 2) >> PLACE_STEP_LOG2) + 2) * (1 << PLACE_STEP_LOG2) for n in (width, height)]
    x, y = np.meshgrid(*lines)
    place_um = view.unproject(np.column_stack([x.ravel(), y.ravel()]).astype(float)) * 1e3
    limited = np.clip(np.round(place_um), -MAX_PLACE_UM, MAX_PLACE_UM).astype(np.int32)
    level = np.arange(CURVE_SIZE) * CURVE_STEP_Q2 / 4
    force_un = np.clip(np.round(np.polyval(curve, level) * 1e6), 0, 1e9).astype(np.int32)
    tensors = {"skin.place": limited.reshape(*x.shape, 2), "skin.curve": force_un}
    return pack(tensors, {**base_metadata(board), "skin.step_log2": str(PLACE_STEP_LOG2)})


def opencv(picture: Picture, initial: Picture) -> object:
    """The pipeline that the paper's authors would write."""
    grey = cv2.cvtColor(cv2.subtract(picture, initial), cv2.COLOR_BGR2GRAY)
    _, binary = cv2.threshold(cv2.GaussianBlur(grey, (0, 0), 2.0), LEVEL, 255, cv2.THRESH_BINARY)
    return cv2.connectedComponentsWithStats(binary)


def measure(board: Board, calibration: Path | None) -> dict[str, float]:
    """Median milliseconds of processor time of each, in turns: what else the machine does is not counted."""
    cv2.setNumThreads(1)
    rest, touched, by_two = pictures(board)
    camera = board.camera
    radius = board.skin.radius_um * 1e-3 if board.skin else 0.0
    view = TubeView(camera.focal_mpx * 1e-3, camera.standoff_um * 1e-3, 0, 0, camera.center_x_mpx * 1e-3,
                    camera.center_y_mpx * 1e-3, radius, 0.0)  # fmt: skip
    files = {"picture": paper_file(board, view, np.array([1e-4, 4e-3, 0.6])).data}
    if calibration is not None:
        files["taxels"] = files["two balls"] = calibration.read_bytes()
    seen = {name: by_two if name == "two balls" else touched for name in files}
    cores = {name: Pipeline(board, data) for name, data in files.items()}
    for name, core in cores.items():
        for _ in range(board.pipeline.n_rest_frames):
            core.process(rest)
        core.process(seen[name])
        assert core.touches(), "the ball is not seen"
    work: dict[str, Callable[[], object]] = {"opencv": partial(opencv, touched, rest)}
    work |= {name: partial(core.process, seen[name]) for name, core in cores.items()}
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(N_TURNS):
        for name, one in work.items():
            start = time.process_time()
            one()
            taken[name].append(1e3 * (time.process_time() - start))
    for core in cores.values():
        core.close()
    return {name: float(np.median(t)) for name, t in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", required=True)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    board = find_board(arguments.board)
    ms = measure(board, arguments.calibration)
    if arguments.json:
        print(json.dumps(ms))
        return
    print(f"{board.name}: {board.resolution}, medians of {N_TURNS}, milliseconds of one core, SIMULATED pictures")
    for name, value in ms.items():
        print(f"  {name:10}{value:8.3f}{ms['opencv'] / value:8.2f} times as fast as OpenCV")


if __name__ == "__main__":
    main()
