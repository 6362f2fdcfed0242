"""What a collection is at, for whoever looks on: which touch, what is asked of the person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ruffini.rig.program import Condition, HandTouch, Item, Weight

TOLERANCE = 0.15  # of the force that a hand is asked for
WEIGHT_TOLERANCE = 0.1  # a sensor that is yet to be calibrated shows a weight no better
KEPT_FAULTS = 5  # touches that were set aside, of which the reason is shown
MAX_DRIFT = 0.05  # of full scale, since it was tared: it is not the same reference any more


@dataclass
class Guide:
    """Told by the thread that collects, read by any other: each attribute is replaced as a whole."""

    items: Sequence[Item] = ()
    done: frozenset[int] = frozenset()
    number: int | None = None  # of the touch; None: before the first and after the last
    said: str = "looking at reference and sensor: nothing may touch the pad"
    n_asked: int = 0  # questions so far
    is_asked: bool = False  # the last one waits for an answer
    hold: tuple[float, float] | None = None  # since when it is held as it should be (host_clock), and for how long
    set_aside: tuple[str, ...] = ()  # why touches are done again, the newest last
    n_redone: int = 0

    def begin(self, items: Sequence[Item], done: Sequence[int]) -> None:
        """A plan, and what of it is there already."""
        self.items, self.done = tuple(items), frozenset(done)

    def touch(self, number: int) -> None:
        """This one is next."""
        by_hand = isinstance(self.items[number], HandTouch | Weight | Condition)
        self.number, self.hold = number, None
        self.said = "wait: nothing may touch the pad" if by_hand else "hands off: the machine presses"

    def good(self, number: int) -> None:
        """It is kept."""
        self.done, self.number, self.hold = self.done | {number}, None, None

    def bad(self, number: int, why: str) -> None:
        """It is to be done again."""
        self.n_redone += 1
        self.set_aside = (*self.set_aside, f"{self.items[number].told()}: {why}")[-KEPT_FAULTS:]

    def doubt(self, numbers: Sequence[int]) -> None:
        """They were kept, and are not any more."""
        self.done = self.done - frozenset(numbers)
