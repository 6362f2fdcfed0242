"""Verbs that judge the device's arithmetic on anybody's data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, progress_bar

app = typer.Typer(no_args_is_help=True, help="Judge markers, depth and flow on your own recordings.")
PictureOption = Annotated[Path | None, typer.Option("--out", help="Picture (PNG).")]


@app.callback()
def evaluate() -> None:
    """What the device computes, against a truth that it did not make."""


@app.command("markers")
def markers(
    video: Annotated[Path, typer.Argument(help="Video file, or folder of images; it starts untouched.")],
    board: BoardOption,
    fields: Annotated[int, typer.Option(min=1, help="Known fields that the first frame is moved by.")] = 20,
    out: PictureOption = None,
    json_: JsonFlag = False,
) -> None:
    """The marker tracker: known warps beside Lucas-Kanade, noise at rest, identity, frames left out or shuffled."""
    from ruffini.boards import find_board
    from ruffini.evaluate import markers as judge
    from ruffini.frames import read_frames

    found = find_board(board)
    frames = list(read_frames(video))
    with progress_bar("markers") as progress:
        result, tracks = judge.evaluate(found, frames, n_fields=fields, progress=progress)
    text = judge.table(result)
    if out is not None:
        from ruffini.evaluate.pictures import marker_tracks

        result["picture"] = str(marker_tracks(out, frames, tracks, result))
        text += f"\n{out}"
    emit(result, json_, text)
