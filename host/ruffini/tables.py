"""Tables in plain text: the one place that aligns the columns of what a verb prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

GAP = "  "
OF_NUMBERS = frozenset("0123456789+-<>")  # first characters of cells that are aligned at the right


def aligned(head: Sequence[str], rows: Iterable[Sequence[object]], indent: str = "") -> list[str]:
    """Lines of a table; columns of numbers end under their heads, columns of words begin there.

    >>> print(*aligned(("axis", "N", "state"), [("Fx", 0.5, ""), ("Fz", "12", "kept")]), sep="\\n")
    axis    N  state
    Fx    0.5
    Fz     12  kept
    """
    cells = [[str(cell) for cell in row] for row in rows]
    columns = list(zip(head, *cells, strict=True))
    is_right = [all(not cell or cell[0] in OF_NUMBERS for cell in column[1:]) for column in columns]
    widths = [max(map(len, column)) for column in columns]
    return [
        indent + GAP.join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, is_right, strict=True)
        ).rstrip()
        for row in (head, *cells)
    ]  # fmt: skip
