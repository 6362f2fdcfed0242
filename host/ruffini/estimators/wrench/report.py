"""`ruffini cal report` of a wrench made of features: its tables on a log, as numbers and as an HTML page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import MAX_WRENCH_ERROR, Gate, failed, gates_in, gates_of_reference
from ruffini.calibrate.log.touches import file_sha256
from ruffini.calibrate.log.warmth import celsius_ranges
from ruffini.calibrate.report.fewer_presses import accuracy_in
from ruffini.calibrate.report.page import AXES as LABELS
from ruffini.calibrate.report.page import about, fewer_presses_table, range_table, report_head
from ruffini.estimators.base import Report
from ruffini.estimators.wrench.fit import Fit
from ruffini.estimators.wrench.log import FeatureRun, read_feature_runs
from ruffini.estimators.wrench.model import AXES, Frames, frames_of
from ruffini.estimators.wrench.tables import map_in
from ruffini.rig.log_file import read_log
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
MOST_LISTED = 12  # recordings


class WrenchReport(NamedTuple):
    """`tree` is the JSON; said and true (t, 6) of every frame, N and N mm, NaN where not measured."""

    tree: dict[str, Any]
    gates: list[Gate]
    said: Array
    true: Array


def wrench_report(
    board: Board,
    file: CalibrationFile,
    paths: list[Path],
    previous: CalibrationFile | None,
    judged: Sequence[str] = AXES,
) -> Report:
    """As an estimator gives it; `judged`: the axes that a log which was not fitted has to load. Raises as below."""
    made = wrench_report_of(board, file, paths, previous=previous, judged=judged)
    told = [f"{name} {axis['rmse']:.3g}" for name, axis in made.tree["axes"].items() if axis["rmse"] is not None]
    text = f"off by {', '.join(told)} RMS (N, N mm) over {made.tree['log']['touches']} loads"
    return Report(made.tree, made.gates, text, lambda path: write_wrench_page(path, file, made))


def wrench_report_of(
    board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
    judged: Sequence[str] = AXES,
) -> WrenchReport:  # fmt: skip
    """Judge a wrench's tables on logs or recordings, those that it was fitted to or others.

    Raises
    ------
    InputError
        Nothing to read, or another board's.
    """
    runs = read_feature_runs(paths, board)
    said, frames = _said(file, runs)
    logs = [read_log(path) for path in paths if path.suffix == ".h5"]
    sources = {path.name: file_sha256(path) for path in paths}
    in_the_fit = all(sha in file.metadata.get("residuals", "") for sha in sources.values())
    rmse, full = _rms(said, frames), np.abs(frames.wrench).max(axis=0)
    gates = gates_of_reference([dict(log.found) for log in logs])
    if in_the_fit:  # what its stages found on what was left out
        gates += [g for g in gates_in(file) or [] if g.name not in {gate.name for gate in gates}]
    else:
        rows = zip(AXES, rmse, full, strict=True)
        gates += [_gate(name, e / f) for name, e, f in rows if name in judged and e is not None and f > 0]
    tree = {
        "board": board.name, "calibration": about(file),
        "log": {"files": sources, "touches": len(np.unique(frames.run)), "frames": len(said), "in_the_fit": in_the_fit,
                "simulated": any(log.facts.get("rig") == "sim" for log in logs)},
        "passed": not failed(gates), "gates": [gate._asdict() for gate in gates],
        "previous": None if previous is None else dict(zip(AXES, _rms(*_said(previous, runs)), strict=True)),
        "axes": {name: {"rmse": e, "largest": float(f)}
                 for name, e, f in zip(AXES, rmse, full, strict=True)},
        "accuracy_of_presses": accuracy_in(file, "wrench") if in_the_fit else [],
        "valid_for": {
            **{name: [float(v.min()), float(v.max())]
               for name, v in zip(AXES, frames.wrench.T, strict=True) if v.any()},
            "temperature_c": celsius_ranges(touch.facts for log in logs for touch in log.touches),
        },
    }  # fmt: skip
    return WrenchReport(tree, gates, said, frames.wrench)


def _said(file: CalibrationFile, runs: list[FeatureRun]) -> tuple[Array, Frames]:
    """What a file's tables make of the features (t, 6), NaN where not measured, beside the reference."""
    found, frames = map_in(file), frames_of(runs, _lag_s(file))
    return np.where(found.full > 0, found.predicted(frames), np.nan), frames


