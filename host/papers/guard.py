"""Measured figures against frozen.toml: a worse one fails, a better one asks to be frozen."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from papers.judged import Frozen
from papers.wanted import Row
from ruffini.tables import aligned

State = Literal["same", "better", "worse", "not measured", "not frozen"]
FAILING: tuple[State, ...] = ("worse", "not measured", "not frozen")
METHOD_PART = 0.03  # of a figure of the paper's method, which nobody tunes: it moves with the twin only


@dataclass(frozen=True)
class Verdict:
    """One figure against its frozen value. allowed : by how much it may be worse, in its unit."""

    name: str
    frozen: float | None
    now: float | None
    allowed: float
    state: State


@dataclass(frozen=True)
class Check:
    """All figures of one run."""

    section: str
    verdicts: list[Verdict]

    @property
    def is_passed(self) -> bool:
        return bool(self.verdicts) and all(v.state not in FAILING for v in self.verdicts)

    def tree(self) -> dict[str, Any]:
        """For --json."""
        return {"against": self.section, "passed": self.is_passed, "figures": [asdict(v) for v in self.verdicts]}

    def text(self) -> str:
        """What moved, and what it asks for."""
        moved = [v for v in self.verdicts if v.state != "same"]
        counts = f"{len(self.verdicts)} figures, {len(moved)} not as frozen"
        lines = [f"check against [{self.section}] of frozen.toml: {counts}"]
        cells = [(v.name, *(_text(n) for n in (v.frozen, v.now, v.allowed)), v.state) for v in moved]
        if cells:
            lines += aligned(("figure", "frozen", "now", "allowed", "state"), cells, "  ")
        if any(v.state == "better" for v in moved):
            lines.append("  better than frozen: run again with --freeze and commit frozen.toml, so that it stays")
        lines.append("  passed" if self.is_passed else "  FAILED")
        return "\n".join(lines)


def check_ours(rows: list[Row], frozen: Frozen | None, *, quick: bool) -> Check:
    """Our figures, each within what its row of wanted.toml allows.

    A figure that was not measured when frozen, and is not now, is not compared.
    """
    kept = {} if frozen is None else frozen.ours_quick if quick else frozen.ours
    verdicts = []
    for row in rows:
        name, now, then = row.wanted.name, row.ours, kept.get(row.wanted.name)
        if now is None and then is None:
            continue
        allowed = 0.0 if then is None else row.wanted.allowed(then)
        state: State = "same"
        if then is None:
            state = "not frozen"
        elif now is None:
            state = "not measured"
        else:
            change = row.wanted.badness(now) - row.wanted.badness(then)
            state = "worse" if change > allowed else "better" if change < -allowed else "same"
        verdicts.append(Verdict(name, then, now, allowed, state))
    gone = sorted(set(kept) - {v.name for v in verdicts})
    verdicts += [Verdict(name, kept[name], None, 0.0, "not measured") for name in gone]
    return Check("ours_quick" if quick else "ours", verdicts)


def check_method(result: dict[str, Any], frozen: Frozen | None) -> Check:
    """Figures of the paper's method: one that moved away from the paper's, or that the paper has not, fails."""
    kept = {} if frozen is None or frozen.is_quick != result["quick"] else frozen.figures
    now = {row["name"]: row["twin"] for row in result["rows"] if row["twin"] is not None}
    papers = {row["name"]: row["paper"] for row in result["rows"]}
    verdicts = []
    for name in dict.fromkeys([*kept, *now]):
        then, value, paper = kept.get(name), now.get(name), papers.get(name)
        allowed = METHOD_PART * abs(then) if then is not None else 0.0
        state: State = "same"
        if then is None:
            state = "not frozen"
        elif value is None or not math.isfinite(value):
            state = "not measured"
        elif abs(value - then) > allowed:
            state = "better" if paper is not None and abs(value - paper) < abs(then - paper) else "worse"
        verdicts.append(Verdict(name, then, value, allowed, state))
    return Check("figures", verdicts)


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
