"""ruffini cal report: how well a calibration measures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit_judged, note, note_start, progress_bar


def report(
    calibration: Annotated[Path, typer.Argument(metavar="CAL", help="Calibration file.")],
    logs: Annotated[list[Path], typer.Option("--log", help="Log to judge it on; may be given again.")],
    out: Annotated[Path, typer.Option("--out", help="HTML page to write; its numbers as .json beside it.")],
    previous: Annotated[Path | None, typer.Option(help="Calibration to compare with.")] = None,
    fleet: Annotated[Path | None, typer.Option("--prior", help="File of `cal fleet`.")] = None,
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Judge a calibration on a log: gates, residuals, coverage, accuracy against presses, as one page and JSON."""
    note_start("cal report", board)
    from ruffini.calibrate import container
    from ruffini.calibrate.gates import failed
    from ruffini.calibrate.report.fewer_presses import accuracy_text
    from ruffini.errors import InputError
    from ruffini.estimators.material.prior import read_prior
    from ruffini.estimators.table import reported_by
    from ruffini.files import write_whole

    file = container.read(calibration)
    found = container.board_of(file, board)
    before = None if previous is None else container.read(previous)
    if before is not None:
        container.check_board(before, found)
    judge = reported_by(file)
    if fleet is not None and not judge.takes_prior:
        raise InputError(
            f"--prior {fleet}: the numbers of a fleet's pads are of no use to the report of stage {judge.name}: leave "
            "the option out"
        )
    with progress_bar("report") as progress:
        made = judge.report(
            found, file, logs, previous=before, fleet=None if fleet is None else read_prior(fleet, found),
            progress=progress,
        )  # fmt: skip
    made.write_page(out)
    for row in made.tree["accuracy_of_presses"]:
        note(accuracy_text(row))
    write_whole(out.with_suffix(".json"), json.dumps(made.tree, indent=1).encode() + b"\n")
    text = f"{out}: {made.text}" + ("" if failed(made.gates) else "; passes its gates")
    emit_judged({"page": str(out), **made.tree}, made.gates, json_, text)
