"""What `cal fit --only NAME` says and takes of a stage's own, apart from its estimator: help imports no numpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

PlotOption = Annotated[Path | None, typer.Option(help="Picture (PNG) of the residuals before and after.")]
ReferenceOption = Annotated[
    Path | None,
    typer.Option(help="CSV, a row a frame: fx,fy,fz in N, tx,ty,tz in N mm (default: wrench.csv of the recording)."),
]


@dataclass(frozen=True)
class Command:
    """Words of `cal fit --only NAME`.

    options : dataclass of the stage's own options, a field each, annotated as a parameter of a Typer command is; an
        instance of it reaches `Estimator.fit_alone`. None: it takes those of `cal fit`.
    shared : options of `cal fit`, as its function names them, that it takes besides; `cli.fit.COMMON` it always does.
    former_verb : `cal VERB` of the release before.
    former_options, gone_options : of that verb, with what they are called now, or what to do instead.
    """

    name: str
    help: str = ""
    logs: str = ""  # what its arguments are; empty: it takes none
    metavar: str = "LOG..."
    options: type | None = None
    shared: tuple[str, ...] = ()
    needs_board: bool = True
    former_verb: str = ""
    former_options: Mapping[str, str] = field(default_factory=dict)
    gone_options: Mapping[str, str] = field(default_factory=dict)
