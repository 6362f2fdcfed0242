"""The camera map: it comes from `ruffini cal fit --only camera`, whose pictures no log of touches holds."""

from __future__ import annotations

from ruffini.calibrate.fit.job import Job, Outcome, Progress, Stage


def run(job: Job, _: Progress) -> Outcome:
    """Take the map that was given, or the previous one."""
    return keep(job)


def keep(job: Job) -> Outcome:
    """The same: there is nothing to fit here."""
    return job.take("camera") or Outcome("board", "pinhole of board.toml")


STAGE = Stage("camera", lambda job: True, run, keep)
