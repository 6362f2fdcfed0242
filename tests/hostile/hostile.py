"""`make hostile`: own cases against the promise that nothing wrong goes unmarked and nothing is lost. SIMULATED.

    python tests/hostile/hostile.py                      # everything
    python tests/hostile/hostile.py --quick --seed 7     # fewer cases of each group, drawn from another seed
    python tests/hostile/hostile.py --only pictures --board gelslim

Each module of MODULES draws its cases from the seed and yields a Row for each group of them. A case is right where what
came out is correct or marked as not to be used. Ends with exit code 1 where any was wrong.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import sys
import time
from pathlib import Path

import table
from row import Row

SEED = 20_261_124
MODULES = {  # each offers rows(seed, quick, is_wanted: Wanted) -> Iterator[Row]
    "pictures": "camera faults: old, moved and altered pictures, through the core",
    "punches": "flat faces, edges, plates, and presses while rest is learned, through the core",
    "alarms": "good frames of every board, through the core: at most one in 10,000 is flagged",
    "stores": "files, stores, recordings, devices and starts, through the tools",
}
LINE = "{:46}{:>8}{:>8}{:>8}{:>12}  {}"


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--quick", action="store_true", help="fewer cases: for a first look and for CI")
    parser.add_argument("--only", choices=MODULES, action="append", help="one module; may be repeated")
    parser.add_argument("--board", action="append", help="cases of one board; may be repeated")
    parser.add_argument("--table", type=Path, metavar="FILE", help="add the rows to this document; not with --quick")
    given = parser.parse_args(words)
    run = table.Run(table.commit(), datetime.datetime.now(datetime.UTC).date().isoformat(), table.machine())
    every: list[Row] = []

    def is_wanted(board: str) -> bool:
        return given.board is None or board in given.board

    print(f"hostile cases, SIMULATED, seed {given.seed}{', quick' if given.quick else ''}")
    print(LINE.format("group", "tried", "right", "wrong", "worst", ""))
    for name in given.only or MODULES:
        print(f"{name}: {MODULES[name]}")
        start = time.monotonic()
        for row in importlib.import_module(name).rows(given.seed, given.quick, is_wanted):
            every.append(row)
            _print(f"  {row.board} {row.family}" if row.board else f"  {row.family}", row)
            if given.table and not given.quick and row.tried:
                table.add(given.table, name, row, given.seed, MODULES, run)
        print(f"  {time.monotonic() - start:.0f} s", flush=True)
    total = Row("", "all", sum(r.tried for r in every), sum(r.right for r in every), sum(r.wrong for r in every),
                max((r.worst_n for r in every), default=0.0))  # fmt: skip
    _print("all", total)
    if total.tried == 0:
        print("no case was tried: nothing is shown", file=sys.stderr)
    return 1 if total.wrong or not total.tried else 0


def _print(group: str, row: Row) -> None:
    worst = f"{row.worst_n:.3f} N" if row.worst_n else "-"
    flagged = f"{row.n_flagged} of {row.n_good} right forces flagged" if row.n_good else ""
    print(
        LINE.format(group, row.tried, row.right, row.wrong, worst, "; ".join(filter(None, (flagged, row.note)))),
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
