"""ruffini reproduce."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit, note, progress_bar


def reproduce(
    board: Annotated[str, typer.Argument(metavar="BOARD", help="Board name, or a folder with a board.toml.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for tables and pictures.")],
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Where recordings are kept (default: the user's cache).")
    ] = None,
    network: Annotated[
        Path | None, typer.Option("--network", help="Of `ruffini train stereo`: judged beside ours.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer runs: not the figures of the README.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes of this machine.")] = 1,
    json_: JsonFlag = False,
) -> None:
    """Play the experiment of the board's paper on the twin: its tables and figures, ours beside the paper's."""
    note(f"reproduce: the experiments of {board}'s paper on its SIMULATED sensor, results in {out}")
    import json

    from ruffini.bench.experiments import Options
    from ruffini.bench.experiments import reproduce as play
    from ruffini.boards import find_board
    from ruffini.files import write_whole

    with progress_bar("experiment") as progress:
        found = play(find_board(board), out, Options(recordings, quick, workers, progress, network))
    result = {**found.result, "pictures": [str(path) for path in found.pictures]}
    write_whole(out / "result.json", json.dumps(result, indent=1).encode())
    emit(result, json_, found.text)
