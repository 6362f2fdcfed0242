"""What a group of hostile cases came to."""

from __future__ import annotations

from typing import NamedTuple


class Row(NamedTuple):
    """`tried` cases of one group, each of which is right (correct or marked) or wrong.

    worst_n : largest error of a force that passed unmarked, newtons; 0 where none did or no force is judged.
    """

    group: str
    tried: int
    right: int
    wrong: int
    worst_n: float = 0.0
    note: str = ""
