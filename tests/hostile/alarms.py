"""Good frames of every simulated board, through the core: how often is one flagged?

Frames are drawn as tests/bench/false_flags.py draws them: untouched, pressed, sheared and turned, with noise, in half
of them light that drifts and flickers. A board passes with at most one flagged frame in 10,000. A state that is beyond
what the quick calibration was fitted on (FLAG_OVER_RANGE alone, in most of its frames) is no good state: it is left
out, and named.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from calibrations import calibration
from pictures import BOARDS
from row import Row, Wanted

from ruffini.boards import find_board

sys.path.append(str(Path(__file__).parents[1] / "bench"))
from false_flags import measure

N_FRAMES, N_QUICK = 20_000, 1_000  # of each board
MOST = 1e-4


def rows(seed: int, quick: bool, is_wanted: Wanted) -> Iterator[Row]:
    """A row for each board: 1 wrong where its good frames are flagged too often."""
    n = N_QUICK if quick else N_FRAMES
    for name in filter(is_wanted, BOARDS):
        try:
            file = calibration(name)
        except subprocess.CalledProcessError as error:
            yield Row(name, "none", 0, 0, 0, note=f"not tried: no calibration, {shlex.join(error.cmd[3:])} failed")
            continue
        result = measure(find_board(name), file, n, seed)
        good = [s for s in result["of_state"] if s["over_range"] < s["flagged"] or 2 * s["over_range"] < s["frames"]]
        n_flagged, n_good = (sum(s[key] for s in good) for key in ("flagged", "frames"))
        n_beyond = len(result["of_state"]) - len(good)
        is_rare = n_flagged <= MOST * n_good
        yield Row(name, "good frames", 1, int(is_rare), int(not is_rare), n_good=n_good, n_flagged=n_flagged,
                  note=f"all masks {result['by_mask']}"
                  + (f"; {n_beyond} states beyond the calibration left out" if n_beyond else ""))  # fmt: skip
