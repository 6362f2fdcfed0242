"""Normal force of a gel without markers from moments of depth and from the picture's grid, same presses. SIMULATED.

    python tests/bench/depth_moments.py --out FOLDER    # units of digit-tactile

Units and balls are those of new_unit.py; each unit's colours are learned from N_BALLS presses of a ball, as the demo
does it. Both fits have the same presses of balls, at most N_OWN, and are judged on N_JUDGED others and on N_FLAT
presses of flat punches, which neither fit has seen.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from new_unit import DEPTH_M, RADII_M, RIM_M, STEPS, Unit, error, with_other_lamps

from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core.pipeline import Pipeline
from ruffini.demo.calibration import BALL_MM, N_BALLS
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.pad_view import Pinhole
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.wrench.fit import fit_wrench_map
from ruffini.estimators.wrench.log import features_of, measured_axes
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.recording import record_balls
from ruffini.sim.unit import TwinUnit
from ruffini.sim.units import build_unit, fleet_error

N_OWN, N_JUDGED, N_FLAT = 60, 60, 20
FEW = (10, 20, N_OWN)
FLAT_DEPTH = 0.3  # of a ball's: forces as of the balls
N_REST = 50  # untouched frames
STAGES = ("difference", "photometric", "poisson", "depth_moments", "feature_wrench")


class Sorts(NamedTuple):
    """The same presses in features of both sorts."""

    picture: Unit
    depth: Unit


def moments_board(board: Board) -> Board:
    """The board with depth_moments in place of picture_features."""
    head = board.text[: board.text.index("stages = ")]
    section = head[head.index("[picture_features]") : head.index("[depth]")]
    return parse_board(f"{head.replace(section, '')}stages = {list(STAGES)}\n".replace("'", '"'), board.name)


def colours(board: Board, unit: TwinUnit, folder: Path) -> CalibrationFile:
    """The unit's table of colours."""
    balls, c = folder / "balls", board.camera
    if not balls.exists():
        record_balls(unit, N_BALLS, balls, ball_mm=BALL_MM, seed=11)
    pinhole = Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)
    model = fit_photometric(collect_samples(load_presses(balls), pinhole)).model
    return pack(tabulate(model), base_metadata(board))


def pressed(number: int, folder: Path) -> Sorts:
    """Unit `number`, its colours learned, pressed by balls anywhere."""
    board = find_board("digit-tactile")
    of_depth = moments_board(board)
    unit = build_unit(board, fleet_error(board, number), twin=with_other_lamps(board, number))
    assert isinstance(unit, TwinUnit)
    file = colours(of_depth, unit, folder)
    rng, renderer = np.random.default_rng([number, 5]), unit.renderer()
    reach = np.array([board.pad.size_x_um, board.pad.size_y_um]) * 5e-7 - RIM_M
    rows: tuple[list[npt.NDArray[np.int64]], ...] = ([], [])
    wrench = []
    with Pipeline(board) as picture, Pipeline(of_depth, file.data) as depth:
        for _ in range(board.pipeline.n_rest_frames + 1):
            for pipeline in (picture, depth):
                pipeline.process(renderer.image(unit.at_rest(), rng))
        at_rest = []
        for _ in range(N_REST):
            depth.process(renderer.image(unit.at_rest(), rng))
            at_rest.append(depth.features())
        print(f"unit {number}: features at rest up to {np.abs(at_rest).max(axis=0).tolist()}", flush=True)
        for i in range(N_OWN + N_JUDGED + N_FLAT):
            is_ball = i < N_OWN + N_JUDGED
            (x, y), deepest = rng.uniform(-reach, reach), rng.uniform(*DEPTH_M) * (1.0 if is_ball else FLAT_DEPTH)
            rig = unit.rig()
            rig.take(Indenter("sphere" if is_ball else "flat", RADII_M[i % len(RADII_M)]))
            for step in STEPS:
                rig.advance(Pose(x, y, deepest * step))
                image = renderer.image(rig.displacement, rng, tray=rig.tray)
                for pipeline, kept in zip((picture, depth), rows, strict=True):
                    pipeline.process(image)
                    kept.append(pipeline.features())
                wrench.append(rig.wrench() * measured_axes(board))
    press = np.repeat(np.arange(N_OWN + N_JUDGED + N_FLAT), len(STEPS))
    return Sorts(*(Unit(np.array(kept, float), np.array(wrench), press) for kept in rows))


def errors(unit: Unit, board: Board) -> list[tuple[float, float]]:
    """RMS of the normal force on the judged balls and on the flat punches, of fits to FEW presses, N."""
    features = features_of(board)
    balls = unit.run(np.arange(N_OWN, N_OWN + N_JUDGED), "balls")
    flats = unit.run(np.arange(N_OWN + N_JUDGED, N_OWN + N_JUDGED + N_FLAT), "flats")
    fits = [
        fit_wrench_map([unit.run(np.arange(n), "own")], holdout="touch", nonlinear=True, grid=features.grid)
        for n in FEW
    ]
    return [(error(fit, balls), error(fit, flats)) for fit in fits]


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="of the balls' pictures")
    given = parser.parse_args(words)
    board = find_board("digit-tactile")
    for number in range(1, given.units + 1):
        sorts = pressed(number, given.out / f"{number}")
        largest = [-sorts.depth.wrench[sorts.depth.press < N_OWN + N_JUDGED, 2].min(), -sorts.depth.wrench[:, 2].min()]
        print(f"unit {number}: balls to {largest[0]:.2f} N, flat punches to {largest[1]:.2f} N", flush=True)
        for name, of in zip(Sorts._fields, (board, moments_board(board)), strict=True):
            unit = getattr(sorts, name)
            for n, (balls, flats) in zip(FEW, errors(unit, of), strict=True):
                print(
                    f"unit {number}, {name}, {n} presses: balls {balls:.3f} N, flat punches {flats:.3f} N", flush=True
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
