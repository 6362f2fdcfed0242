"""Tables in plain text: the only place that aligns columns of what a verb prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

GAP = 2  # spaces between columns


def table(head: Sequence[str], rows: Iterable[Sequence[object]], indent: int = 2) -> str:
    """Lines of a table: the first column starts its lines, the others end under their heads.

    >>> print(table(("axis", "N"), [("Fx", 0.5), ("Fz", 12)]))
      axis    N
      Fx    0.5
      Fz     12
    """
    cells = [[str(cell) for cell in row] for row in (head, *rows)]
    widths = [max(len(row[i]) for row in cells if i < len(row)) for i in range(max(map(len, cells)))]
    space = " " * GAP
    return "\n".join(
        (" " * indent + space.join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=False))
        )).rstrip()
        for row in cells
    )  # fmt: skip
