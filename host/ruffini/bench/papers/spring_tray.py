"""Wrench from three targets: K fitted on the connector as the paper does, judged there as it does, and on the gel.

The paper names no test set: its figures are taken as the residual on the 17 hand loads that K was fitted to.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.bench.papers.recorded import Recorded
from ruffini.boards import Board
from ruffini.papers.spring_tray import calibrate, targets, variables

Array = npt.NDArray[np.float64]
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
UNITS = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])  # N, and N m to N mm


def judge(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """RMSE of each axis on the connector and through the gel, and R^2 on the connector."""
    seen = {part: _seen([r for r in runs if r.part == part]) for part in ("fit", "judge")}
    k = calibrate(*seen["fit"])
    figures: dict[str, float] = {}
    for part, where in (("fit", "connector"), ("judge", "gel")):
        nine, wrench = seen[part]
        if len(nine):
            error = nine @ k.T - wrench
            rmse = np.sqrt(np.mean(error**2, axis=0)) * UNITS
            figures |= {f"{where}, {axis}": float(value) for axis, value in zip(AXES, rmse, strict=True)}
        if part == "fit":
            r2 = 1 - (error**2).sum(axis=0) / ((wrench - wrench.mean(axis=0)) ** 2).sum(axis=0)
            figures |= {f"connector, R2 of {axis}": float(value) for axis, value in zip(AXES, r2, strict=True)}
    return figures


def _seen(runs: list[Recorded]) -> tuple[Array, Array]:
    """Nine variables and the reference sensor's wrench of every loaded frame in which the targets are found."""
    nine, wrench = [], []
    for recorded in runs:
        unloaded = np.mean([targets(recorded.picture(i)) for i in range(int(recorded.touched[0]))], axis=0)
        for frame in recorded.touched:
            nine.append(variables(targets(recorded.picture(int(frame))), unloaded))
            wrench.append(recorded.rig["force"][frame])
    return np.array(nine).reshape(-1, 9), np.array(wrench).reshape(-1, 6)
