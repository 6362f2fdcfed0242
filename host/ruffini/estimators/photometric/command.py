"""`cal fit --only photometric`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ruffini.estimators.command import Command


@dataclass(frozen=True)
class PhotometricOptions:
    """What the presses were made with, and how the camera saw them."""

    ball_mm: Annotated[float | None, typer.Option(help="Diameter of the ball (default: presses.toml).")] = None
    px_per_mm: Annotated[float | None, typer.Option(help="Scale of the images (default: presses.toml).")] = None
    truth: Annotated[
        Path | None, typer.Option(help="CSV of contact circles (default: DIR/presses.csv; without one they are found).")
    ] = None
    camera: Annotated[
        Path | None,
        typer.Option(help="File of `cal fit --only camera`: where each pixel looks, in place of board.toml's pinhole."),
    ] = None
    dark: Annotated[
        Path | None,
        typer.Option(
            help="File of `cal fit --only dark`, where the sensor will have it too: give both to `cal flash`."
        ),
    ] = None
    foreign: Annotated[
        bool,
        typer.Option("--foreign", help="The presses come from other optics than the board's: z stays UNCALIBRATED."),
    ] = False
    source: Annotated[
        str,
        typer.Option(help="colour (side light: colours -> slopes), intensity (a skin that darkens -> depth), or auto."),
    ] = "auto"
    report: Annotated[
        Path | None,
        typer.Option(help="HTML page, and JSON beside it, with every press judged by a table fitted without it."),
    ] = None


COMMAND = Command(
    "photometric",
    "Fit colour change -> surface slope, or brightness -> depth, on ball presses of known size.",
    logs="Ball presses: reference.png, images.",
    metavar="DIR",
    options=PhotometricOptions,
    former_verb="photometric",
)
