"""What the page shows of a calibration that a person makes in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Choice(NamedTuple):
    """A button: the word that it sends, its label, what it does."""

    word: str
    label: str
    hint: str


class Field(NamedTuple):
    """What a person fills in before a choice."""

    name: str
    label: str
    value: str
    unit: str


class GateRow(NamedTuple):
    """A gate of the report; `remedy`: what to press again if it failed."""

    name: str
    ok: bool | None
    text: str
    remedy: str


@dataclass(frozen=True)
class Step:
    """What the page shows; replaced as a whole. `phase` is empty while nothing is shown."""

    phase: str = ""
    said: str = ""
    text: str = ""
    is_bad: bool = False
    choices: tuple[Choice, ...] = ()
    fields: tuple[Field, ...] = ()
    gates: tuple[GateRow, ...] = ()
    part: float | None = None  # of the work that is done
    has_report: bool = False


OPEN = Choice("open", "Calibrate", "calibrate this sensor with a kitchen scale")
CLOSE = Choice("close", "Close", "hide this; what was collected is kept")
CLOSED = Step(choices=(OPEN,))
