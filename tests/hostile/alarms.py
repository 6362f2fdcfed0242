"""Good frames of every simulated board, through the core: how often is one flagged?

Frames are drawn as tests/bench/false_flags.py draws them: untouched, pressed, sheared and turned, with noise, in half
of them light that drifts and flickers. A board passes with at most one flagged frame in 10,000.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from calibrations import calibration
from pictures import BOARDS
from row import Row

from ruffini.boards import find_board

sys.path.append(str(Path(__file__).parents[1] / "bench"))
from false_flags import measure

N_FRAMES, N_QUICK = 20_000, 1_000  # of each board
MOST = 1e-4


def rows(seed: int, quick: bool) -> Iterator[Row]:
    """A row for each board: 1 wrong where its good frames are flagged too often."""
    n = N_QUICK if quick else N_FRAMES
    for name in BOARDS:
        try:
            file = calibration(name)
        except subprocess.CalledProcessError as error:
            yield Row(name, 0, 0, 0, note=f"not tried: no calibration, {shlex.join(error.cmd[3:])} failed")
            continue
        result = measure(find_board(name), file, n, seed)
        is_rare = result["flagged"] <= MOST * n
        yield Row(name, 1, int(is_rare), int(not is_rare),
                  note=f"{result['flagged']} of {n} good frames flagged, masks {result['by_mask']}")  # fmt: skip
