"""`cal fit --only wrench`, and the options that name the columns of a log from elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.estimators.command import Command

if TYPE_CHECKING:
    from ruffini.calibrate.log.columns import Columns

ColumnsOption = Annotated[
    Path | None, typer.Option("--columns", help="TOML file that names the columns of a log from elsewhere.")
]
TimeOption = Annotated[str | None, typer.Option("--time", help="Column of time, seconds.")]
FeaturesOption = Annotated[
    list[str] | None, typer.Option("--features", help="Column or dataset of features; * matches; repeatable.")
]
UnitOption = Annotated[str | None, typer.Option("--unit", help="Of displacements: px, mm, um or m.")]
WrenchOption = Annotated[
    str | None, typer.Option("--wrench", help="Dataset of six columns, or six names with commas: fx to tz.")
]
WrenchUnitOption = Annotated[str | None, typer.Option("--wrench-unit", help="Of forces and torques (N,Nm).")]
TouchOption = Annotated[str | None, typer.Option("--touch", help="Column that numbers the touches.")]
RecordingOption = Annotated[str | None, typer.Option("--recording", help="Column that numbers the recordings.")]


def columns_of(
    columns: Path | None, time: str | None, features: list[str] | None, unit: str | None, wrench: str | None,
    wrench_unit: str | None, touch: str | None, recording: str | None,
) -> Columns | None:  # fmt: skip
    """Columns named on the command line, over those of the file; None where nothing is named."""
    from dataclasses import asdict

    from ruffini.calibrate.log.columns import Columns

    said = {
        "time": time, "features": features, "unit": unit, "wrench": wrench.split(",") if wrench else None,
        "wrench_unit": wrench_unit.split(",") if wrench_unit else None, "touch": touch, "recording": recording,
    }  # fmt: skip
    said = {name: value for name, value in said.items() if value}
    if columns is None and not said:
        return None
    return Columns.of({**(asdict(Columns.read(columns)) if columns else {}), **said}, "the command line")


@dataclass(frozen=True)
class WrenchOptions:
    """What the log's columns are, and how its fit is judged."""

    out: Annotated[
        Path, typer.Option("--out", help="Calibration file to write, for `cal file merge` or `cal flash`.")
    ] = Path("wrench.safetensors")
    holdout: Annotated[
        str | None,
        typer.Option(
            help="Left out to judge: each recording, touch or block of time (default: recording; of a single one block)"
        ),
    ] = None
    columns: ColumnsOption = None
    time: TimeOption = None
    features: FeaturesOption = None
    unit: UnitOption = None
    wrench_columns: WrenchOption = None
    wrench_unit: WrenchUnitOption = None
    touch: TouchOption = None
    recording: RecordingOption = None
    mechanics: Annotated[
        bool,
        typer.Option(
            "--mechanics/--no-mechanics", " /--no-prior", help="Of boards with markers: use the pad's mechanics."
        ),
    ] = True
    nonlinear: Annotated[
        bool, typer.Option("--nonlinear/--linear", help="Of many features: try kernels, kept where they err less.")
    ] = True
    videos: Annotated[
        Path | None,
        typer.Option(
            help="LOG are videos, or folders of them, with a CSV of a load cell beside each; this TOML file names its "
            "columns. Needs --board."
        ),
    ] = None
    report: Annotated[Path | None, typer.Option(help="JSON of the report.")] = None

    def named_columns(self) -> Columns | None:
        """Those of a log from elsewhere; None where nothing names any."""
        return columns_of(self.columns, self.time, self.features, self.unit, self.wrench_columns, self.wrench_unit,
                          self.touch, self.recording)  # fmt: skip


COMMAND = Command(
    "wrench",
    "Fit a wrench to targets, markers or any named columns beside a force sensor; judged on what was left out.",
    logs="HDF5 or CSV with named columns, frames with wrench.csv, a folder of such recordings, or a log of "
    "`cal collect`.",
    options=WrenchOptions,
    shared=("fleet",),
    needs_board=False,
    former_verb="wrench",
)
