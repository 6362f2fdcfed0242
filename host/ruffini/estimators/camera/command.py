"""`cal fit --only camera`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from ruffini.estimators.command import Command


@dataclass(frozen=True)
class CameraOptions:
    """The target, the lens, and where the camera looks."""

    target: Annotated[Literal["chessboard", "dots", "charuco"], typer.Option(help="What the pictures show.")]
    size: Annotated[str, typer.Option(help="Inner corners (chessboard), dots, or squares (ChArUco): COLUMNSxROWS.")]
    pitch_mm: Annotated[float, typer.Option(help="Distance of neighbouring points.")]
    fisheye: Annotated[bool, typer.Option("--fisheye", help="A fisheye lens.")] = False
    on_pad: Annotated[
        Path | None, typer.Option(help="Picture of the target lying on the pad: where the camera stands.")
    ] = None
    views: Annotated[
        str | None,
        typer.Option(help="Views side by side in a frame, left first, e.g. straight,straight or straight,mirrored."),
    ] = None
    index: Annotated[float, typer.Option(min=1.0, max=2.5, help="Refractive index of a clear pad.")] = 1.0
    dictionary: Annotated[str, typer.Option(help="ChArUco markers.")] = "4X4_50"


COMMAND = Command(
    "camera",
    "Fit lens, mounting and refraction to pictures of a flat target.",
    logs="Pictures of the target from several sides, or a folder.",
    metavar="IMAGES...",
    options=CameraOptions,
    former_verb="camera",
)
