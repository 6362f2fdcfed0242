"""The verb that calibrates a fingertip with pins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit_judged, note, progress_bar


def fingertip(
    board: BoardOption,
    presses: Annotated[
        Path,
        typer.Option("--presses", help="Folder of presses: each frames/ and press.csv (calibrate/DESIGN.md says how)."),
    ],
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    baseline_mm: Annotated[float, typer.Option("--baseline-mm", help="Distance between the eyes.")],
    only: Annotated[str, typer.Option(help="Pattern of the folders below --presses that are used.")] = "*",
    json_: JsonFlag = False,
) -> None:
    """Force, way, place, angles and area of a tool on a fingertip, from the pins that its two eyes see."""
    note(f"cal fingertip: board {board}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.calibrate.gates import manifest_of
    from ruffini.estimators.fingertip.fit import fit_fingertip
    from ruffini.estimators.fingertip.stage import FINGERTIP
    from ruffini.estimators.fingertip.tables import tables

    found = find_board(board)
    with progress_bar("presses and fits") as progress:
        fit = fit_fingertip(found, presses, baseline_mm, progress, only=only)
    gates = FINGERTIP.gates(fit.report, found)
    tensors, metadata = tables(fit)
    base = {**container.base_metadata(found), **manifest_of(fit.report, gates)}
    container.write(out, container.pack(tensors, {**base, **metadata}))
    off = fit.report["mean_error_of_presses_left_out"]["both"]
    emit_judged({"file": str(out), **fit.report}, gates, json_,
         f"{out}: {fit.report['n_pins']} pins, {fit.report['n_presses']} presses; left out of the fit they err by "
         f"{off['force_n']:.3f} N, {off['way_mm']:.3f} mm deep, {off['x_mm']:.2f} and {off['y_mm']:.2f} mm aside, "
         f"{off['roll_deg']:.2f} and {off['pitch_deg']:.2f} degrees")  # fmt: skip
