"""`make steady`: what averaging the field of an unchanging contact gains and costs. SIMULATED.

    python tests/bench/steady.py --table docs/results/accuracy.md

--table replaces the board's row in that document's section SECTION.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from pathlib import Path
from typing import Any

from gels import with_row

from ruffini.bench.steady import NAMES, run, table
from ruffini.boards import find_board
from ruffini.files import write_whole

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

SECTION = "## Averaging while a contact holds still"
COLUMNS = ("board", "noise, shear", "normal", "false shear", "tangential", "normal error", "shear within 1, 2 sigma",
           "worst frame's error over each frame's: 5 % step, moving", "commit", "date")  # fmt: skip
# The code that the figures depend on: commits of anything else change none.
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/steady.py", ":!*.md")


def row(result: dict[str, Any], at: str, date: str) -> str:
    """The row in Markdown: of single frames, then of means."""
    each, averaged = (result["held"][name] for name in NAMES)

    def both(name: str, factor: float, digits: int, unit: str = "") -> str:
        return f"{factor * each[name]:.{digits}f}, {factor * averaged[name]:.{digits}f}{unit}"

    within = "; ".join(f"{s['shear_1']:.0f}, {s['shear_2']:.0f} %" for s in (each, averaged))
    worst = max(m["worst_ratio"] for m in result["moving"].values())
    cells = (
        result["board"], both("shear_n", 1e3, 2, " mN"), both("normal_n", 1e3, 2, " mN"), both("false_shear", 1, 4),
        both("tangential", 1, 3), both("normal", 1, 3), within,
        f"{result['steps']['5 %']['worst_ratio']:.2f}, {worst:.2f}", at, date,
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the row into this document")
    given = parser.parse_args(words)
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    result = run(find_board(given.board))
    print(table(result), flush=True)
    if given.table is not None:
        text = with_row(given.table.read_text(), row(result, at, date), SECTION, COLUMNS)
        write_whole(given.table, text.encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
