"""The direct area of the fingertip's judged presses: from the pins as the board followed them, against the same area of
the twin's true wall (`estimators/fingertip/area.py`), and beside the tool's face.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded
from ruffini.boards import Board
from ruffini.estimators.fingertip.area import area_of_nodes, area_of_pins
from ruffini.estimators.fingertip.fit import Bench, taken
from ruffini.estimators.fingertip.presses import axes, read_press

Array = npt.NDArray[np.float64]
FORCE, ROLL, PITCH, AREA = 0, 4, 5, 6  # columns of truth


def direct(
    board: Board, bench: Bench, runs: list[Recorded], truth_of: Callable[[Recorded], Array], levels_n: list[float]
) -> list[dict[str, float]]:
    """Means by force level: both areas, their mean difference and spread, mm^2, and the face."""
    rows = np.concatenate([_rows(board, bench, run, truth_of(run)) for run in runs])
    out = []
    for low, high in itertools.pairwise(levels_n):
        some = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(some):
            off = some[:, 1] - some[:, 2]
            out.append({
                "from_n": low, "to_n": high, "n": len(some), "ours_mm2": float(some[:, 1].mean()),
                "true_mm2": float(some[:, 2].mean()), "mean_off_mm2": float(off.mean()),
                "mean_error_mm2": float(np.abs(off).mean()), "face_mm2": float(some[:, 3].mean()),
            })  # fmt: skip
    return out


def _rows(board: Board, bench: Bench, run: Recorded, truth: Array) -> Array:
    """Force, our area, the true one and the face of each frame that is touched, (t, 4)."""
    press, pins, eyes = read_press(board, run.folder), bench.pins, bench.eyes
    rest, shifts = taken(press, pins.rest)
    nodes = run.truth["displacement"] * 1e3
    first, out = len(truth) - len(shifts), []
    for i in np.flatnonzero(np.isfinite(truth[:, AREA])):
        moved = eyes.place(rest + shifts[i - first]) - eyes.place(rest)
        axis = axes(*np.deg2rad(truth[i, [ROLL, PITCH]]))[:, 2]
        middle = np.maximum(-(moved * pins.normal).sum(axis=1), 0) ** 2 @ pins.normal
        middle /= np.linalg.norm(middle)
        ours = area_of_pins(moved, pins.place, pins.normal, axis, eyes.radius_mm)
        true = area_of_nodes(nodes[i], 1e-3 * board.pad.size_x_um, middle, axis, eyes.radius_mm)
        out.append((truth[i, FORCE], ours, true, truth[i, AREA]))
    return np.array(out).reshape(-1, 4)
