"""What counts as a touch on this unit: the noise of its linear estimate on the log's untouched frames."""

from __future__ import annotations

from itertools import chain
from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_most
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator
from ruffini.estimators.threshold.command import COMMAND
from ruffini.estimators.threshold.fit import MIN_FRAMES, ContactNoise, fit_contact_noise, linear_pressure
from ruffini.frames import read_frames


def _without(job: Job, why: str) -> Outcome:
    kept = job.take("contact")
    return Outcome("open", why) if kept is None else Outcome("kept", f"{why}; {kept.text}")


class Threshold(Estimator):
    """Where forces count as a contact."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("contact",)

    def applies(self, board: Board) -> bool:
        return "support" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit where the log holds enough untouched frames."""
        if job.matrix is None:
            return _without(job, "the operator is not fitted here, and a log's untouched frames are judged with it")
        rest = job.log().rest
        if len(rest) < MIN_FRAMES:
            return _without(job, f"{len(rest)} untouched frames in the log, {MIN_FRAMES} are needed")
        rows, columns = job.board.observed
        shape = (len(rest), rows.stop - rows.start, columns.stop - columns.start, 3)
        pressure = -(rest.reshape(len(rest), -1) @ job.matrix.T).reshape(shape)[..., 2]
        try:
            fit = fit_contact_noise(pressure, job.board.pipeline.n_rest_frames, progress=progress)
        except InputError as error:
            return _without(job, str(error))
        return self._fitted(job, fit)

    def fit_alone(self, job: Job, options: Any, progress: Progress) -> Outcome:
        """Fit to recordings of the untouched pad."""
        if job.logs():
            raise InputError(
                f"{job.logs()[0]}: --only {self.name} takes recordings of the untouched pad; the untouched frames "
                "of a log are judged with the operator that is fitted to it: leave --only out"
            )
        if job.previous is None:
            raise InputError("untouched frames are judged with this unit's calibration: give --previous FILE")
        frames = chain.from_iterable(read_frames(path) for path in job.paths)
        pressure = linear_pressure(job.board, job.previous, frames)
        return self._fitted(job, fit_contact_noise(pressure, job.board.pipeline.n_rest_frames, progress=progress))

    def _fitted(self, job: Job, fit: ContactNoise) -> Outcome:
        job.tensors |= fit.tensors()
        return Outcome("fitted", f"four neighbours above {1e3 * fit.square_n:.2f} mN, or one above "
                       f"{1e3 * fit.alone_n:.2f} mN", fit.report())  # fmt: skip

    def keep(self, job: Job) -> Outcome:
        """The previous calibration's, or board.toml's threshold alone."""
        return job.take("contact") or Outcome("board", "threshold of board.toml")

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        """A touch takes no more force than the board's own threshold."""
        if "alone_mn" not in report or board is None:
            return []
        return [at_most("touch noise", report["alone_mn"], board.contact.threshold_un * 1e-3, "mN on one node")]


THRESHOLD = Threshold()
