"""How far an object has turned on the pad, by the stage helmholtz against the twin's pose. SIMULATED.

    python tests/bench/contact_twist.py --calibration contact.safetensors --recording RUNS

RUNS is the folder `fit_shear` of `ruffini reproduce BOARD --only recordings --bench presses.toml`: held at 1.5 mm,
moved sideways, turned or not. Nothing is fitted here. By shape: told over true turn (least squares), RMS error of the
turned runs, and RMS of those that were not.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
from contact_frame import decomposed

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.frames import read_frames

TURN = 3  # about z, in a pose


def told_and_true(board: Board, calibration: bytes, run: Path) -> npt.NDArray[np.float64]:
    """(frames, 2) mrad of the frames that touch."""
    with np.load(run / "truth.npz") as truth:
        pose = truth["pose"]
    rows = []
    with Pipeline(board, calibration) as core:
        for image, at in zip(read_frames(run), pose, strict=True):
            frame = core.process(np.asarray(image, dtype=np.uint8))
            if frame.has_reference and core.modelled().is_touched:
                rows.append((core.helmholtz().twist_urad * 1e-3, at[TURN] * 1e3))
    return np.array(rows).reshape(-1, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="contact-glitter")
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--recording", type=Path, required=True)
    args = parser.parse_args()
    board, calibration = decomposed(find_board(args.board)), args.calibration.read_bytes()
    by_shape: dict[tuple[str, bool], list[npt.NDArray[np.float64]]] = {}
    for run in sorted(args.recording.iterdir()):
        chosen = json.loads((run / "run.json").read_text())["chosen"]
        key = chosen["indenter"], chosen["turn_mrad"] != 0
        by_shape.setdefault(key, []).append(told_and_true(board, calibration, run))
    for shape in sorted({shape for shape, _ in by_shape}):
        said = []
        if turned := by_shape.get((shape, True)):
            told, true = np.concatenate(turned).T
            error = np.sqrt(np.mean((told - true) ** 2))
            said.append(f"told over true {told @ true / (true @ true):.2f}, error {error:.1f} of {true.max():.0f} mrad")
        if unturned := by_shape.get((shape, False)):
            said.append(f"not turned {np.sqrt(np.mean(np.concatenate(unturned)[:, 0] ** 2)):.1f} mrad")
        print(f"{shape:10} {', '.join(said)}")


if __name__ == "__main__":
    main()
