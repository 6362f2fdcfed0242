"""Instructions, loads and cache lines of each stage on 64-bit ARM under qemu, and what three kinds of cores may take.

    make profile

    cmake -S . -B BUILD -DCMAKE_TOOLCHAIN_FILE=.ci/aarch64.cmake -DRUFFINI_DAEMON=OFF -DRUFFINI_TESTS=OFF
    cmake --build BUILD --target ruffini_one_frame
    tests/bench/instructions.py --binary BUILD/ruffini_one_frame [--functions N] [--table FILE] [FOLDER...]

FOLDER: as tests/bench/benchmarks.py leaves it in build/bench; if it is missing, the script makes the recordings and
calibrations that it needs.
Three frames are counted: an untouched one, the first of a press and the next one. Loads and cache lines are those of
the first of a press; the caches are a model (tests/bench/stage_counts.c). All counts are exact and the same on every
machine. The times are estimates, not measurements: instructions over clock and over
instructions a cycle as such cores reach on integer vector code. Beside them bytes of tables and pictures over
what the memory is stated to give at best, and products of tables over what the core multiplies at best, both as if the
whole pad were touched. The frame is the largest of the three, as if each hid behind the others.
Energy is an estimate, too: of the instructions and of the lines fetched from memory, with energies that others
published (INSTRUCTION_NJ, LINE_NJ), beside what a USB 2.0 port gives.
"""

from __future__ import annotations

import argparse
import datetime
import json
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks import make_data, seventy_markers, solve_tensors
from gels import with_row

from ruffini.boards import parse_board
from ruffini.files import write_whole

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

# Name, clock in GHz as Raspberry Pi states it (Cortex-A53, A72, A76), instructions a cycle that are assumed.
CORES = (("Pi Zero 2 W", 1.0, 0.7), ("Pi 4", 1.8, 1.4), ("Pi 5", 2.4, 2.2))
# GB/s of the memory, 32 bits wide, of the type that Raspberry Pi states: LPDDR2 (900 MT/s), LPDDR4 3200, LPDDR4X 4267.
MEMORY = (3.6, 12.8, 17.1)
# int16 products a cycle into int32: one SMLAL of four lanes, as Arm's optimization guides of A72 and A76 have it; of
# the A53 there is none, and the same is assumed.
PRODUCTS = 4
# Energy of an instruction of a Cortex-A53 at the board's supply, regulator and memory included: four such cores of a
# Raspberry Pi 3B take 0.85 A under stress and 0.30 A at rest, of 5.1 V at 1.2 GHz (raspberrypi/documentation,
# power-supplies.adoc, 025e1ad), divided by CORES' instructions a cycle. A Pi Zero 2 W has the same cores at 1.0 GHz.
INSTRUCTION_NJ = (0.85 - 0.30) * 5.1 / (4 * 1.2) / CORES[0][2]
# Energy of a line of 64 bytes from memory: 2.6 nJ per 64 bits, the upper end of 1.3 to 2.6 (M. Horowitz, "Computing's
# energy problem", ISSCC 2014).
LINE_NJ = 8 * 2.6
USB_MW = 2500.0  # of a USB 2.0 port: 0.5 A of 5 V
RATES_HZ = (30, 60)
SOLVER_STEPS = 9  # SupportSolver: kRounds (kSteps + 1)
# Bytes of a pixel through camera memory, copy, difference (rest and its reciprocal, change, grey) and photometric.
PIXEL_BYTES = 3 + 3 + 3 + (6 + 6 + 6 + 2) + 6
# In the order of benchmarks.py's frame path; light is what follows the light, uncertainty the error model.
STAGES = (
    "difference", "markers", "light", "photometric", "poisson", "displacement",
    "zero", "operator", "support", "wrench", "contacts", "uncertainty", "depth_validity",
)  # fmt: skip
FRAMES = ("untouched", "touched", "next")
SECTION = "## Instructions of one frame"
ENERGY_SECTION = "## Energy of one frame"
SHOWN = 0.7e6  # instructions of a stage at either size, from which on the document has a row of it
# The code that the figures depend on: commits of anything else change none.
JUDGED = ("firmware", "host/ruffini", "boards/gelslim", "CMakeLists.txt", ".ci/aarch64.cmake",
          "tests/bench/benchmarks.py", "tests/bench/one_frame.cpp", "tests/bench/instructions.py",
          "tests/bench/stage_counts.c", ":!*.md")  # fmt: skip
COMPILER = "12"  # the major version of aarch64-linux-gnu-g++ that the document's counts are of
PLUGIN = Path(__file__).with_name("stage_counts.c")
FIRST_QEMU_OF_API_2 = 9


@dataclass
class Stretch:
    """What one stage does in one frame."""

    instructions: int
    loads: int
    stores: int
    l1_lines: int
    l2_lines: int
    functions: list[tuple[int, str]] = field(default_factory=list)


