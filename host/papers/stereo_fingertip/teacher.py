"""The learned teacher of the fingertip's experiment: what the exported network says of the judged presses. SIMULATED.

It is run by OpenCV on one core, as on the board, and judged on the same frames as the board's own estimator, by the
same errors: means of absolute errors against what the twin truly did.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded
from ruffini.boards import Board
from ruffini.train.stereo_predict import StereoNetwork

Array = npt.NDArray[np.float64]

UNITS = np.array([1e-6, 1e-3, 1e-3, 1e-3, *2 * [np.rad2deg(1e-6)]])  # of its outputs in the experiment's
NAMES = ("force_n", "z_mm", "x_mm", "y_mm", "roll_deg", "pitch_deg")
FORCE, Z, X, Y, ROLL = range(5)


def judge(
    board: Board, network: Path, runs: list[tuple[Recorded, Array]], least_n: float, most_n: float
) -> dict[str, Any]:
    """Errors by set, the paper's tests, and its time a frame. runs : recordings with the truth of each frame (t, 7).

    Raises
    ------
    InputError
        No network, or another board's.
    """
    import cv2

    cv2.setNumThreads(1)
    teacher = StereoNetwork(network, board)
    said: dict[str, list[Array]] = {}
    spent, taught = [], []
    for recorded, truth in runs:
        rows = []
        for i in np.flatnonzero((truth[:, FORCE] >= least_n) & (truth[:, FORCE] <= most_n)):
            picture = recorded.picture(int(i))
            start = time.perf_counter()
            told = teacher(picture)
            spent.append(1e3 * (time.perf_counter() - start))
            taught.append(told.is_valid)
            rows.append(told.values * UNITS - truth[i, : len(NAMES)])
        said.setdefault(recorded.set_name, []).append(np.array(rows).reshape(-1, len(NAMES)))
    sets = {name: np.abs(np.concatenate(rows)) for name, rows in said.items()}
    means = {
        name: {"n_frames": len(off), **dict(zip(NAMES, off.mean(axis=0).tolist(), strict=True))}
        for name, off in sets.items()
        if len(off)
    }
    tests = {
        key: float(sets[name][:, column].mean())
        for key, name, column in (
            ("force_n", "test_force", FORCE), ("z_mm", "test_force", Z), ("x_mm", "test_x", X), ("y_mm", "test_y", Y),
            ("angle_deg", "test_angle", ROLL),
        )
        if len(sets.get(name, ()))
    }  # fmt: skip
    if said.get("test_force"):
        tops = [truth[:, FORCE][truth[:, FORCE] <= most_n].max() for r, truth in runs if r.set_name == "test_force"]
        worst = [np.abs(off[:, FORCE]).max() for off in said["test_force"]]
        tests["full_scale_percent"] = float(np.mean([100 * w / t for w, t in zip(worst, tops, strict=True)]))
    about = teacher.metadata
    return {
        "plan": about["ruffini.plan"], "mode": int(about["ruffini.mode"]), "sets": means, "paper_tests": tests,
        "valid_percent": 100 * float(np.mean(taught)), "frame_ms": float(np.median(spent)),
    }  # fmt: skip


def text(result: dict[str, Any]) -> list[str]:
    """Its part of the table."""
    lines = ["", f"learned network ({result['plan']}, mode {result['mode']}) by OpenCV on one core: "
             f"{result['frame_ms']:.0f} ms a frame, {result['valid_percent']:.0f} % as it was taught"]  # fmt: skip
    lines.append(f"  {'':26}{'frames':>7}{'':8}" + "".join(f"{name:>11}" for name in NAMES))
    for name, row in result["sets"].items():
        lines.append(f"  {name:26}{row['n_frames']:7d}{'':8}" + "".join(f"{row[q]:11.3f}" for q in NAMES))
    tests = ", ".join(f"{name} {value:.3f}" for name, value in result["paper_tests"].items())
    return [*lines, f"  the paper's tests: {tests}"]
