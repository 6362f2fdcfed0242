"""docs/results/hostile.md: what each family of hostile cases came to, written by `make hostile` row by row.

A row adds up seeds that ran at the same commit; a run at another commit replaces it, as its figures are valid for one.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from row import Row

from ruffini.files import write_whole

ROOT = Path(__file__).parents[2]
COLUMNS = (
    "board",
    "family",
    "tried",
    "right",
    "wrong",
    "worst unmarked force",
    "right forces flagged",
    "seeds",
    "commit",
    "date",
)
NONE, CHANGED = "-", " changed"
# The code that the cases run: commits of anything else change no figure.
JUDGED = ("firmware", "host/ruffini", "boards", "tests/hostile", "tests/bench/false_flags.py", ":!*.md")

HEADER = """# Hostile cases: wrong forces and lost data

**Simulated.** Command: `make hostile`, which writes this file, row by row. `HOSTILE='--only punches --seed 7'` renews a
part or adds a seed; `--quick` writes nothing. Machine of the last run: {machine}.

A case is right if its result is correct or marked as not to be used; a wrong force passes unmarked
([definition, and the faults that no flag detects](../../proto/PROMISES.md#pictures)). A row adds up its seeds.
"""


@dataclass(frozen=True)
class Run:
    """When and at which commit something ran; `machine` is its class."""

    commit: str
    date: str
    machine: str


@dataclass(frozen=True)
class Line:
    """One row of the table."""

    board: str
    family: str
    tried: int
    right: int
    wrong: int
    worst: str
    flagged: str
    seeds: str
    commit: str
    date: str

    def text(self) -> str:
        """The row in Markdown."""
        return "| " + " | ".join(str(v) for v in vars(self).values()) + " |"


def commit(judged: Sequence[str] = JUDGED) -> str:
    """The last commit of `judged`, with CHANGED behind it if one of its files differs."""

    def git(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["git", *words, "--", *judged], cwd=ROOT, capture_output=True, text=True, check=False)

    name = git("log", "-1", "--format=%h", "--abbrev=8").stdout.strip() or "unknown"
    return name if git("diff", "--quiet", "HEAD").returncode == 0 else name + CHANGED


def machine() -> str:
    """The class of this machine."""
    return f"{platform.machine()}, {os.cpu_count()} cores"


def read(text: str) -> dict[str, dict[tuple[str, str], Line]]:
    """Lines of each module, by board and family."""
    modules: dict[str, dict[tuple[str, str], Line]] = {}
    lines: dict[tuple[str, str], Line] = {}
    for row in text.splitlines():
        if heading := re.match(r"## (\w+)", row):
            lines = modules.setdefault(heading[1], {})
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        if len(cells) == len(COLUMNS) and cells[2].isdigit():
            board, family, tried, right, wrong, *rest = cells
            lines[board, family] = Line(board, family, int(tried), int(right), int(wrong), *rest)
    return modules


def with_row(before: Line | None, row: Row, seed: int, run: Run) -> Line:
    """The line of a row, which adds to `before` if that has other seeds of the same commit without changes."""
    worst = f"{row.worst_n:.3f} N" if row.worst_n else NONE
    flagged = f"{row.n_flagged} of {row.n_good}" if row.n_good else NONE
    line = Line(row.board or NONE, row.family, row.tried, row.right, row.wrong, worst, flagged, str(seed), run.commit,
                run.date)  # fmt: skip
    if before is None or before.commit != run.commit or run.commit.endswith(CHANGED):
        return line
    seeds = before.seeds.split(", ")
    if str(seed) in seeds:
        return before
    numbers = [[int(v) for v in re.findall(r"\d+", text)] or [0, 0] for text in (before.flagged, flagged)]
    n_flagged, n_good = (a + b for a, b in zip(*numbers, strict=True))
    return replace(
        line, tried=before.tried + line.tried, right=before.right + line.right, wrong=before.wrong + line.wrong,
        worst=max(before.worst, worst, key=lambda v: 0.0 if v == NONE else float(v.split()[0])),
        flagged=f"{n_flagged} of {n_good}" if n_good else NONE, seeds=", ".join(sorted([*seeds, str(seed)], key=int)),
    )  # fmt: skip


def written(modules: dict[str, dict[tuple[str, str], Line]], what: dict[str, str], run: Run) -> str:
    """The file's text; `what` describes each module, in order."""
    out = [HEADER.format(machine=run.machine)]
    for name, description in what.items():
        if lines := modules.get(name):
            out.append(f"## {name}\n\n{description[0].upper()}{description[1:]}.\n")
            out.append("| " + " | ".join(COLUMNS) + " |\n" + "| --- " * len(COLUMNS) + "|")
            out.append("\n".join(line.text() for line in lines.values()) + "\n")
    return "\n".join(out)


def add(path: Path, module: str, row: Row, seed: int, what: dict[str, str], run: Run) -> None:
    """Add a row to the file, in one step."""
    modules = read(path.read_text()) if path.exists() else {}
    lines = modules.setdefault(module, {})
    key = row.board or NONE, row.family
    lines[key] = with_row(lines.get(key), row, seed, run)
    write_whole(path, written(modules, what, run).encode())
