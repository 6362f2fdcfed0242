"""The camera map: it comes from `ruffini cal fit --only camera`, whose pictures no log of touches holds."""

from __future__ import annotations

from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_most
from ruffini.estimators.base import Estimator

MAX_CAMERA_PX = 1.0


class Camera(Estimator):
    """The map of the optics: taken as given."""

    name = "camera"
    kinds = ("camera", "views")

    def applies(self, board: Board) -> bool:
        return True  # each has a pinhole at least

    def fit(self, job: Job, _: Progress) -> Outcome:
        """Take the map that was given, or the previous one."""
        return self.keep(job)

    def keep(self, job: Job) -> Outcome:
        """The same: there is nothing to fit here."""
        taken = [job.take(kind) for kind in self.kinds]
        return next((one for one in taken if one is not None), Outcome("board", "pinhole of board.toml"))

    def gates(self, report: dict[str, Any], board: Board) -> list[Gate]:
        """Of one view or several."""
        if "views" not in report:
            return []
        views = report["views"] if isinstance(report["views"], list) else [report]
        worst = max(view["residual_px"] for view in views)
        return [at_most("camera", worst, MAX_CAMERA_PX, "px RMS of the target's points")]


CAMERA = Camera()
