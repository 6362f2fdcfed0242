"""Frames a second on one core and on two ([pipeline] cores of board.toml): the same pictures, one run.

On the two boards of benchmarks.py. On a busy computer repeat it, or run it before all others (`chrt -f 50`).
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path

from benchmarks import make_data, seventy_markers, solve_tensors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, default=Path("build"))
    arguments = parser.parse_args()
    boards = [seventy_markers(320), seventy_markers(640)]
    kind = solve_tensors(boards[0])
    for board in boards:
        folder = arguments.build / "bench" / f"{board.camera.width_px}x{board.camera.height_px}"
        make_data(board, folder, kind)
        subprocess.run([arguments.build / "ruffini_two_cores", folder], check=True)


if __name__ == "__main__":
    main()
