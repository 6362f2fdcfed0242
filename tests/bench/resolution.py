"""`make resolution`: how fine the normal force field of every board is that computes one. SIMULATED.

    python tests/bench/resolution.py --table docs/results/accuracy.md --out docs/results/resolution.png

--table replaces the rows of the boards in that document's section SECTION, once all have run; --out draws their curves.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from pathlib import Path
from typing import Any

from gels import with_row

from ruffini.bench.resolution import cells, named, run, table
from ruffini.bench.resolution_picture import curves
from ruffini.boards import find_board
from ruffini.files import write_whole
from ruffini.sim.settings import twin_names

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

SECTION = "## Resolution of the normal force field"
COLUMNS = ("board", "nodes apart", "two lines told apart at", "half response at", "the same: iFEM raw",
           "true nodal forces", "commit", "date")  # fmt: skip
# The code that the figures depend on: commits of anything else change none.
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/resolution.py", ":!*.md")


def boards() -> list[str]:
    """Boards that compute a field of forces, and have a twin."""
    return [name for name in twin_names() if find_board(name).writes("node_forces")]


def row(result: dict[str, Any], at: str, date: str) -> str:
    """The row in Markdown."""
    apart = f"{0.5 / result['node_limit_per_mm']:.2f} mm"
    peers = (", ".join(cells(result, name)) for name in ("raw", "exact"))
    return f"| {' | '.join((named(result), apart, *cells(result, 'default'), *peers, at, date))} |"


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few repeats; not the figures of the document")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    parser.add_argument("--out", type=Path, metavar="FILE", help="picture (PNG) of the curves")
    given = parser.parse_args(words)
    if given.quick and given.table is not None:
        parser.error("--quick makes no figures for --table: leave one of them out")
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    results = []
    for name in boards():
        results.append(run(find_board(name), quick=given.quick))
        print(table(results[-1]), flush=True)
    if given.table is not None:
        text = given.table.read_text()
        for result in results:
            text = with_row(text, row(result, at, date), SECTION, COLUMNS)
        write_whole(given.table, text.encode())
    if given.out is not None:
        curves(given.out, results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
