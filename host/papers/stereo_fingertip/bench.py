"""Force, position and angle of the stereo paper's rig, by the stand-in for its network.

Labels are what the paper logs: F of the gauge, Z of the stage, X and Y of the tool, and the angle. Errors are mean
absolute errors over all frames of a test, as in its eq. (5) and (6); the full-scale error is eq. (4), per test.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded
from papers.stereo_fingertip.method import Regression, inputs
from ruffini.boards import Board

Array = npt.NDArray[np.float64]

LEAST_N, MOST_N = 0.05, 1.05  # the paper's range of 0.1 to 1 N, and half a step
FORCE, Z, X, Y, ROLL, PITCH = range(6)


def judge(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """Mean absolute errors of the paper's tests."""
    fit = [_samples(r) for r in runs if r.part == "fit"]
    model = Regression.fit(np.concatenate([x for x, _ in fit]), np.concatenate([y for _, y in fit]))

    def errors(name: str) -> list[tuple[Array, Array]]:
        """Error (n, 6) and label (n, 6) of each run of a set."""
        tests = [_samples(r) for r in runs if r.set_name == name]
        return [(model(x) - y, y) for x, y in tests if len(x)]

    on_top, along_x, along_y, turned = (errors(f"test_{name}") for name in ("force", "x", "y", "angle"))
    return {
        "force": _mean(on_top, FORCE),
        "X": _mean(along_x, X),
        "Y": _mean(along_y, Y),
        "Z": _mean(on_top, Z),
        "angle of 45": _mean(turned, ROLL),
        "full-scale error": 100 * float(np.mean([np.abs(e[:, FORCE]).max() / y[:, FORCE].max() for e, y in on_top])),
    }


def _mean(tests: list[tuple[Array, Array]], label: int) -> float:
    return float(np.mean(np.abs(np.concatenate([error[:, label] for error, _ in tests]))))


def _samples(recorded: Recorded) -> tuple[Array, Array]:
    """Inputs (n, k) and labels (n, 6): N, mm, mm, mm, degrees, degrees."""
    rows, labels = [], []
    for frame in recorded.touched:
        force = -float(recorded.rig["force"][frame, 2])
        if not LEAST_N <= force <= MOST_N:
            continue
        x, y, _, _, roll, pitch = recorded.truth["pose"][frame]
        depth = recorded.rig["depth_m"][frame]
        rows.append(inputs(recorded.picture(int(frame))))
        labels.append((force, depth * 1e3, x * 1e3, y * 1e3, np.rad2deg(roll), np.rad2deg(pitch)))
    return np.array(rows), np.array(labels).reshape(-1, 6)
