"""Presses that a new unit of a gel without markers needs, with the calibration of other units and without. SIMULATED.

    python tests/bench/new_unit.py --out FOLDER                    # units of digit-tactile, kept in FOLDER
    python tests/bench/new_unit.py --out FOLDER --table docs/results/accuracy.md

Units differ in modulus, thickness, Poisson's ratio, power of each lamp (5 %) and place of the lamps (0.3 mm). Each is
pressed by three balls anywhere, in four steps of depth; features are the board's integers. N_OTHERS units are fitted
together; N_NEW units are fitted to few of their own presses, and judged on N_JUDGED others.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from gels import with_row

from ruffini.boards import Board, find_board
from ruffini.core.pipeline import Pipeline
from ruffini.estimators.wrench.adapt import adapt
from ruffini.estimators.wrench.fit import Fit, fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun, features_of, measured_axes
from ruffini.estimators.wrench.model import AXES, frames_of
from ruffini.files import write_whole
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.settings import TwinSettings, load_twin
from ruffini.sim.units import build_unit, fleet_error

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

Array = npt.NDArray[np.float64]

SECTION = "## A new unit of a gel without markers"
COLUMNS = ("board, presses", "largest force", "after 200 presses", "few presses alone", "with other units' calibration",
           "commit", "date")  # fmt: skip
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/new_unit.py", ":!*.md")
N_OTHERS, N_OTHERS_PRESSES = 6, 60
N_NEW, N_OWN, N_JUDGED = 3, 200, 60
FEW, N_DRAWS = (3, 5, 10, 20), 5
RADII_M, DEPTH_M = (2e-3, 3e-3, 4e-3), (0.4e-3, 1.2e-3)
STEPS = (0.15, 0.4, 0.7, 1.0)  # of a press' depth
RIM_M = 3e-3  # of the pad that no ball's centre comes to
LAMP_POWER, LAMP_UM = 0.05, 300.0
FZ = AXES.index("Fz")


class Unit(NamedTuple):
    """What each frame's features (t, n) and true wrench (t, 6) in N and N m are, and the number of its press (t,)."""

    features: Array
    wrench: Array
    press: npt.NDArray[np.intp]

    def run(self, presses: npt.NDArray[np.intp], name: str) -> FeatureRun:
        """A log of some presses."""
        of = np.isin(self.press, presses)
        time_s = np.arange(of.sum(), dtype=float)
        return FeatureRun(name, time_s, self.features[of], np.ones(of.sum(), bool), time_s, self.wrench[of],
                          touch=self.press[of], recording=name)  # fmt: skip


def with_other_lamps(board: Board, number: int) -> TwinSettings:
    """The board's twin, its lamps as those of unit `number`."""
    twin, rng = load_twin(board), np.random.default_rng([number, 77])
    light = {"power_1e3": [int(p * np.exp(LAMP_POWER * rng.standard_normal())) for p in twin.light.power_1e3]}
    for name in ("led_b_um", "led_g_um", "led_r_um"):
        light[name] = [int(v + LAMP_UM * rng.standard_normal()) for v in getattr(twin.light, name)]
    return twin.model_copy(update={"light": twin.light.model_copy(update=light)})


def pressed(board: Board, number: int, n_presses: int) -> Unit:
    """Unit `number` pressed so often."""
    unit = build_unit(board, fleet_error(board, number), twin=with_other_lamps(board, number))
    rng, renderer = np.random.default_rng([number, 5]), unit.renderer()
    reach = np.array([board.pad.size_x_um, board.pad.size_y_um]) * 5e-7 - RIM_M
    features, wrench = [], []
    with Pipeline(board) as pipeline:
        for _ in range(board.pipeline.n_rest_frames + 1):
            pipeline.process(renderer.image(unit.at_rest(), rng))
        for i in range(n_presses):
            (x, y), depth = rng.uniform(-reach, reach), rng.uniform(*DEPTH_M)
            rig = unit.rig()
            rig.take(Indenter("sphere", RADII_M[i % len(RADII_M)]))
            for step in STEPS:
                rig.advance(Pose(x, y, depth * step))
                pipeline.process(renderer.image(rig.displacement, rng, tray=rig.tray))
                features.append(pipeline.features())
                wrench.append(rig.wrench() * measured_axes(board))
    return Unit(np.array(features, float), np.array(wrench), np.repeat(np.arange(n_presses), len(STEPS)))


