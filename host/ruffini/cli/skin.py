"""The verb that calibrates a glowing skin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, emit_judged, note, progress_bar
from ruffini.errors import InputError


def skin(
    board: BoardOption,
    points: Annotated[Path, typer.Option("--points", help="CSV of known points: x_px, y_px, z_mm along the tube.")],
    presses: Annotated[
        Path,
        typer.Option("--presses", help="Folder of presses: each frames/ and press.csv (time_s, force_n, x_mm, y_mm)."),
    ],
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    method: Annotated[
        str, typer.Option(help="taxels: between them, with memory; paper: brightest pixel, eq. (3) and one quadratic.")
    ] = "taxels",
    most_n: Annotated[float, typer.Option(help="paper: largest force of the quadratic, N.")] = 9.4,
    json_: JsonFlag = False,
) -> None:
    """Lens, openings, force and place of a skin that gets brighter where it is pressed."""
    note(f"cal skin: board {board}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.calibrate.gates import manifest_of
    from ruffini.estimators.skin import fit as fits
    from ruffini.estimators.skin.openings import fit_view
    from ruffini.estimators.skin.stage import SKIN

    found = find_board(board)
    if method not in ("taxels", "paper"):
        raise InputError(f"--method {method!r}: choose taxels or paper")
    known = fits.read_points(points)
    if method == "paper":
        view = fit_view(found, known)
        with progress_bar("presses") as progress:
            curve = fits.fit_curve(found, presses, most_n, progress)
        container.write(out, fits.paper_file(found, view, curve))
        emit({"file": str(out), "curve": curve.tolist(), "f_px": view.f, "d_mm": view.d}, json_,
             f"{out}: F = {curve[0]:.3g} I^2 + {curve[1]:.3g} I + {curve[2]:.3g} N; "
             f"f {view.f:.1f} px, d {view.d:.1f} mm")  # fmt: skip
        return
    with progress_bar("presses and fits") as progress:
        fit = fits.fit_skin(found, known, presses, progress)
    file = fits.taxel_file(found, fit)
    gates = SKIN.gates(fit.report, found)
    named = {**file.metadata, **manifest_of(fit.report, gates)}
    container.write(out, container.pack(file.tensors, named))
    r = fit.report
    emit_judged({"file": str(out), **r}, gates, json_,
         f"{out}: {r['n_taxels']} taxels, {r['n_presses']} presses; left out of the fit they err by "
         f"{r['force_error_percent']:.1f} % in force above 2 N and {r['place_error_mm']:.2f} mm in place; "
         f"f {r['f_px']:.1f} px, d {r['d_mm']:.1f} mm, points {r['points_rmse_px']:.2f} px")  # fmt: skip
