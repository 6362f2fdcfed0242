"""wanted.toml: the figures that a board's experiment is held to, beside what it measured. Strict.

[[figure]]
name = "normal force, triangle"  # as the experiment names it
unit = "N"
at_most = 1.0                    # or at_least, or both for a range
worse_part = 0.1                 # by how much of the frozen figure a run may be worse
worse_by = 0.0                   # the same in the figure's unit; the larger of both counts
limit = ""                       # of a figure that is not met: the experiment that shows why, or "open"
limit_quick = ""                 # the same where only the run with --quick does not meet it
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, model_validator

from papers.experiments import Figure
from ruffini.boards import Board, Section
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.older_python import tomllib
from ruffini.tables import aligned

FILE = "wanted.toml"
Text = Annotated[str, Field(min_length=1, max_length=300)]


class WantedFigure(Section):
    """[[figure]]."""

    name: Text
    unit: Annotated[str, Field(max_length=20)] = ""
    at_most: float | None = None
    at_least: float | None = None
    worse_part: Annotated[float, Field(ge=0, le=1)] = 0.1
    worse_by: Annotated[float, Field(ge=0)] = 0.0
    limit: Annotated[str, Field(max_length=300)] = ""
    limit_quick: Annotated[str, Field(max_length=300)] = ""

    @model_validator(mode="after")
    def _has_a_side(self) -> WantedFigure:
        if self.at_most is None and self.at_least is None:
            raise ValueError(f"figure {self.name!r} needs at_most or at_least")
        return self

    def is_met(self, value: float | None) -> bool:
        """Whether a figure is as wanted; one that was not measured is not."""
        if value is None or not math.isfinite(value):
            return False
        return (self.at_most is None or value <= self.at_most) and (self.at_least is None or value >= self.at_least)

    def reason(self, *, quick: bool) -> str:
        """Why it is not met."""
        return (quick and self.limit_quick) or self.limit

    def badness(self, value: float) -> float:
        """Larger is worse, in the figure's unit; of a range, how far outside it."""
        if self.at_most is not None and self.at_least is not None:
            return max(value - self.at_most, self.at_least - value, 0.0)
        return value if self.at_most is not None else -value

    def allowed(self, frozen: float) -> float:
        """By how much a run may be worse than what is frozen."""
        return max(self.worse_part * abs(frozen), self.worse_by)

    @property
    def text(self) -> str:
        if self.at_most is not None and self.at_least is not None:
            return f"{self.at_least:g} to {self.at_most:g}"
        return f"<= {self.at_most:g}" if self.at_most is not None else f">= {self.at_least:g}"


class Wanted(Section):
    """The file."""

    schema_: Annotated[int, Field(alias="schema", ge=1, le=1)]
    figure: Annotated[list[WantedFigure], Field(min_length=1)]

    @model_validator(mode="after")
    def _names_are_unique(self) -> Wanted:
        names = [one.name for one in self.figure]
        if len(set(names)) < len(names):
            raise ValueError(f"figures are named twice: {sorted({n for n in names if names.count(n) > 1})}")
        return self


def load_wanted(board: Board) -> list[WantedFigure]:
    """The figures of wanted.toml beside the board's board.toml; none where there is no such file.

    Raises
    ------
    InputError
        It is not as it should be.
    """
    path = (board.folder or Path()) / FILE
    if not path.is_file():
        return []
    try:
        return Wanted.model_validate(tomllib.loads(readable(path).read_text("utf-8"))).figure
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {where or 'file'}: {first['msg']}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not as it should be: {error}") from error


@dataclass(frozen=True)
class Row:
    """A wanted figure and what was measured of it."""

    wanted: WantedFigure
    figure: Figure | None

    @property
    def ours(self) -> float | None:
        return self.figure.ours if self.figure is not None and math.isfinite(self.figure.ours) else None

    def tree(self, *, quick: bool) -> dict[str, object]:
        """For --json."""
        method, paper = (self.figure.method, self.figure.paper) if self.figure else (None, None)
        return {
            "name": self.wanted.name, "unit": self.wanted.unit, "ours": self.ours, "method": method, "paper": paper,
            "at_most": self.wanted.at_most, "at_least": self.wanted.at_least, "is_met": self.wanted.is_met(self.ours),
            "limit": self.wanted.reason(quick=quick),
        }  # fmt: skip


def rows_of(board: Board, figures: dict[str, Figure]) -> list[Row]:
    """Every wanted figure with what was measured of it; none where the board has no wanted.toml.

    Raises
    ------
    InputError
        A measured figure is not in wanted.toml: nothing would guard it.
    """
    wanted = load_wanted(board)
    unknown = sorted(set(figures) - {one.name for one in wanted}) if wanted else []
    if unknown:
        raise InputError(f"{FILE} of board {board.name!r} does not state what is wanted of {unknown[0]!r}: add it")
    return [Row(one, figures.get(one.name)) for one in wanted]


def table(board: Board, rows: list[Row], *, quick: bool) -> str:
    """Ours, the paper's method, the paper's figure, the wanted figure, met or not; below, why those are not met."""
    if not rows:
        return f"{board.name} has no {FILE}: no figure is wanted of it"
    head = ("figure", "ours", "its method", "paper", "wanted", "met")
    lines = [f"{board.name}: SIMULATED{', quick: not the figures of the README' if quick else ''}"]
    played = [row for row in rows if row.ours is not None or not quick]  # the quick subset leaves out whole sets
    cells = []
    for row in played:
        found = row.figure
        numbers = (row.ours, found.method if found else None, found.paper if found else None)
        name = row.wanted.name + (f", {row.wanted.unit}" if row.wanted.unit else "")
        met = "yes" if row.wanted.is_met(row.ours) else "NO" if row.ours is not None else "NO: not measured"
        cells.append((name, *(_text(n) for n in numbers), row.wanted.text, met))
    lines += aligned(head, cells, "  ")
    unmet = [row for row in played if not row.wanted.is_met(row.ours)]
    left_out = f"; not in the quick subset: {len(rows) - len(played)}" if quick else ""
    lines.append(f"  met: {len(played) - len(unmet)} of {len(played)}{left_out}")
    lines += [f"  not met, {row.wanted.name}: {row.wanted.reason(quick=quick) or 'NO REASON STATED'}" for row in unmet]
    return "\n".join(lines)


def _text(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.3g}"
