"""The table of hostile cases that tests/hostile/stores.py runs, and what they share."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("support", "e2e", "py/calibrate", "hostile")]

from command_line import run_ruffini  # noqa: E402

LIMIT_S = 60.0  # of a case: it hangs
Case = Callable[[random.Random, Path], None]
GROUPS: dict[str, tuple[Case, int, int]] = {}  # cases in full, in quick


def group(name: str, n: int, n_quick: int) -> Callable[[Case], Case]:
    """Add a kind of case to the table."""

    def add(case: Case) -> Case:
        GROUPS[name] = case, n, n_quick
        return case

    return add


def refused(*words: object, codes: tuple[int, ...] = (2,), port: str | None = None) -> str:
    """The sentence of a verb that refuses."""
    done = run_ruffini(*words, port=port)
    assert done.code in codes, f"{words}: exit code {done.code}: {done.err[-200:]}"
    sentence = next(line for line in done.err.splitlines() if line.startswith("ruffini: "))
    assert "Traceback" not in done.err, done.err
    return sentence
