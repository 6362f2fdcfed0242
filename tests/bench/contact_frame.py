"""Time of a whole frame of the contact model, pixels to contact, on one core: at the board's size and at 640 x 480.

    python tests/bench/contact_frame.py --calibration contact.safetensors --recording RUN

RUN is a run of `ruffini reproduce --only recordings`. For 640 x 480 the same frames are made twice as large. Times are
the stages' own clock; the least and the median of the pressed frames.
Then the same with the stage helmholtz, which takes the paper's sensor from 30 to 5 frames a second (section III-C).
The stage contact_depth runs where the calibration has its tables.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate import container
from ruffini.core import Pipeline
from ruffini.frames import read_frames

DOUBLED = ("width_px", "height_px", "focal_mpx")


def doubled(board: Board) -> Board:
    """The same board with twice the pixels each way."""
    text = board.text
    for key in DOUBLED:
        value = getattr(board.camera, key)
        text = text.replace(f"{key} = {value}", f"{key} = {2 * value}", 1)
    for key in ("center_x_mpx", "center_y_mpx"):
        value = getattr(board.camera, key)
        text = text.replace(f"{key} = {value}", f"{key} = {2 * value + 500}", 1)
    return parse_board(text.encode(), board.name)


def decomposed(board: Board) -> Board:
    """The same board with the stage helmholtz."""
    listed = '"contact_model", "contact_depth"]'
    if listed not in board.text:
        raise SystemExit(f"board {board.name!r}: its stages do not end with contact_model and contact_depth")
    return parse_board(board.text.replace('"contact_depth"]', '"helmholtz", "contact_depth"]').encode(), board.name)


def times_ms(board: Board, file: container.CalibrationFile, recording: Path) -> dict[str, tuple[float, float]]:
    """Least and median of each stage and of the whole frame."""
    data = container.pack(file.tensors, {**file.metadata, **container.base_metadata(board)}).data
    rows: list[dict[str, int]] = []
    with Pipeline(board, data) as core:
        for image in read_frames(recording):
            if image.shape[1] != board.camera.width_px:
                image = cv2.resize(image, (board.camera.width_px, board.camera.height_px))
            frame = core.process(np.asarray(image, dtype=np.uint8))
            if frame.has_reference and core.modelled().is_touched:
                rows.append(frame.stage_ns)
    names = [name for name in rows[0] if any(row[name] for row in rows)]
    each = {name: np.array([row[name] for row in rows]) * 1e-6 for name in names}
    each["whole frame"] = np.sum(list(each.values()), axis=0)
    return {name: (float(ms.min()), float(np.median(ms))) for name, ms in each.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="contact-glitter")
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--recording", type=Path, required=True)
    args = parser.parse_args()
    board, file = find_board(args.board), container.read(args.calibration)
    for one in (board, doubled(board), decomposed(board)):
        extra = ", with the Helmholtz decomposition" if "helmholtz" in one.pipeline.stages else ""
        print(f"{one.camera.width_px} x {one.camera.height_px}{extra}, ms: least, median")
        for name, (least, median) in times_ms(one, file, args.recording).items():
            print(f"  {name:16}{least:8.2f}{median:8.2f}")


if __name__ == "__main__":
    main()
