"""ruffini cal fit: a calibration from a log of touches, or of what one stage is fitted to."""

from __future__ import annotations

import dataclasses
import inspect
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from ruffini.cli.common import JsonFlag, StrainOption, emit_judged, is_finite, note, note_start, progress_bar
from ruffini.errors import InputError
from ruffini.estimators.command import Command
from ruffini.estimators.commands import command_named

if TYPE_CHECKING:
    from ruffini.calibrate.fit.job import Outcome

COMMON = ("out", "logs", "more_logs", "board", "previous", "json_")  # options of `fit` that every stage takes


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
        Path | None,
        typer.Option(
            "--prior",
            help="What other units are like, for few presses: file of `cal fleet` (stage material), or a calibration "
            "that was fitted to their logs (stage wrench).",
        ),
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
    strain: StrainOption = "linear",
    touches: Annotated[int, typer.Option(min=0, help="Simulated touches behind the stated uncertainty.")] = 120,
    serial: Annotated[str, typer.Option("--unit", help="Serial number of the sensor that it is for.")] = "*",
    more_logs: Annotated[list[Path] | None, typer.Option("--log", "--presses", hidden=True)] = None,
    json_: JsonFlag = False,
    options: Any = None,
) -> None:
    """Fit what the board needs, stage after stage, to a log; the file carries its gates."""
    note_start("cal fit" if only is None else f"cal fit --only {only}", board)
    from ruffini.boards import find_board
    from ruffini.calibrate import container, keys
    from ruffini.calibrate.fit.job import Job
    from ruffini.calibrate.fit.run import finished, run_stages, write_numbers
    from ruffini.calibrate.gates import failed
    from ruffini.estimators.material.prior import read_prior
    from ruffini.estimators.table import BY_NAME, need_prior_stage

    at_finite, command = is_finite(strain), command_named(only)
    if command is not None and only != command.name:
        note(f"stage {only} is now called {command.name}")
        only = command.name
    if only is not None and only not in BY_NAME:
        raise InputError(f"--only {only!r}: there is no such stage; there are {', '.join(BY_NAME)}")
    paths = [*(logs or []), *(more_logs or [])]
    if not paths and (command is None or options is None or command.logs):
        what = command.logs.rstrip(".") if command is not None and command.logs else "logs, recordings or ball presses"
        raise InputError(f"nothing to fit to: give {what}")
    before = None if previous is None else keys.read_verified(previous)
    found = container.board_of(before, board) if before is not None else find_board(board) if board else None
    if found is None and (command is None or command.needs_board):
        raise InputError("no board: give --board, or --previous with a calibration of it")
    is_calibration = fleet is not None and fleet.suffix == ".safetensors"
    if fleet is not None and found is not None:
        need_prior_stage(found, only, frozenset(skip or []), is_calibration=is_calibration)
    job = Job(
        found, paths, before, [keys.read_verified(path) for path in given or []], balls,
        None if fleet is None or found is None or is_calibration else read_prior(fleet, found),
        keys.read_verified(fleet) if fleet is not None and is_calibration else None, is_finite=at_finite,
        n_error_touches=touches, points=points, baseline_mm=baseline_mm, pattern=pattern, only=only, options=options,
    )  # fmt: skip
    for file in [*job.parts, *([job.other_units] if job.other_units else [])]:
        container.check_board(file, job.board)
    if only is not None and found is not None and not BY_NAME[only].is_used(found):
        note(f"the stages of board {found.name!r} do not use what step {only} makes")
    start = time.monotonic()
    with progress_bar("fit") as bar:
        tell = teller() if only is None else lambda *_: None
        outcomes = run_stages(job, frozenset(skip or []), tell=tell, progress=lambda _, done: bar(done))
        kinds: list[str] = []
        if only is not None and BY_NAME[only].makes_numbers:
            gates = write_numbers(out, job, outcomes[only])
        else:
            file, gates = finished(job, outcomes, serial)
            container.write(out, file)
            kinds = file.kinds
    for line in (line for outcome in outcomes.values() for line in outcome.remarks):
        note(line)
    bad = failed(gates)
    files = [str(path) for outcome in outcomes.values() for path in outcome.files]
    tables = [outcome.details for outcome in outcomes.values() if outcome.details]
    seconds = time.monotonic() - start
    if only is None:
        text = f"{', '.join(kinds)} from {', '.join(path.name for path in paths)}"
        text += "" if bad else "; passes its gates"
    else:
        text = f"{outcomes[only].text}; {seconds:.1f} s"
    result = {
        **({} if only is None else outcomes[only].report),
        "file": str(out), "board": None if found is None else found.name, "kinds": kinds, "bytes": out.stat().st_size,
        "files": files, "seconds": seconds, "passed": not bad,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,  # Linux counts in 1024 bytes
        "stages": {name: {"state": o.state, "text": o.text, **o.report} for name, o in outcomes.items()},
    }  # fmt: skip
    emit_judged(result, gates, json_, "\n".join([f"{out}: {text}", *tables, *files]))


