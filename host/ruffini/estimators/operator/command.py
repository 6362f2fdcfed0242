"""`cal fit --only operator`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ruffini.estimators.command import Command


@dataclass(frozen=True)
class OperatorOptions:
    """How it is solved, what the displacement is off by, and what was measured of the pad."""

    method: Annotated[str, typer.Option(help="raw, ridge, optimal, or support (optimal with the second pass).")] = (
        "support"
    )
    noise_um: Annotated[str, typer.Option(help="Noise of the displacement along x,y,z, micrometres.")] = "5,5,20"
    gauge_um: Annotated[
        float | None,
        typer.Option(
            help="Uncertainty of the depth's free constant (optimal, support). Without: what the board's [depth] gauge "
            "is off by under simulated touches. Not for gauges by a table nor for depth from markers: they say it."
        ),
    ] = None
    tilt_um: Annotated[float, typer.Option(help="Uncertainty of the depth's tilt at the edge (optimal, support).")] = (
        30.0
    )
    weight: Annotated[
        str, typer.Option(help="ridge: w over the largest eigenvalue squared, or lcurve or cv to choose it.")
    ] = "1e-4"
    plot: Annotated[Path | None, typer.Option(help="ridge: picture (PNG) of the curves behind the weight.")] = None
    material: Annotated[
        Path | None, typer.Option(help="File of `cal fit --only material`: E, Poisson's ratio, thickness as measured.")
    ] = None
    relaxation: Annotated[
        Path | None,
        typer.Option(help="File of `cal fit --only relaxation`: what the pad loses under a held strain (support)."),
    ] = None


COMMAND = Command(
    "operator",
    "Solve the inverse FEM of a board and compile it to the board's integers.",
    options=OperatorOptions,
    shared=("strain", "touches"),
    former_verb="operator",
)