def _rms(said: Array, frames: Frames) -> list[float | None]:
    error = np.sqrt(np.mean((said - frames.wrench) ** 2, axis=0))
    error[~frames.wrench.any(axis=0)] = np.nan  # the reference measured nothing along it
    return [None if np.isnan(e) else float(e) for e in error]


def _lag_s(file: CalibrationFile) -> float:
    """Of the reference behind the pictures, as the fit found it."""
    said = json.loads(file.metadata.get("residuals", "{}"))
    return 1e-3 * float(said.get("stages", {}).get("wrench", said).get("lag_ms", 0.0))


def _gate(name: str, part: float) -> Gate:
    return Gate(f"wrench {name}", bool(part <= MAX_WRENCH_ERROR), float(part), MAX_WRENCH_ERROR,
                f"{100 * part:.2g} % of its largest load: RMS, at most {100 * MAX_WRENCH_ERROR:g} %")  # fmt: skip


def wrench_table(fit: Fit) -> str:
    """Errors of a fit on what was left out, axis by axis, and what else it found, for a person."""
    lines = [f"  errors on {fit.left_out} that were not fitted, against the reference (K alone: RMSE):"]
    columns = (np.abs(fit.map.full), fit.linear_rmse, fit.rmse, fit.mae, fit.r2)
    lines += aligned(("", "range", "K alone", "RMSE", "MAE", "R2", "", ""), [
        (
            axis, *(f"{column[i]:.3g}" for column in columns), "N" if i < 3 else "N mm",
            ", ".join(name for name, axes in fit.terms.items() if axis in axes) if fit.map.full[i]
            else "not measured: the log hardly loads it",
        )
        for i, axis in enumerate(AXES)
    ], indent="  ")  # fmt: skip
    for name, (rmse, mae) in fit.by_recording.items() if len(fit.by_recording) < MOST_LISTED else ():
        lines.append(f"  {name}: RMSE {_listed(rmse)}; MAE {_listed(mae)}")
    if fit.kernel:
        lines.append(f"  nonlinear: a {fit.kernel} kernel of landmarks beside K")
    lines += [f"  not stated: {what} (no untouched frames)" for what in fit.not_stated]
    if fit.leaning:
        lines.append(f"  {', '.join(fit.leaning)} lean on the pad's mechanics (the board's inverse FEM, shifts alone)")
    warmth = fit.map.warmth
    lines.append(
        f"  temperature: no term, {fit.report()['temperature']}" if warmth is None else
        f"  temperature: corrected from {warmth.coldest:.1f} to {warmth.warmest:.1f} C, about {warmth.reference:.1f} C"
    )  # fmt: skip
    return "\n".join(lines)


def _listed(values: Array) -> str:
    return " ".join(f"{v:.3g}" for v in values)


def write_wrench_page(path: Path, file: CalibrationFile, report: WrenchReport) -> None:
    """Everything that a person needs to say yes or no."""
    import matplotlib

    matplotlib.use("Agg")
    tree = report.tree
    page = report_head(file, tree, report.gates, f"{tree['log']['frames']} frames of {tree['log']['touches']} loads")
    page.heading("Error of each axis, all frames")
    axes = tree["axes"].values()
    errors = {"RMS": [a["rmse"] for a in axes]}
    if tree["previous"]:
        errors["RMS of the previous calibration"] = list(tree["previous"].values())
    rows = [(name, *("not measured" if e is None else e for e in row)) for name, row in errors.items()]
    page.table(("", *LABELS), [*rows, ("largest load", *(a["largest"] for a in axes))])
    page.picture(_picture(report), "wrench said against the reference, axis by axis")
    fewer_presses_table(page, tree["accuracy_of_presses"])
    page.heading("Valid for")
    range_table(page, dict(zip(AXES, LABELS, strict=True)), tree["valid_for"])
    page.write(path)


def _picture(report: WrenchReport) -> Any:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(10, 5.4))
    for axis, label, said, true in zip(axes.ravel(), LABELS, report.said.T, report.true.T, strict=True):
        axis.plot(true, said, ".", markersize=3)
        axis.plot([true.min(), true.max()], [true.min(), true.max()], color="black", linewidth=0.6)
        axis.set(xlabel=f"reference {label}", ylabel="sensor")
        axis.set_title("not measured" if np.isnan(said).all() else "", fontsize="medium")
        axis.grid(alpha=0.3)
    figure.tight_layout()
    return figure
