"""Wrench from three targets: K fitted on the connector as the paper does, judged there as it does, and on the gel.

The paper names no test set: its figures are taken as the residual on the 17 hand loads that K was fitted to. Through
the gel, where the paper never judges, K of loads over the sensor's whole range is judged: the better for the method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from papers.ftouch.method import calibrate, targets, variables
from papers.recorded import Recorded
from ruffini.boards import Board

Array = npt.NDArray[np.float64]
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
UNITS = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])  # N, and N m to N mm


@dataclass(frozen=True)
class _Seen:
    """Nine variables (n, 9) and the reference's wrench (n, 6) of the loaded frames that show three targets."""

    nine: Array
    wrench: Array
    n_lost: int  # loaded frames that do not

    def rmse(self, k: Array) -> Array:
        """Of each axis, N and N mm."""
        return np.asarray(np.sqrt(np.mean((self.nine @ k.T - self.wrench) ** 2, axis=0)) * UNITS)

    def r2(self, k: Array) -> Array:
        """Coefficient of determination of each axis."""
        lack = ((self.nine @ k.T - self.wrench) ** 2).sum(axis=0)
        return np.asarray(1 - lack / ((self.wrench - self.wrench.mean(axis=0)) ** 2).sum(axis=0))


def judge(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """RMSE and R^2 of each axis on the connector, RMSE and lost frames (%) through the gel."""
    seen = {part: _seen([r for r in runs if r.part == part]) for part in ("fit", "show", "judge")}
    fitted, gel = seen["fit"], seen["judge"]
    k = calibrate(fitted.nine, fitted.wrench)
    figures = _named("connector, ", fitted.rmse(k)) | _named("connector, R2 of ", fitted.r2(k))
    if len(gel.nine) and len(seen["show"].nine):
        whole = seen["show"]
        figures |= _named("gel, ", gel.rmse(calibrate(whole.nine, whole.wrench)))
        figures["gel, frames without three targets"] = 100 * gel.n_lost / (gel.n_lost + len(gel.nine))
    return figures


def _named(prefix: str, values: Array) -> dict[str, float]:
    return {f"{prefix}{axis}": float(value) for axis, value in zip(AXES, values, strict=True)}


def _seen(runs: list[Recorded]) -> _Seen:
    nine, wrench, n_lost = [], [], 0
    for recorded in runs:
        unloaded = np.mean([targets(recorded.picture(i)) for i in range(int(recorded.touched[0]))], axis=0)
        for frame in recorded.touched:
            try:
                now = targets(recorded.picture(int(frame)))
            except ValueError:  # a shadow of a deep dent is as dark as a target
                n_lost += 1
                continue
            nine.append(variables(now, unloaded))
            wrench.append(recorded.rig["force"][frame])
    return _Seen(np.array(nine).reshape(-1, 9), np.array(wrench).reshape(-1, 6), n_lost)
