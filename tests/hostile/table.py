"""docs/results/hostile.md: results of each family of hostile cases, written by `make hostile` cell by cell.

A cell adds up seeds that ran at the same commit; a run at another commit replaces it, as its figures are valid for one.
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
RUN_LINE = re.compile(r"Seeds (.+); commit (.+); (\d{4}-\d\d-\d\d):$")
CELL = re.compile(r"(\d+)/(\d+)(?:; (-|\d+/\d+))?(?:; (.+ N))?$")
NONE, CHANGED = "-", " changed"
# The code that the cases run: commits of anything else change no figure.
JUDGED = ("firmware", "host/ruffini", "boards", "tests/hostile", "tests/bench/false_flags.py", ":!*.md")

HEADER = """# Hostile cases: wrong forces and lost data

**Simulated.** Command: `make hostile`, which writes this file. `HOSTILE='--only punches --seed 7'` renews a part or
adds a seed; `--quick` writes nothing. Machine of the last run: {machine}.

A cell states wrong/tried cases, then, where counted, flagged/all frames with a right force, then the worst unmarked
force. A result is wrong if it is neither correct nor marked as not to be used
([definition, and the faults that no flag detects](../../proto/PROMISES.md#pictures)).
"""


@dataclass(frozen=True)
class Run:
    """When and at which commit something ran; `machine` is its class."""

    commit: str
    date: str
    machine: str


@dataclass(frozen=True)
class Line:
    """The cases of a family on a board, over all seeds of one commit."""

    board: str
    family: str
    tried: int
    wrong: int
    worst: str
    flagged: str
    seeds: str
    commit: str
    date: str

    def cell(self) -> str:
        """Its cell in Markdown, which CELL reads."""
        parts = [f"{self.wrong}/{self.tried}"]
        if self.flagged != NONE or self.worst != NONE:
            parts.append(self.flagged)
        if self.worst != NONE:
            parts.append(self.worst)
        return "; ".join(parts)


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
    run, boards = ("", "", ""), [""]
    for row in text.splitlines():
        cells = [cell.strip() for cell in row.strip()[1:-1].split("|")]
        if heading := re.match(r"## (\w+)", row):
            lines = modules.setdefault(heading[1], {})
        elif found := RUN_LINE.match(row):
            run = (found[1], found[2], found[3])
        elif cells[0] == "family":
            boards = cells[1:]
        else:
            for board, cell in zip(boards, cells[1:], strict=False):
                if of_cell := CELL.match(cell):
                    wrong, tried, flagged, worst = of_cell.groups(NONE)
                    lines[board, cells[0]] = Line(board, cells[0], int(tried), int(wrong), worst, flagged, *run)
    return modules


def with_row(before: Line | None, row: Row, seed: int, run: Run) -> Line:
    """The line of a row, which adds to `before` if that has other seeds of the same commit without changes."""
    worst = f"{row.worst_n:.3f} N" if row.worst_n else NONE
    flagged = f"{row.n_flagged}/{row.n_good}" if row.n_good else NONE
    line = Line(row.board or NONE, row.family, row.tried, row.wrong, worst, flagged, str(seed), run.commit, run.date)
    if before is None or before.commit != run.commit or run.commit.endswith(CHANGED):
        return line
    seeds = before.seeds.split(", ")
    if str(seed) in seeds:
        return before
    numbers = [[int(v) for v in re.findall(r"\d+", text)] or [0, 0] for text in (before.flagged, flagged)]
    n_flagged, n_good = (a + b for a, b in zip(*numbers, strict=True))
    return replace(
        line, tried=before.tried + line.tried, wrong=before.wrong + line.wrong,
        worst=max(before.worst, worst, key=lambda v: 0.0 if v == NONE else float(v.split()[0])),
        flagged=f"{n_flagged}/{n_good}" if n_good else NONE, seeds=", ".join(sorted([*seeds, str(seed)], key=int)),
    )  # fmt: skip


def written(modules: dict[str, dict[tuple[str, str], Line]], what: dict[str, str], run: Run) -> str:
    """The file's text; `what` describes each module, in order."""
    out = [HEADER.format(machine=run.machine)]
    for name, description in what.items():
        if lines := modules.get(name):
            out.append(f"## {name}\n\n{description[0].upper()}{description[1:]}.\n")
            runs = dict.fromkeys((line.seeds, line.commit, line.date) for line in lines.values())
            for seeds, commit_, date in runs:
                of_run = {k: v for k, v in lines.items() if (v.seeds, v.commit, v.date) == (seeds, commit_, date)}
                out += [f"Seeds {seeds}; commit {commit_}; {date}:\n", pivot(of_run) + "\n"]
    return "\n".join(out)


def pivot(lines: dict[tuple[str, str], Line]) -> str:
    """Families as rows, boards as columns."""
    boards = list(dict.fromkeys(board for board, _ in lines))
    rows = ["| family | " + " | ".join(boards) + " |", "| --- " * (len(boards) + 1) + "|"]
    for family in dict.fromkeys(family for _, family in lines):
        cells = [lines[board, family].cell() if (board, family) in lines else "" for board in boards]
        rows.append(f"| {family} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def add(path: Path, module: str, row: Row, seed: int, what: dict[str, str], run: Run) -> None:
    """Add a row to the file, in one step."""
    modules = read(path.read_text()) if path.exists() else {}
    lines = modules.setdefault(module, {})
    key = row.board or NONE, row.family
    lines[key] = with_row(lines.get(key), row, seed, run)
    write_whole(path, written(modules, what, run).encode())
