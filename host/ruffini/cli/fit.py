"""ruffini cal fit: a calibration from a log of touches."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import JsonFlag, emit_judged, note, note_start, progress_bar
from ruffini.errors import InputError

if TYPE_CHECKING:
    from ruffini.calibrate.fit.job import Outcome


# Names of the release before: of stages, of their verbs' options, and what stands in for options that are gone.
OLD_STAGES = {"touch": "threshold"}
OLD_OPTIONS = {("fingertip", "--only"): "--pattern"}
GONE_OPTIONS = {
    ("contact", "--report"): "`--json` prints the report, > FILE keeps it",
    ("skin", "--method"): "skins are fitted by taxels alone, so leave it out",
    ("skin", "--most-n"): "it was of --method paper, and skins are fitted by taxels alone, so leave it out",
}


def fit(
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG...", help="Logs of `cal collect`, recordings, or folders of presses."),
    ] = None,
    board: Annotated[
        str | None, typer.Option("--board", help="Board name or folder. Default: that of --previous.")
    ] = None,
    previous: Annotated[
        Path | None,
        typer.Option(
            "--previous",
            "--calibration",
            help="Calibration before: what is not fitted is kept, and few presses are enough.",
        ),
    ] = None,
    fleet: Annotated[
        Path | None, typer.Option("--prior", help="File of `cal fleet`: what units are like, for stage material.")
    ] = None,
    balls: Annotated[Path | None, typer.Option(help="Ball presses, as of `cal fit --only photometric`.")] = None,
    given: Annotated[
        list[Path] | None,
        typer.Option("--with", help="File of `cal fit --only camera` or `cal fit --only photometric` to build on."),
    ] = None,
    points: Annotated[
        Path | None, typer.Option(help="Known points of a tube's lens (CSV: x_px, y_px, z_mm along the tube).")
    ] = None,
    baseline_mm: Annotated[
        float | None, typer.Option("--baseline-mm", help="Distance between the eyes of a fingertip.")
    ] = None,
    pattern: Annotated[str, typer.Option(help="Of the folders of presses that a fingertip is fitted to.")] = "*",
    skip: Annotated[list[str] | None, typer.Option(help="Stage to leave out; may be given again.")] = None,
    only: Annotated[
        str | None,
        typer.Option(help="One stage alone, added to --previous; with --help the options of a stage that has its own."),
    ] = None,
    strain: Annotated[str, typer.Option(help="finite for a real pad, or linear.")] = "linear",
    touches: Annotated[int, typer.Option(min=0, help="Simulated touches behind the stated uncertainty.")] = 120,
    serial: Annotated[str, typer.Option("--unit", help="Serial number of the sensor that it is for.")] = "*",
    more_logs: Annotated[list[Path] | None, typer.Option("--log", "--presses", hidden=True)] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit what the board needs, stage after stage, to a log; the file carries its gates."""
    note_start("cal fit", board)
    from ruffini.boards import find_board
    from ruffini.calibrate import container, keys
    from ruffini.calibrate.fit.job import Job
    from ruffini.calibrate.fit.run import finished, run_stages
    from ruffini.calibrate.gates import failed
    from ruffini.estimators.material.prior import read_prior
    from ruffini.estimators.table import BY_NAME, need_prior_stage

    if strain not in ("linear", "finite"):
        raise InputError(f"--strain {strain!r}: choose linear or finite")
    paths = [*(logs or []), *(more_logs or [])]
    if not paths:
        raise InputError("no log: give logs, recordings or folders of presses")
    if only in OLD_STAGES:
        note(f"stage {only} is now called {OLD_STAGES[only]}")
        only = OLD_STAGES[only]
    if only is not None and only not in BY_NAME:
        raise InputError(f"--only {only!r}: there is no such stage; there are {', '.join(BY_NAME)}")
    before = None if previous is None else keys.read_verified(previous)
    if before is None and board is None:
        raise InputError("no board: give --board, or --previous with a calibration of it")
    found = container.board_of(before, board) if before is not None else find_board(board or "")
    if fleet is not None:
        need_prior_stage(found, only, frozenset(skip or []))
    job = Job(
        found, paths, before,
        [keys.read_verified(path) for path in given or []], balls, None if fleet is None else read_prior(fleet, found),
        is_finite=strain == "finite", n_error_touches=touches, points=points, baseline_mm=baseline_mm, pattern=pattern,
        only=only,
    )  # fmt: skip
    for file in job.parts:
        container.check_board(file, found)
    if only is not None and not BY_NAME[only].applies(found):
        note(f"the stages of board {found.name!r} do not use what stage {only} makes")
    start = time.monotonic()
    with progress_bar("fit") as bar:
        outcomes = run_stages(job, frozenset(skip or []), tell=teller(), progress=lambda _, done: bar(done))
        file, gates = finished(job, outcomes, serial)
    container.write(out, file)
    bad = failed(gates)
    details = "".join(f"\n{text}" for name, o in outcomes.items() if (text := BY_NAME[name].details(o.report)))
    emit_judged(
        {"file": str(out), "board": found.name, "kinds": file.kinds,
         "seconds": time.monotonic() - start, "passed": not bad,
         "stages": {name: {"state": o.state, "text": o.text, **o.report} for name, o in outcomes.items()}},
        gates, json_,
        f"{out}: {', '.join(file.kinds)} from {', '.join(path.name for path in paths)}"
        + ("" if bad else "; passes its gates") + details,
    )  # fmt: skip


def of_old_options(stage: str, words: list[str]) -> list[str]:
    """The words after an old verb `cal STAGE`, with today's names of its options, which are printed.

    Raises
    ------
    InputError
        An option is gone; the text says what to use.
    """
    out = []
    for word in words:
        option, *value = word.split("=", 1)
        if text := GONE_OPTIONS.get((stage, option)):
            raise InputError(f"{option} of `cal {stage}` is gone: {text}")
        if new := OLD_OPTIONS.get((stage, option)):
            note(f"{option} of `cal {stage}` is now {new}")
            option = new
        out.append("=".join([option, *value]))
    return out


def teller() -> Callable[[str, Outcome, float], None]:
    """Says each stage as it ends."""

    def tell(name: str, outcome: Outcome, seconds: float) -> None:
        note(f"{name}: {outcome.state}, {outcome.text} ({seconds:.1f} s)")

    return tell
