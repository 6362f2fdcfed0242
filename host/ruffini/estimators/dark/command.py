"""`cal fit --only dark`."""

from __future__ import annotations

from dataclasses import dataclass

from ruffini.estimators.command import Command


@dataclass(frozen=True)
class DarkOptions:
    """None of its own."""


COMMAND = Command(
    "dark",
    "Measure what the camera shows with its lamps off: black level and daylight, which then do not count.",
    logs="Frames with the lamps off: video, or folder.",
    metavar="RECORDING",
    options=DarkOptions,
    former_verb="dark",
)