def kept(board: Board, number: int, n_presses: int, folder: Path) -> Unit:
    """As `pressed`; read from the folder if it is there."""
    path = folder / f"{board.name}-{number}-{n_presses}.npz"
    if not path.exists():
        unit = pressed(board, number, n_presses)
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **unit._asdict())
        print(f"unit {number}: {n_presses} presses, to {-unit.wrench[:, 2].min():.2f} N", flush=True)
    with np.load(path) as found:
        return Unit(**found)


def error(fit: Fit, run: FeatureRun) -> float:
    """RMS of the normal force on a log, N."""
    frames = frames_of([run], 0.0)
    return float(np.sqrt(np.mean((fit.map.predicted(frames) - frames.wrench)[:, FZ] ** 2)))


def rows(board: Board, folder: Path) -> list[tuple[str, ...]]:
    """Cells before commit and date, a row for each number of presses: means over units and draws."""
    grid = features_of(board).grid
    others = [kept(board, i, N_OTHERS_PRESSES, folder) for i in range(1, N_OTHERS + 1)]
    runs = [unit.run(np.unique(unit.press), f"unit {i}") for i, unit in enumerate(others)]
    fleet = fit_wrench_map(runs, holdout="recording", nonlinear=True, grid=grid).map
    whole, alone, helped = [], {n: list[float]() for n in FEW}, {n: list[float]() for n in FEW}
    largest = 0.0
    for i in range(N_OTHERS + 1, N_OTHERS + N_NEW + 1):
        unit = kept(board, i, N_OWN + N_JUDGED, folder)
        largest = max(largest, -float(unit.wrench[:, 2].min()))
        judged, own = unit.run(np.arange(N_OWN, N_OWN + N_JUDGED), "judged"), np.arange(N_OWN)
        whole.append(error(fit_wrench_map([unit.run(own, "own")], holdout="touch", nonlinear=True, grid=grid), judged))
        for n in FEW:
            for draw in range(N_DRAWS):
                few = [unit.run(np.random.default_rng(draw).permutation(own)[:n], "few")]
                helped[n].append(error(adapt(few, fleet), judged) / whole[-1])
                if n >= 5:  # fewer touches are not fitted
                    fit = fit_wrench_map(few, holdout="touch", nonlinear=True, grid=grid)
                    alone[n].append(error(fit, judged) / whole[-1])
        print(f"unit {i}: {whole[-1]:.4f} N after {N_OWN} presses", flush=True)
    times = [f"{np.mean(alone[n]):.2f} ({np.max(alone[n]):.2f})" if alone[n] else "not fitted" for n in FEW]
    return [
        (f"{board.name}, {n}", f"{largest:.2f} N", f"{np.mean(whole):.3f} N", times[i],
         f"{np.mean(helped[n]):.2f} ({np.max(helped[n]):.2f})")
        for i, n in enumerate(FEW)
    ]  # fmt: skip


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="digit-tactile", help="one without markers that has a twin with lamps")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="of the units, which it keeps")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    given = parser.parse_args(words)
    at = commit(JUDGED)
    for cells in rows(find_board(given.board), given.out):
        row = f"| {' | '.join((*cells, at, datetime.date.today().isoformat()))} |"
        print(row, flush=True)
        if given.table is not None:
            write_whole(given.table, with_row(given.table.read_text(), row, SECTION, COLUMNS).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
