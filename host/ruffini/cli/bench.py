"""Verbs that judge methods on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit, progress_bar

app = typer.Typer(no_args_is_help=True, help="Benchmarks on the digital twin: our methods and the papers'.")


@app.callback()
def bench() -> None:
    """Our methods and the papers' on the same simulated truth."""


@app.command("ifem")
def ifem(
    board: Annotated[str, typer.Option("--board", help="Board name, or a folder with a board.toml.")] = "gelslim",
    quick: Annotated[bool, typer.Option("--quick", help="One depth, one seed, no model errors.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Picture (PNG) of the fields beside the truth.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Inverse FEM: raw, sparse and ridge as in the papers, the optimal linear estimate, and the board's default."""
    from ruffini.bench import ifem as benchmark
    from ruffini.boards import find_board

    found = find_board(board)
    with progress_bar("benchmark") as progress:
        result = benchmark.run(found, quick=quick, progress=progress)
    text = benchmark.tables(result)
    if out is not None:
        from ruffini.bench.pictures import fields_beside_truth

        result["picture"] = str(fields_beside_truth(out, found))
        text += f"\n{out}"
    emit(result, json_, text)
