"""ruffini cal report: how well a calibration measures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import JsonFlag, emit, note, progress_bar

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.calibrate.container import CalibrationFile
    from ruffini.calibrate.gates import Gate


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
    note(f"cal report: board {board}")
    from ruffini.calibrate import container
    from ruffini.calibrate.log.touches import read_touch_log
    from ruffini.calibrate.report.judged import report_of
    from ruffini.calibrate.report.page import write_page
    from ruffini.estimators.material.prior import read_prior

    file = container.read(calibration)
    found = container.board_of(file, board)
    before = None if previous is None else container.read(previous)
    if before is not None:
        container.check_board(before, found)
    if "skin" in file.kinds:
        return _of_skin(found, file, logs, out, before, json_)
    if "wrench" in file.kinds:
        return _of_wrench(found, file, logs, out, before, json_)
    with progress_bar("report") as progress:
        log = read_touch_log(logs, found, file, progress=lambda done: progress(0.2 * done))
        made = report_of(
            found, file, log, previous=before, fleet=None if fleet is None else read_prior(fleet, found),
            progress=lambda done: progress(0.2 + 0.8 * done),
        )  # fmt: skip
    write_page(out, found, file, made)
    off = f"force off by {1e3 * made.tree['wrench']['force_rmse_n']:.1f} mN RMS over {log.n_touches} touches"
    _say(out, made.tree, made.gates, off, json_)


def _of_skin(
    board: Board, file: CalibrationFile, logs: list[Path], out: Path, previous: CalibrationFile | None, json_: bool
) -> None:
    """A skin that glows where it is pressed: force and place, by its pictures."""
    from ruffini.estimators.skin.report import skin_report_of, write_skin_page

    with progress_bar("report") as progress:
        made = skin_report_of(board, file, logs, previous=previous, progress=progress)
    write_skin_page(out, file, made)
    off = f"force off by {made.tree['skin']['force_rmse_n']:.2f} N RMS over {made.tree['log']['touches']} touches"
    _say(out, made.tree, made.gates, off, json_)


def _of_wrench(
    board: Board, file: CalibrationFile, logs: list[Path], out: Path, previous: CalibrationFile | None, json_: bool
) -> None:
    """A wrench made of features: each axis, on logs or recordings."""
    from ruffini.estimators.wrench.report import wrench_report_of, write_wrench_page

    made = wrench_report_of(board, file, logs, previous=previous)
    write_wrench_page(out, file, made)
    told = [f"{name} {axis['rmse']:.3g}" for name, axis in made.tree["axes"].items() if axis["rmse"] is not None]
    off = f"off by {', '.join(told)} RMS (N, N mm) over {made.tree['log']['touches']} loads"
    _say(out, made.tree, made.gates, off, json_)


def _say(out: Path, tree: dict[str, Any], gates: list[Gate], off: str, json_: bool) -> None:
    """The numbers beside the page, one line, and exit code 1 where a gate fails."""
    from ruffini.calibrate.gates import failed
    from ruffini.calibrate.report.fewer_presses import accuracy_text
    from ruffini.files import write_whole

    for row in tree["accuracy_of_presses"]:
        note(accuracy_text(row))
    write_whole(out.with_suffix(".json"), json.dumps(tree, indent=1).encode() + b"\n")
    bad = failed(gates)
    verdict = "FAILS " + "; ".join(f"{g.name}: {g.text}" for g in bad) if bad else "passes its gates"
    emit({"page": str(out), **tree}, json_, f"{out}: {off}; {verdict}")
    if bad:
        raise typer.Exit(1)
