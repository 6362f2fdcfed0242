"""The present state of a collection, for displays: the current touch and the instruction to the person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ruffini.rig.program import Condition, HandTouch, Item, ScalePress, Weight

TOLERANCE = 0.15  # of the requested force, by hand
WEIGHT_TOLERANCE = 0.1  # accuracy of a weight shown by a sensor that is not calibrated yet
KEPT_FAULTS = 5  # rejected touches whose reason is shown
MAX_DRIFT = 0.05  # of full scale since the tare; beyond it the reference is not trusted


@dataclass
class Guide:
    """Written by the collecting thread, read by any other; each attribute is replaced atomically."""

    items: Sequence[Item] = ()
    done: frozenset[int] = frozenset()
    number: int | None = None  # of the touch; None: before the first and after the last
    said: str = "looking at reference and sensor: nothing may touch the pad"
    n_asked: int = 0  # questions so far
    is_asked: bool = False  # the last one waits for an answer
    wants_number: bool = False  # and that answer is typed
    hold: tuple[float, float] | None = None  # since when it is held as it should be (host_clock), and for how long
    set_aside: tuple[str, ...] = ()  # why touches are done again, the newest last
    n_redone: int = 0

    def begin(self, items: Sequence[Item], done: Sequence[int]) -> None:
        """Start a plan, part of which may be done already."""
        self.items, self.done = tuple(items), frozenset(done)

    def touch(self, number: int) -> None:
        """This touch is next."""
        by_hand = isinstance(self.items[number], HandTouch | Weight | ScalePress | Condition)
        self.number, self.hold = number, None
        self.said = "wait: nothing may touch the pad" if by_hand else "hands off: the machine presses"

    def good(self, number: int) -> None:
        """This touch was accepted."""
        self.done, self.number, self.hold = self.done | {number}, None, None

    def bad(self, number: int, why: str) -> None:
        """This touch must be repeated."""
        self.n_redone += 1
        self.set_aside = (*self.set_aside, f"{self.items[number].told()}: {why}")[-KEPT_FAULTS:]

    def doubt(self, numbers: Sequence[int]) -> None:
        """These touches were accepted before and must be repeated."""
        self.done = self.done - frozenset(numbers)
