"""What a bench presses for an estimator, and how its word on a touch is judged: for `cal auto` and `cal collect`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.rig.log_file import Log, TouchRecord
from ruffini.rig.program import Item, Span

Array = npt.NDArray[np.float64]

NO_SHORE = np.full((0, 2), np.nan)


class Counts(NamedTuple):
    """Touches of each step, and simulated ones behind an operator's stated uncertainty."""

    balls: int
    fitted: int
    judged: int
    error_touches: int


class Word(NamedTuple):
    """What sensor and truth (the twin's, or the reference's) say of one touch, a row for each frame that counts.

    said, true : (k, 6) N and N m ON the pad, NaN where not measured; off_m (k, 2): how far off a skin's contact lies;
    shore (k, 2): hardness of the object, as said and as it is.
    """

    said: Array
    true: Array
    off_m: Array
    shore: Array


@dataclass(frozen=True)
class Task:
    """One kind of estimator. `figures` has `error`, in `unit`; `left_out` is the same figure, cross-validated."""

    name: str
    program: str  # of the touches that it is fitted to
    whole: Counts
    quick: Counts
    depth_mm: float
    shear_mm: float
    ball_mm: float
    unit: str  # of `error`, as text
    span: Callable[[Board, float, float, tuple[float, float] | None], Span]
    fitted: Callable[[Span, int, int], Sequence[Item]]
    judged: Callable[[Span, int, int], Sequence[Item]]
    word: Callable[[Board, Log, TouchRecord, Array], Word]
    figures: Callable[[list[Word]], dict[str, Any]]
    left_out: Callable[[dict[str, Outcome]], float]
    needs_ball: bool = False  # a bench must press with one: the colours are learned from it
    scale_part: float | None = None  # of the span, for presses on a kitchen scale; None: those are not enough
    needs_points: bool = False  # known points of a tube's lens
    check: Callable[[Span], None] = lambda _: None  # raises InputError if a bench's indenters are too few


class Turned(NamedTuple):
    """Of an estimator whose sensor is turned under several tools: the twin's bench turns it, on others a person."""

    name: str
    presses: str  # file of the board's folder that lists those of the twin
    unit: str
    bench: Task  # with a person at the holder


def joined(words: list[Word]) -> Word:
    """All words as one."""
    return Word(*(np.concatenate(column) for column in zip(*words, strict=True)))
