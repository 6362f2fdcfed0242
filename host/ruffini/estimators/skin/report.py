"""`ruffini cal report` of a glowing skin: its calibration on a log's pictures, as numbers and as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import HARD_N, Gate, failed, gates_in, gates_of_reference
from ruffini.calibrate.log.touches import file_sha256
from ruffini.calibrate.log.warmth import celsius_ranges
from ruffini.calibrate.report.fewer_presses import accuracy_in
from ruffini.calibrate.report.page import about, fewer_presses_table, range_table, report_head
from ruffini.estimators.skin.judge import (
    OFF_X,
    PLACE_X,
    PLACE_Y,
    REFERENCE,
    SAID,
    TOUCH,
    gates_of_skin,
    judged_presses,
)
from ruffini.estimators.skin.log import read_skin_log
from ruffini.estimators.skin.presses import Progress

Array = npt.NDArray[np.float64]


class SkinReport(NamedTuple):
    """`tree` is the JSON; rows as of `judged_presses`."""

    tree: dict[str, Any]
    gates: list[Gate]
    rows: Array


def skin_report_of(
    board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
    progress: Progress = lambda _: None,
) -> SkinReport:  # fmt: skip
    """Judge a skin's calibration on logs, those that it was fitted to or others; raises as `judged_presses`."""
    logs = [read_skin_log(path, board) for path in paths]
    rows = judged_presses(board, file, paths, progress)
    sources = {path.name: file_sha256(path) for path in paths}
    in_the_fit = all(sha in file.metadata.get("residuals", "") for sha in sources.values())
    gates = [*gates_of_reference([dict(log.found) for log in logs]), *gates_of_skin(rows)]
    if in_the_fit:  # what its stages found on presses left out
        gates += [g for g in gates_in(file) or [] if g.name not in {gate.name for gate in gates}]
    warmth = celsius_ranges(touch.facts for log in logs for touch in log.touches)
    before = None if previous is None else skin_figures(judged_presses(board, previous, paths))
    tree = {
        "board": board.name, "calibration": about(file),
        "log": {"files": sources, "touches": len(np.unique(rows[:, TOUCH])), "frames": len(rows),
                "in_the_fit": in_the_fit, "simulated": any(log.facts.get("rig") == "sim" for log in logs)},
        "passed": not failed(gates), "gates": [gate._asdict() for gate in gates], "skin": skin_figures(rows),
        "previous": before,
        "accuracy_of_presses": accuracy_in(file, "skin") if in_the_fit else [],
        "valid_for": {
            "normal_force_n": _range(rows[:, REFERENCE]), "x_mm": _range(rows[:, PLACE_X]),
            "y_mm": _range(rows[:, PLACE_Y]), "temperature_c": warmth,
        },
    }  # fmt: skip
    return SkinReport(tree, gates, rows)


def skin_figures(rows: Array) -> dict[str, float | int | None]:
    """Errors of force and place over pressed pictures; a force above HARD_N as a part of it."""
    error_n, place_mm = rows[:, SAID] - rows[:, REFERENCE], np.linalg.norm(rows[:, OFF_X:], axis=1)
    is_hard, is_told = rows[:, REFERENCE] > HARD_N, np.isfinite(place_mm)
    part = np.abs(error_n / rows[:, REFERENCE])[is_hard]
    return {
        "force_rmse_n": float(np.sqrt(np.mean(error_n**2))),
        "force_error_percent": float(100 * part.mean()) if len(part) else None,
        "place_error_mm": float(place_mm[is_told].mean()) if is_told.any() else None,
        "untold": int((~is_told).sum()),
    }


def _range(values: Array) -> list[float]:
    return [float(values.min()), float(values.max())]


def write_skin_page(path: Path, file: CalibrationFile, report: SkinReport) -> None:
    """Everything that a person needs to say yes or no."""
    import matplotlib

    matplotlib.use("Agg")
    tree, figures = report.tree, report.tree["skin"]
    page = report_head(file, tree, report.gates, f"{tree['log']['touches']} touches")
    page.heading("Error of each pressed picture, on the board's integers")
    rows = [("this calibration", figures)] + ([("the previous", tree["previous"])] if tree["previous"] else [])
    keys = ("force_rmse_n", "force_error_percent", "place_error_mm", "untold")
    said = [(name, *("not measured" if f[k] is None else f[k] for k in keys)) for name, f in rows]
    page.table(("", "force, N RMS", f"force above {HARD_N:g} N, % mean", "place, mm mean", "not told"), said)
    page.picture(_errors(report.rows), "force said against the reference; how far off each place is")
    fewer_presses_table(page, tree["accuracy_of_presses"])
    page.heading("Valid for")
    names = {"normal_force_n": "force into the skin, N", "x_mm": "x, mm", "y_mm": "y, mm"}
    range_table(page, names, tree["valid_for"])
    page.write(path)


def _errors(rows: Array) -> Any:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    left.plot(rows[:, REFERENCE], rows[:, SAID], ".")
    top = float(max(rows[:, REFERENCE].max(), rows[:, SAID].max()))
    left.plot([0, top], [0, top], color="black", linewidth=0.6)
    left.set(xlabel="reference, N", ylabel="sensor, N")
    right.quiver(rows[:, PLACE_X], rows[:, PLACE_Y], rows[:, OFF_X], rows[:, OFF_X + 1], angles="xy",
                 scale_units="xy", scale=0.2)  # fmt: skip
    right.set(xlabel="x round the skin, mm", ylabel="y, mm", title="off by, five times as long")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    figure.tight_layout()
    return figure
