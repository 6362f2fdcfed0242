"""Instructions of each stage on 64-bit ARM, counted under qemu, and what cores of three kinds may take for them.

    cmake -S . -B BUILD -DCMAKE_TOOLCHAIN_FILE=.ci/aarch64.cmake -DRUFFINI_DAEMON=OFF -DRUFFINI_TESTS=OFF
    cmake --build BUILD --target ruffini_one_frame
    tests/bench/instructions.py --binary BUILD/ruffini_one_frame [FOLDER...]

FOLDER: as tests/bench/run.py leaves it in build/bench; without, its smaller board is made anew, as in `make aarch64`.
The counts are exact. The times are estimates, not measurements: instructions over clock and over
instructions a cycle as such cores reach on integer vector code. Beside them bytes of tables and pictures over
what the memory is stated to give at best, and products of tables over what the core multiplies at best, both as if the
whole pad were touched. The frame is the largest of the three, as if each hid behind the others.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from run import make_data, seventy_markers, solve_tensors

from ruffini.boards import parse_board

# Name, clock in GHz as Raspberry Pi states it (Cortex-A53, A72, A76), instructions a cycle that are assumed.
CORES = (("Pi Zero 2 W", 1.0, 0.7), ("Pi 4", 1.8, 1.4), ("Pi 5", 2.4, 2.2))
# GB/s of the memory, 32 bits wide, of the type that Raspberry Pi states: LPDDR2 (900 MT/s), LPDDR4 3200, LPDDR4X 4267.
MEMORY = (3.6, 12.8, 17.1)
# int16 products a cycle into int32: one SMLAL of four lanes, as Arm's optimization guides of A72 and A76 have it; of
# the A53 there is none, and the same is assumed.
PRODUCTS = 4
SOLVER_STEPS = 9  # SupportSolver: kRounds (kSteps + 1)
# Bytes of a pixel through camera memory, copy, difference (rest and its reciprocal, change, grey) and photometric.
PIXEL_BYTES = 3 + 3 + 3 + (6 + 6 + 6 + 2) + 6
# In the order of the frame path of run.py's boards; light is what follows the light, uncertainty the error model.
STAGES = (
    "difference", "markers", "light", "photometric", "poisson", "displacement",
    "operator", "support", "wrench", "contacts", "uncertainty",
)  # fmt: skip
BLOCK = re.compile(r"^0x([0-9a-f]+):")
RUN = re.compile(r"^Trace \d+: 0x[0-9a-f]+ \[[0-9a-f]+/([0-9a-f]+)/")


def count(binary: Path, folder: Path) -> list[int]:
    """Instructions between each pair of calls of the clock."""
    command = ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu", "-d", "in_asm,exec,nochain", "-D", "/dev/stdout"]
    size: Counter[int] = Counter()  # instructions of the block that starts there
    stretches: list[int] = []
    start, now = None, 0
    with subprocess.Popen([*command, str(binary), str(folder)], stdout=subprocess.PIPE, text=True) as traced:
        assert traced.stdout is not None
        is_new = False
        for line in traced.stdout:
            if found := RUN.match(line):
                if line.split()[-1] == "stage_boundary":
                    stretches.append(now)
                    now = 0
                now += size[int(found[1], 16)]
            elif line.startswith("IN:"):
                is_new, start = True, None
            elif is_new and (found := BLOCK.match(line)):
                if start is None:
                    start = int(found[1], 16)
                    size[start] = 0
                size[start] += 1
            elif not line.strip():
                is_new = False
    if traced.returncode:
        sys.exit(f"{binary} {folder}: ended with {traced.returncode}")
    return stretches[1::2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="ruffini_one_frame for aarch64")
    parser.add_argument("folder", type=Path, nargs="*", help="a board and its pictures")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        if not arguments.folder:
            board = seventy_markers(320)
            arguments.folder = [Path(made) / "320x240"]
            make_data(board, arguments.folder[0], solve_tensors(board))
        report(arguments.binary, arguments.folder)


def traffic(folder: Path) -> tuple[int, int]:
    """Bytes that a frame moves with all of the pad touched, and products of its tables, larger than any cache.

    support.normal is gone through once for each step of the solver, the others once.
    """
    board = parse_board((folder / "board.toml").read_bytes(), str(folder))
    with (folder / "calibration.safetensors").open("rb") as file:
        listed = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    n_bytes = board.camera.width_px * board.camera.height_px * PIXEL_BYTES
    n_products = 0
    for name, tensor in listed.items():
        if not name.startswith(("operator.", "support.")):
            continue
        times = SOLVER_STEPS if name.startswith("support.normal.") else 1
        size = tensor["data_offsets"][1] - tensor["data_offsets"][0]
        n_bytes += times * size
        if name.endswith(".entry"):
            n_products += times * size // 2
    return n_bytes, n_products


def report(binary: Path, folders: list[Path]) -> None:
    for folder in folders:
        counted = count(binary, folder)
        if len(counted) != len(STAGES):
            sys.exit(f"{folder}: {len(counted)} stretches, {len(STAGES)} stages: STAGES is no longer the frame path's")
        counts = dict(zip(STAGES, counted, strict=True))
        counts["sum"] = sum(counts.values())
        print(f"{folder.name}: thousands of aarch64 instructions of one frame; ESTIMATED milliseconds")
        print(f"  {'':14}{'counted':>9}" + "".join(f"{name:>12}" for name, _, _ in CORES))
        for stage, n in counts.items():
            times = "".join(f"{n / (ghz * ipc) / 1e6:12.2f}" for _, ghz, ipc in CORES)
            print(f"  {stage:14}{n / 1e3:9.0f}{times}")
        n_bytes, n_products = traffic(folder)
        rows = [
            ("memory", f"{n_bytes / 1e6:7.1f}MB", [n_bytes / (rate * 1e6) for rate in MEMORY]),
            ("products", f"{n_products / 1e6:8.1f}M", [n_products / (ghz * PRODUCTS * 1e6) for _, ghz, _ in CORES]),
        ]
        for name, counted_as, floors in rows:
            print(f"  {name:14}{counted_as}" + "".join(f"{ms:12.2f}" for ms in floors))
        by_code = [counts["sum"] / (ghz * ipc) / 1e6 for _, ghz, ipc in CORES]
        print(
            f"  {'ESTIMATED frame':23}"
            + "".join(f"{max(ms):12.2f}" for ms in zip(by_code, *(r[2] for r in rows), strict=True))
        )
    assumed = zip(CORES, MEMORY, strict=True)
    print(
        "estimates: "
        + "; ".join(f"{name}: {ghz} GHz, {ipc} a cycle, {rate} GB/s" for (name, ghz, ipc), rate in assumed)
    )


if __name__ == "__main__":
    main()
