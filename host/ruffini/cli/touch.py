"""ruffini cal fit --only touch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit_judged, note, progress_bar


def touch(
    log: Annotated[Path, typer.Argument(metavar="RECORDING", help="Untouched frames: video, or folder of frames.")],
    calibration: Annotated[Path, typer.Option("--calibration", help="File with operator and colours of this unit.")],
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write, for `cal file merge` or `cal flash`.")],
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Measure the noise of untouched frames: what counts as a touch on this unit."""
    note(f"cal touch: board {board}")
    from ruffini.calibrate import container
    from ruffini.calibrate.gates import manifest_of
    from ruffini.estimators.threshold.fit import fit_contact_noise, linear_pressure
    from ruffini.estimators.threshold.stage import THRESHOLD
    from ruffini.frames import read_frames

    file = container.read(calibration)
    found = container.board_of(file, board)
    with progress_bar("noise") as progress:
        pressure = linear_pressure(found, file, read_frames(log))
        noise = fit_contact_noise(pressure, found.pipeline.n_rest_frames, progress=progress)
    report = noise.report()
    gates = THRESHOLD.gates(report, found)
    metadata = {**container.base_metadata(found), **manifest_of(report, gates)}
    container.write(out, container.pack(noise.tensors(), metadata))
    threshold_mn = found.contact.threshold_un * 1e-3
    emit_judged({"file": str(out), **report}, gates, json_,
         f"{out}: noise of a node {report['node_sigma_mn']:.3f} mN in {report['frames']} untouched frames; touched "
         f"from {report['square_mn']:.3f} mN on 2 x 2 nodes or {report['alone_mn']:.3f} mN on one, set for a false "
         f"contact in {1 / report['set_false_rate']:,.0f} frames (board: {threshold_mn:g} mN)")  # fmt: skip
