"""The verb of who designs a pad."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar
from ruffini.errors import InputError
from ruffini.tables import aligned


def _numbers(text: str, option: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError as error:
        raise InputError(f"{option} {text!r}: give numbers with commas between them") from error


def design(
    board: BoardOption,
    shore_a: Annotated[str, typer.Option("--shore-a", help="Hardnesses of the rubber.")] = "40,60,70,80",
    thickness_mm: Annotated[str, typer.Option("--thickness-mm", help="Thicknesses of pad or wall.")] = "",
    force_n: Annotated[float, typer.Option("--force-n", min=0.001, help="The load that it shall carry.")] = 1.0,
    depth_mm: Annotated[float, typer.Option("--depth-mm", min=0.01, help="How far the tool goes.")] = 4.0,
    indenter: Annotated[str, typer.Option(help="Shape of the tool.")] = "flat",
    radius_mm: Annotated[float, typer.Option(help="Half of its size.")] = 5.0,
    out: Annotated[Path | None, typer.Option("--out", help="Picture (PNG) of the curves.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Force over displacement of other hardnesses and thicknesses, and where the body collapses."""
    note(f"sim design: board {board}")
    from ruffini.boards import find_board
    from ruffini.sim.design import picture, study
    from ruffini.sim.indenters import Indenter

    found = find_board(board)
    hardnesses, thicknesses = _numbers(shore_a, "--shore-a"), _numbers(thickness_mm, "--thickness-mm")
    with progress_bar("presses") as progress:
        curves = study(
            found, shore_a=hardnesses, thickness_mm=thicknesses, indenter=Indenter(indenter, radius_mm * 1e-3),
            depth_mm=depth_mm, progress=progress,
        )  # fmt: skip
    rows = [
        {
            "label": c.label, "modulus_pa": c.modulus_pa, "thickness_mm": c.thickness_mm,
            "depth_mm": c.depth_mm.tolist(), "force_n": c.force_n.tolist(), "collapse_n": c.collapse_n,
            "depth_at_force_mm": c.depth_at(force_n), "ended": c.ended,
        }
        for c in curves
    ]  # fmt: skip
    lines = [f"{found.name}, SIMULATED: {indenter} of {radius_mm:g} mm, to {depth_mm:g} mm"]
    lines += aligned(("", "MPa", "mm", f"mm at {force_n:g} N", "collapses at", ""), [
        (
            c.label, f"{c.modulus_pa * 1e-6:.2f}", f"{c.thickness_mm:.2f}",
            "not reached" if (depth := c.depth_at(force_n)) is None else f"{depth:.2f}",
            "-" if c.collapse_n is None else f"{c.collapse_n:.2f} N",
            f"ended at {c.depth_mm[-1]:.2f} mm" if c.ended else "",
        )
        for c in curves
    ])  # fmt: skip
    if out is not None:
        picture(out, found, curves, force_n)
        lines.append(str(out))
    emit({"board": found.name, "simulated": True, "force_n": force_n, "curves": rows}, json_, "\n".join(lines))
