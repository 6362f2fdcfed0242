"""What the checks against wrong pictures cost: instructions of each beside those of the frame, counted by valgrind.

    cmake --build build --target ruffini_live_frames
    tests/bench/check_costs.py --binary build/ruffini_live_frames [--board NAME ...]

Of every board of `make hostile`, SIMULATED, with the calibration of that trial: N_FRAMES untouched and as many pressed
frames. The counts are the same on every run, whatever else the computer does; a check whose memory is slower than its
instructions is not seen. image/frame_watch is not among them: it is older than the limit. Ends with exit code 1 where
the checks of one board take more than MOST of the frame, or one that every frame calls was not found.
"""

from __future__ import annotations

import argparse
import itertools
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from ruffini.boards import find_board
from ruffini.core import Pipeline
from ruffini.sim.units import build_unit

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from calibrations import calibration
from pictures import BOARDS, states_of

N_FRAMES, N_SETTLED, SEED, MOST_STATES = 6, 3, 1, 12
MOST = 0.02
UNCALIBRATED = 2 | 4
# Functions by which the frame path calls the checks: nothing of them is inlined elsewhere, and none calls another.
CHECKS = {
    "image/repeated_pictures": "RepeatedPictures::run",
    "image/pixel_statistics": "PixelStatistics::run",
    "image/block_edges": "BlockEdges::run",
    "image/slipped_rows": "has_slipped_rows",
    "image/slipped_pins": "SlippedPins::run",
    "solve/spread_check": "SpreadCheck::is_explained",
    "estimators/camera_motion": "CameraMotion::has_moved",
    "corner_motion": "CornerMotion::has_moved",
    "rim_motion": "RimMotion::has_moved",
    "opening_edges": "OpeningEdges::run",
}
ALWAYS = ("image/repeated_pictures", "image/pixel_statistics", "image/block_edges")
FRAME = "counted_frame"
LINE = re.compile(r"^\s*([\d,]+) (?:\([^)]*\))?\s+\S*?:(.*)$")


def pictures_of(name: str, folder: Path) -> int:
    """Fill a folder as ruffini_live_frames reads it; the number of frames before those that are counted."""
    unit, file = build_unit(find_board(name)), calibration(name)
    source = states_of(unit, name, BOARDS[name], SEED)
    rest = next(source)
    n_rest = unit.board.pipeline.n_rest_frames + N_SETTLED
    shown = [rest.frame() for _ in range(n_rest + N_FRAMES)]
    with Pipeline(unit.board, file) as core:
        core.set_live()
        for frame in shown:
            core.process(frame)
        few = itertools.islice(source, MOST_STATES)
        pressed = next((state for state in few if not core.process(state.frame()).flags & ~UNCALIBRATED), None)
    if pressed is None:
        sys.exit(f"{name}: each of {MOST_STATES} pressed states is flagged: remove its folder in build/hostile")
    shown += [pressed.frame() for _ in range(N_FRAMES)]
    (folder / "board.toml").write_text(unit.board.text)
    (folder / "calibration.safetensors").write_bytes(file)
    (folder / "frames.bgr").write_bytes(np.array(shown).tobytes())
    return n_rest


def count(binary: Path, folder: Path, n_rest: int) -> dict[str, int]:
    """Instructions by function, each with all that it calls."""
    out = folder / "callgrind.out"
    tool = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", f"--toggle-collect={FRAME}", "--quiet"]
    done = subprocess.run([*tool, str(binary), str(folder), str(n_rest)], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{binary} {folder}: {done.stderr.strip()}")
    flags = [int(line) & ~UNCALIBRATED for line in done.stdout.split()]
    if len(flags) != 2 * N_FRAMES or any(flags):
        sys.exit(f"{folder.name}: good frames have the flags {flags}: the usual frame is not what was counted")
    told = subprocess.run(["callgrind_annotate", "--inclusive=yes", "--threshold=100", str(out)],
                          capture_output=True, text=True, check=True)  # fmt: skip
    counts: dict[str, int] = {}
    for line in told.stdout.splitlines():
        if found := LINE.match(line):
            counts.setdefault(found[2].split(" [")[0], int(found[1].replace(",", "")))
    return counts


def of(counts: dict[str, int], function: str) -> int:
    """Instructions of a function; 0 where it was not called. Of a lambda in it fewer are counted."""
    return max((n for name, n in counts.items() if re.search(rf"\b{re.escape(function)}(\(|$)", name)), default=0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="ruffini_live_frames")
    parser.add_argument("--board", choices=BOARDS, action="append", help="one board; may be repeated")
    arguments = parser.parse_args()
    is_dear = False
    for name in arguments.board or BOARDS:
        with tempfile.TemporaryDirectory(prefix=f"{name}-") as made:
            counts = count(arguments.binary, Path(made), pictures_of(name, Path(made)))
        frame = of(counts, FRAME) / (2 * N_FRAMES)
        cost = {check: of(counts, function) / (2 * N_FRAMES) for check, function in CHECKS.items()}
        total = sum(cost.values())
        if absent := [check for check in ALWAYS if not cost[check]]:
            sys.exit(f"{name}: no instructions of {', '.join(absent)}: renamed or inlined?")
        print(f"{name}: {frame / 1e3:.0f} thousand instructions a frame, SIMULATED")
        for check, n in [*((c, n) for c, n in cost.items() if n), ("all checks", total)]:
            print(f"  {check:26}{n / 1e3:9.1f}{100 * n / (frame - total):7.2f} % of the frame without checks")
        is_dear |= total > MOST * (frame - total)
    return int(is_dear)


if __name__ == "__main__":
    sys.exit(main())
