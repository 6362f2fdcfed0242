"""The dark frame: no log of touches holds pictures without lamps, so `cal fit --only dark` is given them."""

from __future__ import annotations

from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_most
from ruffini.estimators.base import Estimator
from ruffini.estimators.dark.command import COMMAND, DarkOptions
from ruffini.estimators.dark.frame import dark_frame
from ruffini.frames import read_frames

MAX_DARK = 64.0  # grey levels


class Dark(Estimator):
    """Black level and daylight, which the board takes off every picture: taken as given, but of pictures of its own."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("dark",)

    def applies(self, board: Board) -> bool:
        return board.writes("difference")

    def fit(self, job: Job, _: Progress) -> Outcome:
        """Take the frame that was given, or the previous one."""
        return self.keep(job)

    def fit_alone(self, job: Job, options: DarkOptions, progress: Progress) -> Outcome:
        """Fit to a recording with the lamps off."""
        made = dark_frame(job.board, read_frames(job.path()), progress=progress)
        job.tensors |= made.tensors()
        report = made.report()
        level = ", ".join(f"{v:.2f}" for v in report["level_bgr"])
        return Outcome("fitted", f"dark frame of {report['frames']} frames, mean level {level} (B, G, R), brightest "
                       f"{report['brightest']:.1f}; fit the colours with it too: `cal fit --only photometric --dark`",
                       report)  # fmt: skip

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        if "level_bgr" not in report:
            return []
        return [at_most("dark level", max(report["level_bgr"]), MAX_DARK, "grey levels with the lamps off")]


DARK = Dark()
