"""ruffini cal fleet: many units, what they have in common, and a prior for new ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import (
    BoardOption,
    JsonFlag,
    StrainOption,
    WorkersOption,
    emit,
    is_finite,
    n_workers_of,
    note,
    progress_bar,
)


def fleet(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="One log or recording for each unit.")],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="HTML page to write; its numbers as .json beside it.")],
    prior: Annotated[Path | None, typer.Option("--prior", help="Prior to write, for `cal fit --prior`.")] = None,
    given: Annotated[
        Path | None, typer.Option("--with", help="Calibration with the colours that recordings are seen with.")
    ] = None,
    strain: StrainOption = "linear",
    workers: WorkersOption = None,
    dask: Annotated[str | None, typer.Option("--dask", help="Address of a Dask scheduler, for --workers.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit every unit on all cores or a Dask cluster; page with spread and outliers, prior for new units."""
    note("cal fleet ...")
    from ruffini.boards import find_board
    from ruffini.calibrate.fleet.page import write_fleet_page
    from ruffini.calibrate.fleet.units import fit_fleet
    from ruffini.errors import InputError
    from ruffini.estimators.material.prior import write_prior
    from ruffini.files import write_whole

    found, at_finite = find_board(board), is_finite(strain)
    with progress_bar("units") as progress:
        made = fit_fleet(
            logs, found, given, is_finite=at_finite, n_workers=n_workers_of(workers), dask=dask, progress=progress
        )
    tree = made.report()
    write_fleet_page(out, found, made)
    write_whole(out.with_suffix(".json"), json.dumps(tree, indent=1).encode() + b"\n")
    if prior is not None:
        if made.prior is None:
            raise InputError(f"{tree['fitted']} units tell no spread: no prior was written")
        write_prior(prior, found, made.prior)
    for unit in made.units:
        if unit.error:
            note(f"{unit.name} was not fitted: {unit.error}")
    emit({"page": str(out), **tree}, json_,
         f"{out}: {tree['fitted']} of {len(logs)} units in {made.seconds:.0f} s; force of touches left out off by "
         f"{1e3 * tree['after_rmse_n']:.1f} mN RMS ({1e3 * tree['before_rmse_n']:.1f} mN with the board's numbers); "
         f"outliers: {', '.join(tree['outliers']) or 'none'}")  # fmt: skip
    if tree["fitted"] < len(logs):
        raise typer.Exit(1)
