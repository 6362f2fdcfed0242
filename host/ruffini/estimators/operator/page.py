"""The report of forces by finite elements as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.report.page import AXES, range_table, report_head
from ruffini.estimators.operator.report import ForceReport

UNITS = np.array([1, 1, 1, 1e3, 1e3, 1e3])


def write_page(path: Path, board: Board, file: CalibrationFile, report: ForceReport) -> None:
    """Everything that a person needs to say yes or no."""
    import matplotlib

    matplotlib.use("Agg")
    tree = report.tree
    page = report_head(file, tree, report.gates, f"{tree['log']['touches']} touches")
    page.heading("Error of each touch, on the board's integers")
    rows = {"this calibration, RMS": "rmse_n_nm", "what the sensor said meanwhile, RMS": "as_the_sensor_said_n_nm"}
    page.table(("", *AXES), [(name, *_row(tree["wrench"][key])) for name, key in rows.items()])
    page.picture(_residuals(report), "error of each touch against the reference, axis by axis")
    if tree["left_out"]:
        f = tree["left_out"]
        page.text(f"Each touch by a pad fitted to the others: {1e3 * f['force_rmse_n']:.1f} mN RMS, "
                  f"{1e3 * f['force_p95_n']:.1f} mN for 95 % of them, size {100 * (f['gain'] - 1):+.1f} %, "
                  f"largest force {f['largest_force_n']:.2f} N.")  # fmt: skip
    if tree["previous"]:
        page.text(f"The previous calibration errs by {1e3 * tree['previous']['force_rmse_n']:.1f} mN RMS on the same "
                  f"touches, this one by {1e3 * tree['wrench']['force_rmse_n']:.1f} mN.")  # fmt: skip
    if len(tree["accuracy_of_presses"]) > 1:
        page.heading("Accuracy against the number of presses")
        page.picture(_curve(tree["accuracy_of_presses"]), "force error against number of presses")
    page.heading("Where it was pressed, and how far off each touch is")
    page.picture(_map(board, report), "places of the touches on the pad")
    page.heading("Valid for")
    names = {"depth_mm": "depth, mm", "normal_force_n": "normal force, N", "shear_force_n": "shear force, N",
             "x_mm": "x, mm", "y_mm": "y, mm"}  # fmt: skip
    range_table(page, names, tree["valid_for"])
    page.write(path)


def _row(values: list[float | None]) -> list[Any]:
    return ["not measured" if v is None else v * float(u) for v, u in zip(values, UNITS, strict=True)]


def _residuals(report: ForceReport) -> Any:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(10, 5.4))
    for i, (axis, label) in enumerate(zip(axes.ravel(), AXES, strict=True)):
        true = report.reference[:, i] * UNITS[i]
        axis.plot(true, report.wrench[:, i] * UNITS[i] - true, ".", color="tab:blue")
        axis.axhline(0, color="black", linewidth=0.6)
        axis.set(xlabel=f"reference {label}", ylabel="measured - reference")
        axis.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def _curve(rows: list[dict[str, Any]]) -> Any:
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7, 3.4))
    n = [max(row["presses"], 0.5) for row in rows]
    for name, label in (("board", "from the board's numbers"), ("prior", "from what was known before")):
        if name in rows[0]:
            axis.plot(n, [1e3 * row[name] for row in rows], "o-", label=label)
    axis.set(xscale="log", xlabel="presses", ylabel="force error of the others, RMS, mN")
    axis.set_ylim(bottom=0)
    axis.set_xticks(n, [str(row["presses"]) for row in rows])
    axis.minorticks_off()
    axis.grid(alpha=0.3)
    axis.legend(frameon=False)
    figure.tight_layout()
    return figure


def _map(board: Board, report: ForceReport) -> Any:
    import matplotlib.pyplot as plt

    pad = board.pad
    half = np.array([pad.size_x_um, pad.size_y_um]) * 5e-4
    error = np.linalg.norm(np.nan_to_num((report.wrench - report.reference)[:, :3]), axis=1)
    figure, axis = plt.subplots(figsize=(6.4, 6.4 * half[1] / half[0] + 0.6))
    x_mm, y_mm, depth_mm = 1e3 * report.places.T
    shown = axis.scatter(x_mm, y_mm, c=1e3 * error, s=60 + 400 * depth_mm, edgecolors="black", linewidths=0.5)
    figure.colorbar(shown, label="force error, mN", shrink=0.6)
    axis.set(xlim=(-half[0], half[0]), ylim=(half[1], -half[1]), xlabel="x, mm", ylabel="y, mm", aspect="equal")
    figure.tight_layout()
    return figure
