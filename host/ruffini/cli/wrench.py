"""ruffini cal wrench."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar

if TYPE_CHECKING:
    from ruffini.calibrate.wrench_map import Fit


def wrench(
    log: Annotated[
        list[Path],
        typer.Option(
            "--log", help="Frames with wrench.csv, a folder of such recordings, or a log of cal collect; repeatable."
        ),
    ],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write, for `cal merge` or `cal flash`.")],
    holdout: Annotated[
        str, typer.Option(help="What is left out to judge the fit: whole recordings, or single touches.")
    ] = "recording",
    prior: Annotated[
        bool, typer.Option("--prior/--no-prior", help="Of markers: lean on the pad's mechanics where that helps.")
    ] = True,
    report: Annotated[Path | None, typer.Option(help="JSON of the report.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit the wrench of the board's targets or markers to a reference sensor; errors on what was not fitted."""
    note(f"cal wrench: board {board}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.calibrate.feature_log import features_of, read_feature_runs
    from ruffini.calibrate.marker_prior import marker_prior
    from ruffini.calibrate.target_geometry import second_order_of
    from ruffini.calibrate.wrench_map import fit_wrench_map
    from ruffini.calibrate.wrench_tables import tables
    from ruffini.files import write_whole

    found = find_board(board)
    with progress_bar("frames") as progress:
        runs = read_feature_runs(log, found, progress=progress)
    mechanics = marker_prior(found) if prior else None
    fit = fit_wrench_map(runs, holdout=holdout, bend=second_order_of(found), prior=mechanics)
    for line in fit.checks:
        note(line)
    if "feature_wrench" not in found.pipeline.stages:
        note(f"board {found.name!r} has no stage feature_wrench: it would not use this table")
    tensors, metadata = tables(fit, features_of(found))
    container.write(out, container.pack(tensors, {**container.base_metadata(found), **metadata}))
    said = {"file": str(out), **fit.report()}
    if report is not None:
        write_whole(report, json.dumps(said, indent=1).encode())
    emit(said, json_, _text(out, fit))


def _text(out: Path, fit: Fit) -> str:
    from ruffini.calibrate.wrench_model import AXES

    lines = [
        f"{out}: {fit.n_frames} frames of {fit.n_runs} recordings, reference {1e3 * fit.lag_s:.1f} ms behind the "
        f"pictures, condition number {fit.condition:.1f}",
        f"  RMSE on {fit.left_out} that were not fitted, against the reference:",
        f"  {'':4}{'range':>10}{'K alone':>10}{'RMSE':>10}{'R2':>8}",
    ]
    for i, axis in enumerate(AXES):
        unit = "N" if i < 3 else "N mm"
        extra = ", ".join(name for name, axes in fit.terms.items() if axis in axes)
        state = extra if fit.map.full[i] else "not measured: the log hardly loads it"
        lines.append(
            f"  {axis:4}{abs(fit.map.full[i]):>10.3g}{fit.linear_rmse[i]:>10.3g}{fit.rmse[i]:>10.3g}{fit.r2[i]:>8.3f}"
            f"  {unit}{'  ' + state if state else ''}"
        )
    if fit.leaning:
        lines.append(f"  {', '.join(fit.leaning)} lean on the pad's mechanics (the board's inverse FEM, shifts alone)")
    warmth = fit.map.warmth
    lines.append(
        f"  temperature: no term, {fit.report()['temperature']}" if warmth is None else
        f"  temperature: corrected from {warmth.coldest:.1f} to {warmth.warmest:.1f} C, about {warmth.reference:.1f} C"
    )  # fmt: skip
    return "\n".join(lines)
