"""The main job as one verb."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, note


def demo(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Folder for recordings, tables and pictures.")] = Path("out/run"),
    video: Annotated[Path | None, typer.Option("--input", help="A real recording in place of the twin.")] = None,
    presses: Annotated[
        Path | None, typer.Option("--presses", help="Ball presses for the real recording's colours.")
    ] = None,
    ball_mm: Annotated[float, typer.Option(help="Ball of --presses, where its folder does not say.")] = 4.70,
    px_per_mm: Annotated[float, typer.Option(help="Scale of --presses, where its folder does not say.")] = 19.58,
    json_: JsonFlag = False,
) -> None:
    """The whole path once: recording, calibration, ruffinid, flash, live field, pictures, judgement."""
    note(f"demo: board {board}, {'SIMULATED' if video is None else f'recording {video}'}, results in {out}")
    from ruffini.demo.main_job import RealInput, run_real, run_twin

    if video is None:
        run_twin(board, out, as_json=json_)
    else:
        run_real(board, out, RealInput(video, presses, ball_mm, px_per_mm), as_json=json_)
