"""`make gels`: force of gels without markers, collected and judged by `ruffini cal auto --quick`. SIMULATED.

    python tests/bench/gels.py                              # every such board that has a twin
    python tests/bench/gels.py --board ninedtact --table docs/results/accuracy.md
    python tests/bench/gels.py --board fibre-skin --tips    # indenters left out of the fit, beside plain peers

--table replaces the board's row in the section SECTION (with --tips: TIPS) of that document, once the run is through.
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
import numpy.typing as npt

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.calibrate.report.fewer_presses import Figures, Numbers, accuracy_of_presses
from ruffini.core import Pipeline
from ruffini.core.feature_wrench import wrench_on_board
from ruffini.errors import InputError
from ruffini.estimators.wrench.fit import fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun, features_of, read_feature_runs
from ruffini.estimators.wrench.model import AXES, frames_of
from ruffini.estimators.wrench.tables import tables
from ruffini.files import write_whole
from ruffini.sim.contact import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.settings import twin_names
from ruffini.sim.unit import TwinUnit

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
TIPS = "## Indenters left out of the fit"
TIP_COLUMNS = ("board", "largest force", "MAE", "ridge", "kernel ridge", "within one / two sigma", "untouched",
               "commit", "date")  # fmt: skip
NORMAL = AXES.index("Fz")
# What of_tips presses: radius in mm; at each place a touch to at most DEEPEST_M after N_FREE pictures without contact.
TIPS_PRESSED = (("sphere", 2.0), ("sphere", 3.2), ("sphere", 4.5), ("flat", 1.5), ("flat", 2.2), ("cone", 2.5))
N_PLACES, N_STEPS, N_FREE, PLACED, DEEPEST_M = 4, 8, 8, 0.45, 0.9e-3
CELL_N, LEAST_N, UNTOUCHED_S = 5e-3, 0.02, 5.0  # noise of the load cell; smallest force that is judged
RATE_HZ = 30.0  # of the untouched rows that the core is given
WEIGHTS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
Array = npt.NDArray[np.float64]
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
    """Boards that make a force of the change of a picture, and have a twin."""
    return [name for name in twin_names() if find_board(name).writes("features") and is_of_picture(find_board(name))]


def is_of_picture(board: Board) -> bool:
    """True if the features are numbers over a grid that need no tables."""
    features = features_of(board)
    return features.is_of_gel and not features.needs_tables


class Tips(NamedTuple):
    """Force of indenters left out of the fit, MAE in newtons; shares of errors within one and two sigma; untouched."""

    board: str
    largest: float
    ours: float
    ridge: float
    kernel_ridge: float
    within: tuple[float, float]
    untouched: float  # largest force in UNTOUCHED_S without contact

    def text(self, at: str, date: str) -> str:
        """The row in Markdown."""
        within = " / ".join(f"{100 * share:.0f} %" for share in self.within)
        errors = (f"{mae:.3f}" for mae in (self.ours, self.ridge, self.kernel_ridge))
        cells = (self.board, f"{self.largest:.2f} N", *errors, within, f"{self.untouched:.3f}", at, date)
        return f"| {' | '.join(cells)} |"


def of_tips(board: Board) -> tuple[list[FeatureRun], Array]:
    """Touches of every tip on the twin, a recording for each tip, and untouched features after them."""
    unit, rng = TwinUnit.build(board), np.random.default_rng(17)
    renderer, rows = unit.renderer(), list[FeatureRun]()
    half = 0.5e-6 * np.array([board.pad.size_x_um, board.pad.size_y_um])
    with Pipeline(board) as core:
        time_s = 0.0

        def frame(displacement: Array) -> Array:
            nonlocal time_s
            time_s += unit.frame_s
            core.process(renderer.image(displacement, rng, time_s=time_s))
            return core.features() if has_rest else np.zeros(0)

        has_rest = False
        for _ in range(board.pipeline.n_rest_frames + 1):
            frame(unit.at_rest())
        has_rest = True
        for k, (shape, radius_mm) in enumerate(TIPS_PRESSED):
            for place in range(N_PLACES):
                x, y = half * PLACED * rng.uniform(-1, 1, 2)
                rig = unit.rig()
                seen, force = [frame(unit.at_rest()) for _ in range(N_FREE)], [0.0] * N_FREE
                rig.take(Indenter(shape, 1e-3 * radius_mm))
                for depth_m in np.linspace(0, DEEPEST_M * rng.uniform(0.7, 1), N_STEPS + 1)[1:]:
                    rig.advance(Pose(float(x), float(y), float(depth_m)))
                    seen.append(frame(rig.displacement))
                    force.append(float(rig.wrench()[2]))
                when = time_s + unit.frame_s * np.arange(-len(seen), 0)
                wrench = np.zeros((len(seen), 6))
                wrench[:, 2] = np.array(force) + rng.normal(0, CELL_N, len(seen))
                rows.append(FeatureRun(f"{shape} {radius_mm}/{place}", when, np.array(seen, float),
                                       np.ones(len(seen), bool), when, wrench, touch=np.full(len(seen), len(rows)),
                                       recording=f"tip {k}", kind=f"{shape} {radius_mm}"))  # fmt: skip
        still = np.array([frame(unit.at_rest()) for _ in range(round(UNTOUCHED_S / unit.frame_s))])
    return rows, still


def judged(board: Board, rows: list[FeatureRun], still: Array) -> Tips:
    """Each tip by a fit to the others; the core computes force and uncertainty."""
    features, errors = features_of(board), list[Array]()
    peers, untouched, largest = ([], []), 0.0, max(float(np.abs(run.reference[:, 2]).max()) for run in rows)
    for tip in dict.fromkeys(run.kind for run in rows):
        inside, outside = ([run for run in rows if (run.kind == tip) == is_left] for is_left in (False, True))
        fit = fit_wrench_map(inside, holdout="recording", nonlinear=True, grid=features.grid, is_of_gel=True)
        tensors, metadata = tables(fit, features)
        x, y = (np.concatenate([run.features for run in outside]), np.concatenate([r.reference[:, 2] for r in outside]))
        given = container.pack(tensors, {**container.base_metadata(board), **metadata})
        said = [wrench_on_board(given.data, features.sort, run.features, run.time_s) for run in outside]
        force, sigma = (np.concatenate([part[:, NORMAL] for part in parts])
                        for parts in ([one.wrench for one in said], [one.sigma for one in said]))  # fmt: skip
        errors.append(np.stack([force - y, sigma], axis=1)[np.abs(y) > LEAST_N])
        at_rest = wrench_on_board(given.data, features.sort, still, np.arange(len(still)) / RATE_HZ)
        untouched = max(untouched, float(np.abs(at_rest.wrench[:, NORMAL]).max()))
        a, b = np.concatenate([r.features for r in inside]), np.concatenate([r.reference[:, 2] for r in inside])
        kinds = list(dict.fromkeys(r.kind for r in inside))
        groups = np.concatenate([np.full(len(r.time_s), kinds.index(r.kind)) for r in inside])
        for found, peer in zip(peers, (ridge_peer, kernel_peer), strict=True):
            found.append((peer(a, b, groups, x) - y)[np.abs(y) > LEAST_N])
    off = np.concatenate(errors)
    within = tuple(float(np.mean(np.abs(off[:, 0]) <= n * off[:, 1])) for n in (1, 2))
    mae = [float(np.abs(np.concatenate(found)).mean()) for found in peers]
    return Tips(board.name, largest, float(np.abs(off[:, 0]).mean()), *mae, (within[0], within[1]), untouched)


def ridge_peer(a: Array, b: Array, groups: Array, x: Array) -> Array:
    """Ridge regression without a constant, its penalty by groups (tips) left out."""
    scale = a.std()

    def solved(a: Array, b: Array, weight: float) -> Array:
        return np.asarray(np.linalg.solve(a.T @ a + weight * len(a) * scale**2 * np.eye(a.shape[1]), a.T @ b))

    best = min(WEIGHTS, key=lambda w: sum(
        float(np.square(a[groups == g] @ solved(a[groups != g], b[groups != g], w) - b[groups == g]).sum())
        for g in np.unique(groups)))  # fmt: skip
    return np.asarray(x @ solved(a, b, best))


def kernel_peer(a: Array, b: Array, groups: Array, x: Array) -> Array:
    """Kernel ridge regression with a Gaussian kernel, penalty and length by groups (tips) left out."""
    spread = float(np.sqrt(a.var(axis=0).sum()))

    def kernel(p: Array, q: Array, length: float) -> Array:
        square = (p * p).sum(axis=1)[:, None] + (q * q).sum(axis=1) - 2 * p @ q.T
        return np.asarray(np.exp(-np.maximum(square, 0) / (2 * (length * spread) ** 2)))

    def predicted(a: Array, b: Array, x: Array, weight: float, length: float) -> Array:
        return np.asarray(kernel(x, a, length) @ np.linalg.solve(kernel(a, a, length) + weight * np.eye(len(a)), b))

    best = min(((w, length) for w in WEIGHTS for length in (1.0, 3.0, 10.0)), key=lambda way: sum(
        float(np.square(predicted(a[groups != g], b[groups != g], a[groups == g], *way) - b[groups == g]).sum())
        for g in np.unique(groups)))  # fmt: skip
    return predicted(a, b, x, *best)


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
    parser.add_argument("--tips", action="store_true", help="judge indenters left out, beside plain peers")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    given = parser.parse_args(words)
    for name in given.board or boards():
        with tempfile.TemporaryDirectory(prefix=f"{name}-") as made:
            at = commit(JUDGED)  # as it was when the run began
            board = find_board(name)
            found = judged(board, *of_tips(board)) if given.tips else measured(name, Path(made))
            row = found.text(at, datetime.date.today().isoformat())
        print(row, flush=True)
        if given.table is not None:
            section, columns = (TIPS, TIP_COLUMNS) if given.tips else (SECTION, COLUMNS)
            write_whole(given.table, with_row(given.table.read_text(), row, section, columns).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
