"""ruffini cal fit --only wrench."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import JsonFlag, emit_judged, note, note_start, progress_bar
from ruffini.tables import aligned

MOST_LISTED = 12  # recordings

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ruffini.calibrate.log.columns import Columns
    from ruffini.estimators.softness.model import Softness
    from ruffini.estimators.wrench.fit import Fit


ColumnsOption = Annotated[
    Path | None, typer.Option("--columns", help="TOML file that names the columns of a log from elsewhere.")
]
TimeOption = Annotated[str | None, typer.Option("--time", help="Column of time, seconds.")]
FeaturesOption = Annotated[
    list[str] | None, typer.Option("--features", help="Column or dataset of features; * matches; repeatable.")
]
UnitOption = Annotated[str | None, typer.Option("--unit", help="Of displacements: px, mm, um or m.")]
WrenchOption = Annotated[
    str | None, typer.Option("--wrench", help="Dataset of six columns, or six names with commas: fx to tz.")
]
WrenchUnitOption = Annotated[str | None, typer.Option("--wrench-unit", help="Of forces and torques (N,Nm).")]
TouchOption = Annotated[str | None, typer.Option("--touch", help="Column that numbers the touches.")]
RecordingOption = Annotated[str | None, typer.Option("--recording", help="Column that numbers the recordings.")]


def columns_of(
    columns: Path | None, time: str | None, features: list[str] | None, unit: str | None, wrench: str | None,
    wrench_unit: str | None, touch: str | None, recording: str | None,
) -> Columns | None:  # fmt: skip
    """Columns named on the command line, over those of the file; None where nothing is named."""
    from dataclasses import asdict

    from ruffini.calibrate.log.columns import Columns

    said = {
        "time": time, "features": features, "unit": unit, "wrench": wrench.split(",") if wrench else None,
        "wrench_unit": wrench_unit.split(",") if wrench_unit else None, "touch": touch, "recording": recording,
    }  # fmt: skip
    said = {name: value for name, value in said.items() if value}
    if columns is None and not said:
        return None
    return Columns.of({**(asdict(Columns.read(columns)) if columns else {}), **said}, "the command line")


def wrench(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG...",
            help="HDF5 or CSV with named columns, frames with wrench.csv, a folder of "
            "such recordings, or a log of cal collect.",
        ),
    ] = None,
    log: Annotated[list[Path] | None, typer.Option("--log", help="The same; repeatable.")] = None,
    board: Annotated[
        str | None, typer.Option("--board", help="Board name, or a folder with a board.toml; not needed with columns.")
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", help="Calibration file to write, for `cal file merge` or `cal flash`.")
    ] = Path("wrench.safetensors"),
    holdout: Annotated[
        str | None,
        typer.Option(
            help="Judge on each recording, touch or block of time left out (default: recording; of a single one block)."
        ),
    ] = None,
    columns: ColumnsOption = None,
    time: TimeOption = None,
    features: FeaturesOption = None,
    unit: UnitOption = None,
    wrench_columns: WrenchOption = None,
    wrench_unit: WrenchUnitOption = None,
    touch: TouchOption = None,
    recording: RecordingOption = None,
    prior: Annotated[
        bool, typer.Option("--prior/--no-prior", help="Of markers: lean on the pad's mechanics where that helps.")
    ] = True,
    nonlinear: Annotated[
        bool, typer.Option("--nonlinear/--linear", help="Of many features: try kernels, kept where they err less.")
    ] = True,
    videos: Annotated[
        Path | None,
        typer.Option(
            help="LOG are videos, or folders of them, with a CSV of a load cell beside each; this TOML file names its "
            "columns. Needs --board."
        ),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="JSON of the report.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit a wrench to targets, markers or any named columns beside a force sensor; judged on what was left out."""
    note_start("cal fit --only wrench", board)
    from ruffini.boards import find_board
    from ruffini.calibrate.gates import write_judged
    from ruffini.calibrate.log.columns import read_column_logs
    from ruffini.calibrate.log.videos import VideoColumns, read_video_log
    from ruffini.errors import InputError
    from ruffini.estimators.softness.model import fit_softness, gel_pa_of, grid_of
    from ruffini.estimators.wrench.fit import fit_wrench_map
    from ruffini.estimators.wrench.log import Features, features_of, read_feature_runs
    from ruffini.estimators.wrench.marker_prior import marker_prior
    from ruffini.estimators.wrench.model import recordings_of
    from ruffini.estimators.wrench.stage import WRENCH
    from ruffini.estimators.wrench.tables import tables
    from ruffini.estimators.wrench.target_geometry import second_order_of
    from ruffini.files import write_whole

    paths = [*(logs or []), *(log or [])]
    if not paths:
        raise InputError("no log: give files or folders")
    named = columns_of(columns, time, features, unit, wrench_columns, wrench_unit, touch, recording)
    if videos is not None and named is not None:
        raise InputError(f"--videos {videos} names the columns of the CSV files: leave --columns and the options that "
                         "name columns out, or --videos")  # fmt: skip
    if videos is not None and board is None:
        raise InputError("--videos needs --board: the features of a video are those that its board computes")
    found = find_board(board) if board else None
    softness = None
    if named is not None:
        read = read_column_logs(paths, named)
        runs, sort = read.runs, Features("columns", len(read.names))
        for line in read.remarks:
            note(line)
        if found is not None:
            sort = features_of(found)
            if sort.n != len(read.names):
                raise InputError(f"{paths[0]}: has {len(read.names)} features, board {found.name!r} makes {sort.n} of "
                                 f"its {sort.sort}: another sensor, or leave --board out")  # fmt: skip
    elif videos is not None and found is not None:
        with progress_bar("videos") as progress:
            of_videos = VideoColumns.read(videos)
            log_of_videos = read_video_log(paths, found, of_videos, progress=progress)
        runs, sort = log_of_videos.runs, features_of(found)
        for line in log_of_videos.remarks:
            note(line)
        of_videos.check_names(run.recording for run in runs)
        if of_videos.squeeze_n is not None:
            softness = fit_softness(runs, grid_of(found), of_videos.rigid, of_videos.squeeze_n, gel_pa_of(found),
                                    of_videos.modulus_pa)  # fmt: skip
    elif found is None:
        raise InputError(f"{paths[0]}: name its columns (--columns FILE, or --time, --features, --wrench), or --board "
                         "for a recording of one of its sensors")  # fmt: skip
    else:
        with progress_bar("frames") as progress:
            runs, sort = read_feature_runs(paths, found, progress=progress), features_of(found)
    fit = fit_wrench_map(
        runs,
        holdout=holdout or ("recording" if len(set(recordings_of(runs))) > 1 else "block"),
        bend=second_order_of(found) if found else None,
        prior=marker_prior(found) if found and prior else None,
        nonlinear=nonlinear,
        grid=sort.grid if videos is None else None,  # the size tells one kind of object, and videos are of several
    )
    for line in fit.checks:
        note(line)
    if found is not None and not WRENCH.is_used(found):
        note(f"board {found.name!r} has no stage that makes a wrench of features: it would not use this table")
    tensors, metadata = tables(fit, sort)
    residuals = json.loads(metadata["residuals"])
    if softness is not None:
        tensors |= softness.tables()
        residuals["softness"] = softness.report()
    gates = write_judged(out, WRENCH.name, WRENCH.gates(fit.report(), found), found, tensors, residuals, metadata)
    left_out = residuals["left_out"]
    said = {"file": str(out), **fit.report(), "left_out": left_out, "gates": [gate._asdict() for gate in gates]}
    if softness is not None:
        said["softness"] = softness.report()
    if report is not None:
        write_whole(report, json.dumps(said, indent=1).encode())
    emit_judged(said, gates, json_, "\n".join([_text(out, fit), *_softness_text(softness),
                                                *(f"  left out: {line}" for line in left_out)]))  # fmt: skip


def _softness_text(found: Softness | None) -> list[str]:
    if found is None:
        return []
    return [
        f"  softness of squeezes from {found.low_n:g} to {found.high_n:g} N: squeezes of one object differ by "
        f"{100 * (2**found.sigma - 1):.0f} % (standard deviation); the gel's scale: {found.gel_pa / 1000:.3g} kPa"
    ]


def _text(out: Path, fit: Fit) -> str:
    import numpy as np

    from ruffini.estimators.wrench.model import AXES

    lines = [
        f"{out}: {fit.n_frames} frames of {fit.n_runs} recordings, reference {1e3 * fit.lag_s:.1f} ms behind the "
        f"pictures, condition number {fit.condition:.1f}",
        f"  errors on {fit.left_out} that were not fitted, against the reference (K alone: RMSE):",
    ]
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


def _listed(values: npt.NDArray[np.float64]) -> str:
    return " ".join(f"{v:.3g}" for v in values)
