"""ruffini cal fit --only dark."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit_judged, note_start, progress_bar


def dark(
    log: Annotated[Path, typer.Argument(metavar="RECORDING", help="Frames with the lamps off: video, or folder.")],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write, for `cal file merge` or `cal flash`.")],
    json_: JsonFlag = False,
) -> None:
    """Measure what the camera shows with its lamps off: black level and daylight, which then do not count."""
    note_start("cal fit --only dark", board)
    from ruffini.boards import find_board
    from ruffini.calibrate.gates import write_judged
    from ruffini.estimators.dark.frame import dark_frame
    from ruffini.estimators.dark.stage import DARK
    from ruffini.frames import read_frames

    found = find_board(board)
    with progress_bar("frames") as progress:
        made = dark_frame(found, read_frames(log), progress=progress)
    report = made.report()
    gates = write_judged(out, DARK.name, DARK.gates(report, found), found, made.tensors(), report, {})
    level = ", ".join(f"{v:.2f}" for v in report["level_bgr"])
    emit_judged({"file": str(out), **report}, gates, json_,
         f"{out}: dark frame of {report['frames']} frames, mean level {level} (B, G, R), brightest "
         f"{report['brightest']:.1f}; fit the colours with it too: `cal fit --only photometric --dark`")  # fmt: skip
