"""ruffini cal dark."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar


def dark(
    log: Annotated[Path, typer.Argument(metavar="RECORDING", help="Frames with the lamps off: video, or folder.")],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write, for `cal merge` or `cal flash`.")],
    json_: JsonFlag = False,
) -> None:
    """Measure what the camera shows with its lamps off: black level and daylight, which then do not count."""
    note(f"cal dark: board {board}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.calibrate.dark import dark_frame
    from ruffini.frames import read_frames

    found = find_board(board)
    with progress_bar("frames") as progress:
        made = dark_frame(found, read_frames(log), progress=progress)
    report = made.report()
    metadata = {**container.base_metadata(found), "residuals": json.dumps(report)}
    container.write(out, container.pack(made.tensors(), metadata))
    level = ", ".join(f"{v:.2f}" for v in report["level_bgr"])
    emit({"file": str(out), **report}, json_,
         f"{out}: dark frame of {report['frames']} frames, mean level {level} (B, G, R), brightest "
         f"{report['brightest']:.1f}; fit the colours with it too: `cal photometric --dark`")  # fmt: skip
