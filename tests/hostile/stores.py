"""Hostile files, devices, stores and recordings: no traceback, no hang, nothing lost, nothing implausible unmarked.

Each case is drawn from the seed and ends as it must: refused in one sentence with its exit code, or with all that was
there.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("support", "e2e", "py/calibrate", "hostile")]

import hang  # noqa: E402
import stores_devices  # noqa: E402, F401 - adds its groups
import stores_files  # noqa: E402, F401 - adds its groups
import stores_record  # noqa: E402, F401 - adds its groups
from cases import GROUPS, LIMIT_S  # noqa: E402
from row import Row, Wanted  # noqa: E402


def rows(seed: int, quick: bool, is_wanted: Wanted) -> Iterator[Row]:
    """One row a group; they belong to no board."""
    if not is_wanted(""):
        return
    hang.HANG_S = LIMIT_S
    for name, (case, n, n_quick) in GROUPS.items():
        n_wrong, note = 0, ""
        for i in range(n_quick if quick else n):
            with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
                try:
                    case(random.Random(f"{seed} {name} {i}"), Path(folder))
                except (Exception, AssertionError) as error:  # whatever it is, the case is wrong
                    n_wrong += 1
                    what = " ".join(str(error).split())[:160]
                    note = note or f"case {i}: {type(error).__name__}: {what}"
        n_tried = n_quick if quick else n
        yield Row("", name, n_tried, n_tried - n_wrong, n_wrong, note=note)
