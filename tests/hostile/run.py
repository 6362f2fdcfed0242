"""`make hostile`: own cases against the promise that nothing wrong goes unmarked and nothing is lost. SIMULATED.

    python tests/hostile/run.py                      # everything
    python tests/hostile/run.py --quick --seed 7     # fewer cases of each group, drawn from another seed
    python tests/hostile/run.py --only pictures

Each module of MODULES draws its cases from the seed and yields a Row for each group of them. A case is right where what
came out is correct or marked as not to be used. Ends with exit code 1 where any was wrong.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from pathlib import Path

from row import Row

SEED = 20_261_124
MODULES = {  # each offers rows(seed, quick) -> Iterator[Row]
    "pictures": "camera faults: old, moved and altered pictures, through the core",
    "punches": "flat faces, edges, plates, and presses while rest is learned, through the core",
    "alarms": "good frames of every board, through the core: at most one in 10,000 is flagged",
    "stores": "files, stores, recordings, devices and starts, through the tools",
}
LINE = "{:46}{:>8}{:>8}{:>8}{:>12}  {}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--quick", action="store_true", help="fewer cases: for a first look and for CI")
    parser.add_argument("--only", choices=MODULES, action="append", help="one module; may be repeated")
    given = parser.parse_args()
    every: list[Row] = []
    print(f"hostile cases, SIMULATED, seed {given.seed}{', quick' if given.quick else ''}")
    print(LINE.format("group", "tried", "right", "wrong", "worst", ""))
    for name in given.only or MODULES:
        print(f"{name}: {MODULES[name]}")
        start = time.monotonic()
        for row in importlib.import_module(name).rows(given.seed, given.quick):
            every.append(row)
            _print("  " + row.group, row)
        print(f"  {time.monotonic() - start:.0f} s", flush=True)
    total = Row("all", sum(r.tried for r in every), sum(r.right for r in every), sum(r.wrong for r in every),
                max((r.worst_n for r in every), default=0.0))  # fmt: skip
    _print("all", total)
    if total.tried == 0:
        print("no case was tried: nothing is shown", file=sys.stderr)
    return 1 if total.wrong or not total.tried else 0


def _print(group: str, row: Row) -> None:
    worst = f"{row.worst_n:.3f} N" if row.worst_n else "-"
    print(LINE.format(group, row.tried, row.right, row.wrong, worst, row.note), flush=True)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    sys.exit(main())
