"""`make gels`: force of gels without markers, collected and judged by `ruffini cal auto --quick`. SIMULATED.

    python tests/bench/gels.py                              # every such board that has a twin
    python tests/bench/gels.py --board ninedtact --table docs/results/accuracy.md

--table replaces the board's row in the section SECTION of that document, once the run is through.
"""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.calibrate.report.fewer_presses import Figures, Numbers, accuracy_of_presses
from ruffini.errors import InputError
from ruffini.estimators.wrench.fit import fit_wrench_map
from ruffini.estimators.wrench.log import features_of, read_feature_runs
from ruffini.estimators.wrench.model import AXES, frames_of
from ruffini.files import write_whole
from ruffini.sim.settings import twin_names

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

SECTION = "## Gels without markers, from a bench"
COLUMNS = (
    "board",
    "largest force",
    "touches left out, all frames",
    "fresh presses, while held",
    "fitted to 5, 10 presses, the others judged",
    "commit",
    "date",
)
NORMAL = AXES.index("Fz")
SIZES = (5, 10)  # presses
# The code that the figures depend on: commits of anything else change none.
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/gels.py", ":!*.md")


class Row(NamedTuple):
    """Figures of one board: newtons, errors RMS; `fewer` one for each of SIZES, None where no fit came of it."""

    board: str
    largest: float
    left_out: float
    fresh: float
    fewer: list[float | None]

    def text(self, at: str, date: str) -> str:
        """The row in Markdown."""
        fewer = ", ".join("not fitted" if n is None else f"{n:.3f}" for n in self.fewer)
        cells = (self.board, f"{self.largest:.2f} N", f"{self.left_out:.3f}", f"{self.fresh:.3f}", fewer, at, date)
        return f"| {' | '.join(cells)} |"


def boards() -> list[str]:
    """Boards that measure force by the change of a picture, and have a twin."""
    return [name for name in twin_names() if find_board(name).picture_features is not None]


def measured(name: str, folder: Path) -> Row:
    """Run `cal auto` into an empty folder."""
    command = [str(Path(sys.executable).parent / "ruffini"), "cal", "auto", "--board", name, "--rig", "sim", "--quick",
               "--json", "--out", str(folder)]  # fmt: skip
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)} ended with exit code {done.returncode}: no row is written")
    fewer = of_fewer(find_board(name), folder / "fitted.h5")
    said = container.residuals(container.read(folder / "calibration.safetensors"))
    return row_of(json.loads(done.stdout), said, fewer)


def row_of(result: dict[str, Any], residuals: dict[str, Any], fewer: list[float | None]) -> Row:
    """The row of a run: its result, and what the fit wrote into the calibration."""
    after = result["after"]
    left_out = residuals["stages"]["wrench"]["axes"]["Fz"]["rmse"]
    return Row(result["board"], after["largest_force_n"], left_out, after["axes_rmse_n_nm"][NORMAL], fewer)


def of_fewer(board: Board, log: Path) -> list[float | None]:
    """Error of the normal force on presses of a log by fits to SIZES of the others, N RMS over three draws."""
    runs, grid = read_feature_runs([log], board), features_of(board).grid

    def error(used: Numbers, left: Numbers) -> Figures:
        fit = fit_wrench_map([runs[i] for i in used], holdout="touch", nonlinear=True, grid=grid)
        frames = frames_of([runs[i] for i in left], fit.lag_s)
        off = (fit.map.predicted(frames) - frames.wrench)[:, NORMAL]
        return {"normal_n": float(np.sqrt(np.mean(off**2)))}

    rows = accuracy_of_presses(len(runs), error, sizes=SIZES)
    return [row.get("normal_n") for row in rows]


def with_row(text: str, row: str, section: str = SECTION, columns: Sequence[str] = COLUMNS) -> str:
    """The document with the row in its section's table, in place of the one with the same first cell.

    Raises
    ------
    InputError
        It has no such section, or the section no table of these columns.
    """
    lines = text.splitlines()
    head = f"| {' | '.join(columns)} |"
    if section not in lines or head not in lines[lines.index(section) :]:
        raise InputError(f"the document has no section {section!r} with a table {head!r}: add them")
    first = lines.index(head, lines.index(section)) + 2  # after the line of dashes
    end = next((i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines))
    name = row.split(" | ")[0]
    place = next((i for i in range(first, end) if lines[i].split(" | ")[0] == name), None)
    lines[slice(end, end) if place is None else slice(place, place + 1)] = [row]
    return "\n".join(lines) + "\n"


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", choices=boards(), action="append", help="one board; may be repeated")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    given = parser.parse_args(words)
    for name in given.board or boards():
        with tempfile.TemporaryDirectory(prefix=f"{name}-") as made:
            at = commit(JUDGED)  # as it was when the run began
            row = measured(name, Path(made)).text(at, datetime.date.today().isoformat())
        print(row, flush=True)
        if given.table is not None:
            write_whole(given.table, with_row(given.table.read_text(), row).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
