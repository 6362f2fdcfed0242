"""What a group of hostile cases came to."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Wanted = Callable[[str], bool]  # of a board's name; "" is none


class Row(NamedTuple):
    """`tried` cases of one family of faults on one board, each of which is right (correct or marked) or wrong.

    board   : "" if the cases need none.
    worst_n : largest error of a force that passed unmarked, newtons; 0 where none did or no force is judged.
    n_good, n_flagged : frames whose force is right, and those of them that are flagged all the same; 0 if not counted.
    """

    board: str
    family: str
    tried: int
    right: int
    wrong: int
    worst_n: float = 0.0
    n_good: int = 0
    n_flagged: int = 0
    note: str = ""
