"""Verbs of the digital twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, progress_bar
from ruffini.errors import InputError

app = typer.Typer(no_args_is_help=True, help="The digital twin: simulated recordings with their truth.")


@app.callback()
def sim() -> None:
    """Simulated recordings with their truth."""


@app.command("press")
def press(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="New folder for the recording.")],
    program: Annotated[
        str, typer.Option(help="demo, grid (presses for judging) or balls (for cal photometric).")
    ] = "demo",
    n: Annotated[int, typer.Option("--n", help="Number of presses (grid, balls).")] = 40,
    seed: Annotated[int, typer.Option(help="Everything random follows from it.")] = 1,
    ball_mm: Annotated[float, typer.Option(help="Diameter of the calibration ball (balls).")] = 5.0,
    scale_modulus: Annotated[float, typer.Option(help="True modulus over the board's.")] = 1.0,
    scale_poisson: Annotated[float, typer.Option(help="True Poisson's ratio over the board's.")] = 1.0,
    scale_thickness: Annotated[float, typer.Option(help="True thickness over the board's.")] = 1.0,
    json_: JsonFlag = False,
) -> None:
    """Press the simulated pad and record frames and truth."""
    import numpy as np

    from ruffini.boards import find_board
    from ruffini.sim import programs
    from ruffini.sim.recording import PadError, TwinUnit, record_balls, record_touches

    if program not in ("demo", "grid", "balls"):
        raise InputError(f"unknown program {program!r}: demo, grid or balls")
    found = find_board(board)
    with progress_bar("pad mechanics") as progress:
        unit = TwinUnit.build(found, PadError(scale_modulus, scale_poisson, scale_thickness), progress=progress)
    with progress_bar("frames") as progress:
        if program == "balls":
            count = record_balls(unit, n, out, ball_mm=ball_mm, seed=seed, progress=progress)
        else:
            story = programs.demo(found) if program == "demo" else programs.grid(found, n, np.random.default_rng(seed))
            count = record_touches(unit, story, out, seed=seed, program=program, progress=progress)
    emit({"folder": str(out), "frames": count, "simulated": True}, json_, f"{out}: {count} frames, SIMULATED")
