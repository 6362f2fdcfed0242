"""`ruffini cal report` of a fingertip: its tables on presses of known tools, as numbers and as an HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import Gate
from ruffini.calibrate.log.touches import file_sha256
from ruffini.calibrate.log.warmth import celsius_ranges
from ruffini.calibrate.report.page import about, range_table, report_head
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.fingertip.fit import LEAST, TOUCHES
from ruffini.estimators.fingertip.log import press_roots
from ruffini.estimators.fingertip.presses import FORCE, PITCH, ROLL, WAY, Progress, X, Y, told_of
from ruffini.estimators.skin.presses import press_folders
from ruffini.frames import Frames

Array = npt.NDArray[np.float64]

NAMES = {"force_n": FORCE, "way_mm": WAY, "x_mm": X, "y_mm": Y, "roll_deg": ROLL, "pitch_deg": PITCH}
LABELS = ("force, N", "depth, mm", "x, mm", "y, mm", "roll, deg", "pitch, deg")
MOST = 1.05  # of full scale, that is judged


class Judged(NamedTuple):
    """Frames of presses: the number of the press (t,), and what sensor and bench say, (t, 7) as `Press.told`."""

    press: npt.NDArray[np.int64]
    said: Array
    true: Array

    def figures(self, *, is_simulated: bool) -> dict[str, Any]:
        """Means of absolute errors, of how many frames."""
        figures = figures_of(self.said, self.true, len(np.unique(self.press)))
        return figures if is_simulated else {**figures, "against": "the reference"}


def full_n(board: Board) -> float:
    """The force that a fingertip is made for."""
    return TOUCHES * board.contact.threshold_un * 1e-6


def is_judged(board: Board, true: Array) -> npt.NDArray[np.bool_]:
    """Frames (t,) that are neither too faint nor too hard."""
    part = true[:, FORCE] / full_n(board)
    return np.asarray((part > LEAST) & (part < MOST))


def judged_presses(board: Board, file: CalibrationFile, paths: list[Path], progress: Progress) -> Judged:
    """Play presses through the board's own integers.

    Raises
    ------
    InputError
        A file is not as it should be, or no press is of a force that counts.
    """
    folders, rows = [folder for path in paths for folder in press_folders(path)], []
    for number, folder in enumerate(folders):
        frames, said = Frames(folder / "frames"), list[Array]()
        true = told_of(folder, len(frames))[1]
        with Pipeline(board, file.data) as pipeline:
            for picture in frames:
                pipeline.process(picture)
                said.append(_said(pipeline))
        keep = is_judged(board, true)
        rows.append(Judged(np.full(keep.sum(), number), np.array(said)[keep], true[keep]))
        progress((number + 1) / len(folders))
    joined = Judged(*(np.concatenate(column) for column in zip(*rows, strict=True)))
    if not len(joined.press):
        raise InputError(f"{paths[0]}: no frame of a press is between {LEAST:g} and {MOST:g} of {full_n(board):g} N")
    return joined


def _said(pipeline: Pipeline) -> Array:
    """Of the last frame, (7,); NaN if nothing touches, and of the area."""
    tip = pipeline.tip()
    if not tip.is_touched:
        return np.full(7, np.nan)
    way_mm, x_mm, y_mm = (1e-3 * v for v in (tip.way_um, tip.x_um, tip.y_um))
    roll_deg, pitch_deg = (float(np.rad2deg(1e-6 * v)) for v in (tip.roll_urad, tip.pitch_urad))
    return np.array([1e-6 * tip.force_un, way_mm, x_mm, y_mm, roll_deg, pitch_deg, np.nan])


def tip_report_of(
    board: Board, file: CalibrationFile, paths: list[Path], previous: CalibrationFile | None, progress: Progress
) -> tuple[dict[str, Any], Judged]:
    """Everything but the gates; raises as `judged_presses`."""
    part, before = 1.0 if previous is None else 0.5, None
    with press_roots(paths, board) as roots:
        is_simulated = any((folder / "run.json").is_file() for root in roots for folder in press_folders(root))
        rows = judged_presses(board, file, roots, lambda done: progress(part * done))
        if previous is not None:
            earlier = judged_presses(board, previous, roots, lambda done: progress(part + (1 - part) * done))
            before = earlier.figures(is_simulated=is_simulated)
    sources = {path.name: file_sha256(path) for path in paths}
    ranges = {name: rows.true[:, column] for name, column in NAMES.items()}
    return {
        "board": board.name, "calibration": about(file),
        "log": {"files": sources, "touches": len(np.unique(rows.press)), "frames": len(rows.press),
                "in_the_fit": all(sha in file.metadata.get("residuals", "") for sha in sources.values()),
                "simulated": is_simulated},
        "fingertip": rows.figures(is_simulated=is_simulated), "previous": before, "accuracy_of_presses": [],
        "valid_for": {**{name: [float(v.min()), float(v.max())] for name, v in ranges.items()},
                      "temperature_c": celsius_ranges([])},
    }, rows  # fmt: skip


def write_tip_page(path: Path, file: CalibrationFile, tree: dict[str, Any], gates: list[Gate], rows: Judged) -> None:
    """Everything that a person needs to say yes or no."""
    import matplotlib

    matplotlib.use("Agg")
    page = report_head(file, tree, gates, f"{tree['log']['frames']} frames of {tree['log']['touches']} presses")
    page.heading("Means of absolute errors, on the board's integers")
    found = [("this calibration", tree["fingertip"])] + [("the previous", f) for f in (tree["previous"],) if f]
    page.table(("", "frames", "reported", *LABELS), [
        (name, f["frames"], f["told"], *(f["mean"][key] for key in NAMES)) for name, f in found
    ])  # fmt: skip
    page.picture(_picture(rows), "sensor against the bench, quantity by quantity")
    page.heading("Valid for")
    range_table(page, dict(zip(NAMES, LABELS, strict=True)), tree["valid_for"])
    page.write(path)


def _picture(rows: Judged) -> Any:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(10, 5.4))
    for axis, label, column in zip(axes.ravel(), LABELS, NAMES.values(), strict=True):
        true = rows.true[:, column]
        axis.plot(true, rows.said[:, column], ".", markersize=3)
        axis.plot([true.min(), true.max()], [true.min(), true.max()], color="black", linewidth=0.6)
        axis.set(xlabel=f"bench {label}", ylabel="sensor")
        axis.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def figures_of(said: Array, true: Array, n_presses: int) -> dict[str, Any]:
    """Means of absolute errors of the frames that are told."""
    told = np.isfinite(said[:, FORCE])
    off = np.abs(said - true)[told]
    mean = {name: float(off[:, column].mean()) if told.any() else float("nan") for name, column in NAMES.items()}
    return {
        "error": 1e3 * mean["force_n"], "touches": n_presses, "frames": len(said), "told": int(told.sum()),
        "mean": mean,
        "largest_force_n": float(true[:, FORCE].max()), "against": "the twin's truth",
    }  # fmt: skip
