"""ruffini reproduce: a paper's bench on the twin, its own method, and its experiment with ours beside it."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, NamedTuple

import typer

from ruffini.cli.common import BoardOption, JsonFlag, WorkersOption, emit, n_workers_of, note, progress_bar
from ruffini.errors import InputError
from ruffini.older_python import StrEnum

PAPER_BENCH = "reproduce.toml"


class Use(NamedTuple):
    """What is done with measured figures."""

    is_frozen: bool
    is_checked: bool


class Part(StrEnum):
    """What of a paper is played."""

    EXPERIMENT = "experiment"
    METHOD = "method"
    RECORDINGS = "recordings"


def reproduce(
    board: Annotated[
        str | None,
        typer.Argument(metavar="BOARD", help="Board name, or a folder. --only method: every board with a paper."),
    ] = None,
    only: Annotated[
        Part,
        typer.Option(help="experiment: ours beside the paper's. method: the paper's own. recordings: its presses."),
    ] = Part.EXPERIMENT,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for results or recordings; the same command goes on with it.")
    ] = None,
    bench: Annotated[
        str, typer.Option(help="Of --only recordings: another bench in the board's folder.")
    ] = PAPER_BENCH,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Where recordings are kept (default: the user's cache).")
    ] = None,
    network: Annotated[
        Path | None, typer.Option("--network", help="Of `ruffini train stereo`: judged beside ours.")
    ] = None,
    freeze: Annotated[bool, typer.Option("--freeze", help="Write the figures to the board's frozen.toml.")] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Compare the figures with frozen.toml: exit code 1 if one is worse.")
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer runs: not the figures of the README.")] = False,
    workers: WorkersOption = None,
    json_: JsonFlag = False,
) -> None:
    """Play the bench of the board's paper on the twin: tables and figures, ours beside the paper's. SIMULATED."""
    note(f"reproduce: the {only} of {board or 'every board'} on the SIMULATED sensor")
    use, n_workers = Use(freeze, check), n_workers_of(workers)
    if only is Part.METHOD:
        _method(board, recordings, use, quick, n_workers, json_)
        return
    if board is None or out is None:
        raise InputError(f"reproduce --only {only} needs a BOARD and a folder --out: name both")
    if only is Part.RECORDINGS:
        if freeze or check:
            raise InputError("--only recordings has no figures: leave --freeze and --check out")
        _record(board, out, bench, quick, n_workers, json_)
    else:
        _experiment(board, out, recordings, network, use, quick, n_workers, json_)


def sim_reproduce(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out")],
    bench: Annotated[str, typer.Option()] = PAPER_BENCH,
    quick: Annotated[bool, typer.Option("--quick")] = False,
    workers: WorkersOption = None,
    json_: JsonFlag = False,
) -> None:
    """`reproduce --only recordings` under its former name."""
    reproduce(board, Part.RECORDINGS, out, bench, quick=quick, workers=workers, json_=json_)


def papers_of_bench(
    board: Annotated[str | None, typer.Option("--board")] = None,
    recordings: Annotated[Path | None, typer.Option("--recordings")] = None,
    freeze: Annotated[bool, typer.Option("--freeze")] = False,
    quick: Annotated[bool, typer.Option("--quick")] = False,
    workers: WorkersOption = None,
    json_: JsonFlag = False,
) -> None:
    """`reproduce --only method` under its former name."""
    reproduce(
        board, Part.METHOD, None, PAPER_BENCH, recordings, freeze=freeze, quick=quick, workers=workers, json_=json_
    )


def papers(name: str) -> ModuleType:
    """A module of host/papers, which no wheel has. Raises InputError where it is not there."""
    try:
        return importlib.import_module(f"papers.{name}")
    except ModuleNotFoundError as error:
        if error.name not in ("papers", f"papers.{name}"):
            raise
        raise InputError(
            "the papers' methods are not part of this package: run this in a clone of ruffini's repository, "
            "where host/papers has them (`--only recordings` works here)"
        ) from error


def _method(board: str | None, folder: Path | None, use: Use, quick: bool, n_workers: int, as_json: bool) -> None:
    if folder is not None and board is None:
        raise InputError("--recordings are of one board: name it")
    judged, guard = papers("judged"), papers("guard")
    from ruffini.boards import board_names, boards_folder, find_board

    with_paper = [name for name in board_names() if (boards_folder() / name / "reproduce.toml").is_file()]
    results, texts, checks = [], [], []
    for one in map(find_board, [board] if board else with_paper):
        with progress_bar(one.name) as progress:
            result = judged.run(one, quick=quick, folder=folder, n_workers=n_workers, progress=progress)
        if use.is_checked:
            checks.append(guard.check_method(result, judged.load_frozen(one)))
            result["check"] = checks[-1].tree()
        if use.is_frozen:
            result["frozen"] = bool(judged.freeze(one, result))
        results.append(result)
        texts.append("\n".join([judged.table(result), *([checks[-1].text()] if use.is_checked else [])]))
    emit({"simulated": True, "boards": results}, as_json, "\n\n".join(texts))
    _end(checks)


def _end(checks: list[Any]) -> None:
    if any(not check.is_passed for check in checks):
        raise typer.Exit(1)


def _record(board: str, out: Path, bench: str, quick: bool, n_workers: int, as_json: bool) -> None:
    from ruffini.boards import find_board
    from ruffini.sim.reproduce.make import reproduce as make

    with progress_bar("runs") as progress:
        outcome = make(find_board(board), out, bench=bench, quick=quick, n_workers=n_workers, progress=progress)
    for key, reason in outcome.failed.items():
        note(f"{key} is left out: {reason}")
    result = {"folder": str(out), "made": outcome.n_made, "kept": outcome.n_kept, "failed": outcome.failed,
              "simulated": True}  # fmt: skip
    left = f", {len(outcome.failed)} left out" if outcome.failed else ""
    emit(result, as_json, f"{out}: {outcome.n_made} runs made, {outcome.n_kept} were there{left}, SIMULATED")


def _experiment(
    board: str,
    out: Path,
    recordings: Path | None,
    network: Path | None,
    use: Use,
    quick: bool,
    n_workers: int,
    as_json: bool,
) -> None:
    experiments, guard, judged, wanted = (papers(name) for name in ("experiments", "guard", "judged", "wanted"))
    import json

    from ruffini.boards import find_board
    from ruffini.files import write_whole

    one = find_board(board)
    wanted.load_wanted(one)  # before the minutes
    with progress_bar("experiment") as progress:
        options = experiments.Options(recordings, quick, n_workers, progress, network)
        found = experiments.reproduce(one, out, options)
    rows = wanted.rows_of(one, found.figures)
    figures = [row.tree(quick=quick) for row in rows]
    result = {**found.result, "pictures": [str(path) for path in found.pictures], "figures": figures}
    texts, checks = [found.text, wanted.table(one, rows, quick=quick)], []
    if use.is_checked:
        checks.append(guard.check_ours(rows, judged.load_frozen(one), quick=quick))
        result["check"] = checks[0].tree()
        texts.append(checks[0].text())
    if use.is_frozen:
        ours = {row.wanted.name: row.ours for row in rows if row.ours is not None}
        texts.append(f"frozen: {judged.freeze_ours(one, ours, quick=quick)}")
    write_whole(out / "result.json", json.dumps(result, indent=1).encode())
    emit(result, as_json, "\n\n".join(texts))
    _end(checks)