Frames = dict[str, dict[str, Stretch]]  # by name of the frame and of the stage


def build_plugin(folder: Path) -> Path:
    version = subprocess.run(["qemu-aarch64", "--version"], capture_output=True, text=True, check=True).stdout
    found = re.search(r"version (\d+)", version)
    if found is None:
        sys.exit(f"qemu-aarch64 --version states no version: {version.strip()}")
    api = 1 if int(found[1]) < FIRST_QEMU_OF_API_2 else 2
    plugin = folder / "stage_counts.so"
    subprocess.run(
        ["cc", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC", f"-DQEMU_API={api}", str(PLUGIN), "-o", str(plugin)],
        check=True,
    )
    return plugin


def count(binary: Path, folder: Path) -> list[Stretch]:
    """What happens between each pair of calls of the clock."""
    with tempfile.TemporaryDirectory() as made:
        command = ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu", "-plugin", str(build_plugin(Path(made)))]
        done = subprocess.run([*command, str(binary), str(folder)], stderr=subprocess.PIPE, text=True, check=False)
    stretches: list[Stretch] = []
    for line in done.stderr.splitlines():
        kind, *values = line.split()
        if kind == "stretch":
            stretches.append(Stretch(*map(int, values)))
        elif kind == "function":
            stretches[-1].functions.append((int(values[0]), values[1]))
    if done.returncode or not stretches:
        sys.exit(f"{binary} {folder}: ended with {done.returncode}: {done.stderr.strip()[-500:]}")
    return stretches[1::2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="ruffini_one_frame for aarch64")
    parser.add_argument("--functions", type=int, default=0, metavar="N", help="print the N longest functions too")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    parser.add_argument("folder", type=Path, nargs="*", help="a board and its pictures")
    arguments = parser.parse_args()
    if arguments.table is not None and (found := compiler()) != COMPILER:
        print(f"{arguments.table} is left as it is: its counts are of GCC {COMPILER}, these are of GCC {found}")
        arguments.table = None
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    with tempfile.TemporaryDirectory() as made:
        if not arguments.folder:
            boards = [seventy_markers(width_px) for width_px in (320, 640)]
            tensors = solve_tensors(boards[0])
            for board in boards:
                arguments.folder.append(Path(made) / f"{board.camera.width_px}x{board.camera.height_px}")
                make_data(board, arguments.folder[-1], tensors)
        counted = {folder.name: report(arguments.binary, folder, arguments.functions) for folder in arguments.folder}
    assumed = zip(CORES, MEMORY, strict=True)
    print(
        "estimates: "
        + "; ".join(f"{name}: {ghz} GHz, {ipc} a cycle, {rate} GB/s" for (name, ghz, ipc), rate in assumed)
    )
    if arguments.table is not None:
        text = arguments.table.read_text()
        for row in document_rows(counted):
            text = with_row(text, f"{row} {at} | {date} |", SECTION, columns(counted))
        for row in energy_rows(counted):
            text = with_row(text, f"{row} {at} | {date} |", ENERGY_SECTION, energy_columns(counted))
        write_whole(arguments.table, text.encode())


def compiler() -> str:
    """Major version of the cross compiler."""
    command = ["aarch64-linux-gnu-g++", "-dumpversion"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split(".")[0].strip()


def columns(counted: dict[str, Frames]) -> list[str]:
    """Heads of the document's table."""
    of_size = ("untouched", "touched", "share", "loads", "lines")
    return ["stage", *(f"{name}: {what}" for name in counted for what in of_size), "commit", "date"]


def document_rows(counted: dict[str, Frames]) -> list[str]:
    """The document's rows, without commit and date: of the stages that count, and of the frame."""
    out = []
    for stage in STAGES:
        of_sizes = [([frames["untouched"][stage]], [frames["touched"][stage]]) for frames in counted.values()]
        if max(s.instructions for pair in of_sizes for part in pair for s in part) >= SHOWN:
            out.append(f"| {stage} | {' | '.join(cells(*pair) for pair in of_sizes)} |")
    whole = [(list(frames["untouched"].values()), list(frames["touched"].values())) for frames in counted.values()]
    return [*out, f"| **frame** | {' | '.join(cells(*pair) for pair in whole)} |"]


def energy_mj(stretches: list[Stretch]) -> float:
    """ESTIMATED energy of a part of a frame on a Pi Zero 2 W."""
    return sum(s.instructions * INSTRUCTION_NJ + s.l2_lines * LINE_NJ for s in stretches) * 1e-6


def energy_columns(counted: dict[str, Frames]) -> list[str]:
    of_size = ("mJ", *(f"mW at {rate} Hz" for rate in RATES_HZ), f"of {USB_MW / 1e3:g} W")
    return ["stage", *(f"{name}: {what}" for name in counted for what in of_size), "commit", "date"]


def energy_rows(counted: dict[str, Frames]) -> list[str]:
    """As document_rows: the same stages, the touched frame."""
    out = []
    for stage in STAGES:
        stretches = [frames[frame][stage] for frames in counted.values() for frame in ("untouched", "touched")]
        if max(s.instructions for s in stretches) >= SHOWN:
            parts = [energy_cells([frames["touched"][stage]]) for frames in counted.values()]
            out.append(f"| {stage} | {' | '.join(parts)} |")
    whole = [energy_cells(list(frames["touched"].values())) for frames in counted.values()]
    return [*out, f"| **frame** | {' | '.join(whole)} |"]


def energy_cells(stretches: list[Stretch]) -> str:
    """Four cells: millijoules of a frame, milliwatts at each rate, share of a USB port's power at the last."""
    energy = energy_mj(stretches)
    powers = [energy * rate for rate in RATES_HZ]
    return f"{energy:.2f} | {' | '.join(f'{mw:.0f}' for mw in powers)} | {powers[-1] / USB_MW:.0%}"


def cells(untouched: list[Stretch], touched: list[Stretch]) -> str:
    """Five cells: thousands of instructions of both frames, their ratio, loads, and lines fetched into both caches."""
    loads, l1, l2 = (sum(getattr(s, name) for s in touched) for name in ("loads", "l1_lines", "l2_lines"))
    before, after = (sum(s.instructions for s in some) for some in (untouched, touched))
    counts = f"{before / 1e3:,.0f} | {after / 1e3:,.0f} | {share(before, after)}"
    return f"{counts} | {loads / 1e3:,.0f} | {l1 / 1e3:.0f}; {l2 / 1e3:.0f}"


def share(untouched: int, touched: int) -> str:
    """Of a touched frame's instructions that an untouched one takes."""
    return f"{untouched / touched:.2f}"


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


def in_clear(name: str) -> str:
    return subprocess.run(["c++filt", name], capture_output=True, text=True, check=True).stdout.strip()


def print_functions(stages: dict[str, Stretch], n_longest: int) -> None:
    for stage, stretch in stages.items():
        for n, name in sorted(stretch.functions, reverse=True)[:n_longest]:
            print(f"  {stage:14}{n / 1e3:9.0f}  {in_clear(name)}")


def report(binary: Path, folder: Path, n_functions: int) -> Frames:
    """Count a board's frames, and print the tables."""
    counted = count(binary, folder)
    if len(counted) != len(STAGES) * len(FRAMES):
        sys.exit(
            f"{folder}: {len(counted)} stretches, {len(STAGES)} stages in {len(FRAMES)} frames: "
            "STAGES is no longer the frame path's"
        )
    frames = {frame: dict(zip(STAGES, counted[i * len(STAGES) :], strict=False)) for i, frame in enumerate(FRAMES)}
    print(f"{folder.name}: thousands a frame, aarch64 instructions; loads, stores and lines of the touched frame")
    columns = (*FRAMES, "loads", "stores", "L1 lines", "L2 lines")
    print(f"  {'':14}" + "".join(f"{name:>10}" for name in columns) + f"{'untouched / touched':>21}")
    sums = [0] * len(columns)
    for stage, touched in frames["touched"].items():
        row = [frames[frame][stage].instructions for frame in FRAMES]
        row += [touched.loads, touched.stores, touched.l1_lines, touched.l2_lines]
        sums = [a + b for a, b in zip(sums, row, strict=True)]
        print(f"  {stage:14}" + "".join(f"{n / 1e3:10.1f}" for n in row) + f"{share(row[0], row[1]):>21}")
    print(f"  {'sum':14}" + "".join(f"{n / 1e3:10.1f}" for n in sums) + f"{share(sums[0], sums[1]):>21}")
    if n_functions:
        print_functions(frames["touched"], n_functions)
    print(f"{folder.name}: ESTIMATED energy of the touched frame, Pi Zero 2 W; of a USB port's {USB_MW / 1e3:g} W")
    parts = {stage: [touched] for stage, touched in frames["touched"].items()}
    for stage, stretches in {**parts, "sum": list(frames["touched"].values())}.items():
        mj = energy_mj(stretches)
        powers = "".join(f"{mj * rate:8.0f} mW at {rate} Hz" for rate in RATES_HZ)
        print(f"  {stage:14}{mj:9.2f} mJ{powers}{mj * RATES_HZ[-1] / USB_MW:8.1%}")
    counts = {stage: stretch.instructions for stage, stretch in frames["touched"].items()}
    counts["sum"] = sum(counts.values())
    print(f"{folder.name}: ESTIMATED milliseconds of the touched frame")
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
    return frames


if __name__ == "__main__":
    main()
