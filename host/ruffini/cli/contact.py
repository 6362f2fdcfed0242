"""ruffini cal fit --only contact."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit_judged, note, progress_bar

if TYPE_CHECKING:
    from ruffini.estimators.contact_model.tables import ContactFit


def contact(
    log: Annotated[
        list[Path],
        typer.Option("--log", help="Folder of presses as `reproduce --only recordings` makes them. Repeatable."),
    ],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write, for `cal file merge` or `cal flash`.")],
    report: Annotated[Path | None, typer.Option(help="JSON of the report.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Fit wrench, depth, area, kind of contact and hardness of a texture's flow; errors on what was not fitted.

    What counts as a touch, from untouched frames, is `cal fit --only touch`.
    """
    note(f"cal contact: board {board}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.calibrate.gates import manifest_of
    from ruffini.estimators.contact_model.log import read_presses
    from ruffini.estimators.contact_model.stage import CONTACT
    from ruffini.estimators.contact_model.tables import fit_contact, tables
    from ruffini.estimators.wrench.log import features_of
    from ruffini.files import write_whole

    found = find_board(board)
    if not CONTACT.applies(found):
        note(f"board {found.name!r} has no stage contact_model: it would not use these tables")
    with progress_bar("frames") as progress:
        presses = read_presses(log, found, progress=progress)
    with progress_bar("fits") as progress:
        fit = fit_contact(found, presses, progress)
    tensors, metadata = tables(found, fit, features_of(found))
    residuals = json.loads(metadata["residuals"])
    gates = CONTACT.gates(residuals, found)
    base = container.base_metadata(found)
    container.write(out, container.pack(tensors, {**base, **metadata, **manifest_of(residuals, gates)}))
    said = {"file": str(out), **residuals, "gates": [gate._asdict() for gate in gates]}
    if report is not None:
        write_whole(report, json.dumps(said, indent=1).encode())
    emit_judged(said, gates, json_, _text(out, fit, said["tables_err"]))


def _text(out: Path, fit: ContactFit, tables_err: dict[str, float]) -> str:
    said = fit.report()
    crosstalk = said["reference_crosstalk"]
    lines = [f"{out}: {said['n_presses']} presses; the reference's crosstalk, taken out: "
             f"{100 * crosstalk['x']:.1f} % and {100 * crosstalk['y']:.1f} % of Fz in Fx and Fy"]  # fmt: skip
    for what, rows in (("sizes", said["left_out_sizes"]), ("shapes", said["left_out_shapes"])):
        lines.append(f"  RMSE on {what} that were not fitted, against the log:")
        lines.append(
            f"  {'':10}{'Fn N':>8}{'Ft N':>8}{'M N m':>9}{'gel mm':>8}{'press mm':>9}{'Shore A':>9}{'kind':>7}"
        )
        for shape, r in rows.items():
            lines.append(
                f"  {shape:10}{r['normal_n']:>8.3f}{r['tangential_n']:>8.3f}{r['moment_nm']:>9.4f}"
                f"{r['gel_depth_mm']:>8.3f}{r['press_depth_mm']:>9.3f}{r['shore_a']:>9.2f}"
                f"{100 * r['kind_right']:>6.0f}%"
            )
    if (depth_map := said["depth_map"]) is not None:
        each = ", ".join(f"{shape} {under:.2f}" for shape, under in depth_map["under_mm"].items())
        beside = depth_map["beside_mm"]["all"]
        lines.append(
            f"  depth map on presses that were not fitted, RMSE in mm where they touch: {each}; beside {beside:.2f}"
        )
    else:
        lines.append("  no depth map: the log does not know the gel's surface")
    for name, parts in said["refused"].items():
        each = ", ".join(f"{100 * part:.0f} % of {what} that were not fitted" for what, part in parts.items())
        lines.append(f"  no model holds for {name}: refused {each}")
    lines.append(
        "  tables differ from the fit by at most " + ", ".join(f"{v:.1f} steps ({k})" for k, v in tables_err.items())
    )
    return "\n".join(lines)
