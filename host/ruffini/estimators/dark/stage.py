"""The dark frame: it comes from `ruffini cal fit --only dark`, since no log of touches holds pictures without lamps."""

from __future__ import annotations

from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_most
from ruffini.estimators.base import Estimator

MAX_DARK = 64.0  # grey levels


class Dark(Estimator):
    """Black level and daylight, which the board takes off every picture: taken as given."""

    name = "dark"
    kinds = ("dark",)

    def applies(self, board: Board) -> bool:
        return board.writes("difference")

    def fit(self, job: Job, _: Progress) -> Outcome:
        """Take the frame that was given, or the previous one."""
        return self.keep(job)

    def gates(self, report: dict[str, Any], board: Board) -> list[Gate]:
        if "level_bgr" not in report:
            return []
        return [at_most("dark level", max(report["level_bgr"]), MAX_DARK, "grey levels with the lamps off")]


DARK = Dark()