def verb(command: Command | None = None) -> Callable[..., None]:
    """`cal fit`, or `cal fit --only NAME`: `fit` as Typer takes it, with the options of that stage.

    Those of its own replace those of `fit` that have their names.
    """
    taken = {
        name: one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, one in inspect.signature(fit, eval_str=True).parameters.items()
        if name != "options" and (command is None or name in (*COMMON, *command.shared))
    }
    own = () if command is None or command.options is None else dataclasses.fields(command.options)
    if command is not None and command.options is not None:
        if command.logs:
            argument = typer.Argument(metavar=command.metavar, help=command.logs)
            taken["logs"] = taken["logs"].replace(annotation=Annotated[list[Path] | None, argument])
        else:
            del taken["logs"], taken["more_logs"]
        hints = get_type_hints(command.options, include_extras=True)
    for one in own:
        default = inspect.Parameter.empty if one.default is dataclasses.MISSING else one.default
        kind = inspect.Parameter.KEYWORD_ONLY
        taken[one.name] = inspect.Parameter(one.name, kind, default=default, annotation=hints[one.name])

    def run(**values: Any) -> None:
        if command is None or command.options is None:
            fit(**values)
            return
        options = command.options(**{one.name: values[one.name] for one in own})
        theirs = {one.name for one in own} - {"out"}
        fit(**{k: v for k, v in values.items() if k not in theirs}, only=command.name, options=options)

    run.__doc__ = fit.__doc__ if command is None else command.help
    run.__signature__ = inspect.Signature([*taken.values()])  # type: ignore[attr-defined]
    run.__annotations__ = {name: one.annotation for name, one in taken.items()}
    return run


def click_command(command: Command) -> Any:
    """`cal fit --only NAME` of a stage with options of its own."""
    app = typer.Typer(add_completion=False)
    app.command(command.name)(verb(command))
    return typer.main.get_command(app)


class Fit(TyperCommand):
    """`cal fit`; after `--only STAGE` with the options of that stage."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        for i, word in enumerate(args):
            stage = word.removeprefix("--only=") if word.startswith("--only=") else "".join(args[i + 1 : i + 2])
            if word.partition("=")[0] == "--only" and (command := command_named(stage)) and command.options:
                rest = args[:i] + args[i + 1 + ("=" not in word) :]
                return click_command(command).make_context(f"fit --only {stage}", rest, parent=parent, **extra)
        return super().make_context(info_name, args, parent=parent, **extra)


class OldFit(Fit):
    """`cal VERB` of the release before: `cal fit --only STAGE`, which it prints."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        command = command_named(info_name)
        assert command is not None  # it is registered for each that has a former verb
        print(f"ruffini: `cal {info_name}` is now `ruffini cal fit --only {command.name}`", file=sys.stderr)
        words = ["--only", command.name, *of_old_options(command, args)]
        return super().make_context(info_name, words, parent=parent, **extra)


def of_old_options(command: Command, words: list[str]) -> list[str]:
    """The words after an old verb `cal STAGE`, with today's names of its options, which are printed.

    Raises
    ------
    InputError
        An option is gone; the text says what to use.
    """
    out = []
    for word in words:
        option, *value = word.split("=", 1)
        if text := command.gone_options.get(option):
            raise InputError(f"{option} of `cal {command.former_verb}` is gone: {text}")
        if new := command.former_options.get(option):
            note(f"{option} of `cal {command.former_verb}` is now {new}")
            option = new
        out.append("=".join([option, *value]))
    return out


def teller() -> Callable[[str, Outcome, float], None]:
    """Says each stage as it ends."""

    def tell(name: str, outcome: Outcome, seconds: float) -> None:
        note(f"{name}: {outcome.state}, {outcome.text} ({seconds:.1f} s)")

    return tell
