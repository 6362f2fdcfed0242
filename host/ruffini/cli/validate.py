"""`ruffini bench mechanics`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit, note, progress_bar


def validate(
    quick: Annotated[bool, typer.Option("--quick", help="Coarser references, one pad for two checks.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Picture (PNG): theory and twin.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Theory beside the twin's mechanics; exit code 1 where a number is outside its tolerance."""
    note("sim validate ...")
    from ruffini.sim.validation import table

    with progress_bar("validation") as progress:
        outcome = table.validate(quick=quick, progress=progress)
    result, text = table.as_dict(outcome), table.as_text(outcome)
    if out is not None:
        table.picture(outcome, out)
        result["picture"] = str(out)
        text += f"\n{out}"
    emit(result, json_, text)
    if not result["good"]:
        raise typer.Exit(1)
