"""The verb that plays a paper's bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar


def reproduce(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Folder; run the same command again to go on with it.")],
    bench: Annotated[str, typer.Option(help="Another bench of that form in the board's folder.")] = "reproduce.toml",
    quick: Annotated[bool, typer.Option("--quick", help="The quick subset: the same runs, fewer of them.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes of this machine.")] = 1,
    json_: JsonFlag = False,
) -> None:
    """The presses of the board's paper, from its reproduce.toml, as recordings with what the bench read."""
    note(f"sim reproduce: the presses of {board}'s paper, recordings in {out}")
    from ruffini.boards import find_board
    from ruffini.sim.reproduce.make import reproduce as make

    with progress_bar("runs") as progress:
        outcome = make(find_board(board), out, bench=bench, quick=quick, n_workers=workers, progress=progress)
    for key, reason in outcome.failed.items():
        note(f"{key} is left out: {reason}")
    result = {"folder": str(out), "made": outcome.n_made, "kept": outcome.n_kept, "failed": outcome.failed,
              "simulated": True}  # fmt: skip
    left = f", {len(outcome.failed)} left out" if outcome.failed else ""
    emit(result, json_, f"{out}: {outcome.n_made} runs made, {outcome.n_kept} were there{left}, SIMULATED")
