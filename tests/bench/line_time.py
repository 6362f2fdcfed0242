"""Latency of the real ruffinid on a pseudo-terminal, idle and beside busy loops, ordinary and with real-time threads.

    python tests/bench/line_time.py [--frames 3600] [--loops 4] [--only busy-real-time] [--table FILE]

Board and pictures are those of tests/bench/benchmarks.py at 320x240, SIMULATED and played in a loop at 60 frames a
second. Latency is the device's own (STATUS line_latency): from the picture's stamp, when it is handed over, to the last
byte of its WRENCH and CONTACTS that the line accepted. "Real-time" is SCHED_FIFO for all threads (this program needs
the right to it), CPU affinity of the frame thread and --lock-memory, as firmware/deploy/ruffinid.service grants them.
Who reads the line is then SCHED_FIFO too, below them: on a gripper it is another computer, without this load.
Beside the percentiles is the time of the stages in the same run, and the machine's own delay: that of a real-time
process below ruffini's which only waits for every tenth frame's time and then counts for as long as the stages take.
--table replaces the rows of that document's section SECTION; --beside says in their names what else ran.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import multiprocessing
import os
import queue
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from benchmarks import make_data, picture, seventy_markers, solve_tensors
from gels import with_row

from ruffini.boards import Board
from ruffini.daemon import find_daemon
from ruffini.device import Connection
from ruffini.files import write_whole

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

N_PICTURES, RATE_MHZ = 60, 60_000
WARM_S = 3.0  # rest is learned, every page was touched
PRIORITIES = {"capture": 42, "frame": 41, "link": 40}  # below the kernel's interrupt threads, 50
READER_PRIORITY, MACHINE_PRIORITY = 39, 38
WANTED_MS = {"p50": 1.0, "p99.9": 3.0}  # above the frame's time
QUANTILES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "largest": 1.0}
COUNTED_MS = 1.6  # the stages of this board, about
RUNS = ("idle", "idle-real-time", "busy", "busy-real-time")
SECTION = "## Latency up to the line"
COLUMNS = ("run", "frames", "not captured", "stages", "p50", "p99", "p99.9", "largest", "counting: p50", "p99.9",
           "commit", "date")  # fmt: skip
JUDGED = ("firmware", "tests/bench/line_time.py", ":!*.md")


@dataclass(frozen=True)
class Run:
    """Milliseconds of one run."""

    placed: str
    n_frames: int
    frame_ms: float  # all stages, mean
    latency_ms: dict[str, float]
    n_lost: int
    machine_ms: dict[str, float]  # the machine's own delay, of real-time runs with the right to that


def write_sensor(board: Board, folder: Path) -> None:
    """Calibration, board and a recording: rest, then a press."""
    make_data(board, folder, solve_tensors(board))
    (folder / "frames").mkdir()
    for i in range(N_PICTURES):
        is_pressed = i >= N_PICTURES // 2
        cv2.imwrite(str(folder / "frames" / f"{i:03d}.png"), picture(board, is_pressed=is_pressed, noise=i))
    (folder / "recording.toml").write_text(f"simulated = true\nrate_mhz = {RATE_MHZ}\n")


def real_time(text: str) -> str:
    """The board's text with real-time threads."""
    cpu = max(os.sched_getaffinity(0))
    keys = "".join(f"{role}_priority = {number}\n" for role, number in PRIORITIES.items())
    return f"{text}\n[threads]\n{keys}frame_cpus = [{cpu}]\n"


@contextlib.contextmanager
def busy(n_loops: int) -> Iterator[None]:
    """Programs that each want a core."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n_loops)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def take_priority(number: int) -> bool:
    """SCHED_FIFO for this process; False where it has no right to that, and stays as it is."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(number))
    except PermissionError:
        return False
    return True


def machine_delays(seconds: float, found: multiprocessing.Queue) -> None:
    """Milliseconds from every tenth frame's time to the end of COUNTED_MS of counting, below ruffini's priorities."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    take_priority(MACHINE_PRIORITY)
    period = 10 * 1e3 / RATE_MHZ
    delays = np.zeros(int(seconds / period))
    start = time.monotonic()
    for i in range(len(delays)):
        due = start + i * period
        time.sleep(max(due - time.monotonic(), 0.0))
        counted, now = 0.0, time.monotonic()
        while counted < COUNTED_MS * 1e-3:  # a step that takes long was not ours: it counts as a short one
            before, now = now, time.monotonic()
            counted += min(now - before, 1e-5)
        delays[i] = (now - due) * 1e3
    found.put({name: float(np.quantile(delays, part)) for name, part in QUANTILES.items()})


def own_delays(found: multiprocessing.Queue) -> dict[str, float]:
    try:
        return found.get(timeout=60)
    except queue.Empty:  # it ended early; the run is not lost
        return {}


def measure(sensor: Path, board: Board, *, is_real_time: bool, n_frames: int) -> Run:
    machine: multiprocessing.Queue = multiprocessing.Queue()
    with tempfile.TemporaryDirectory(prefix="ruffini-line-time-") as scratch:
        folder = Path(scratch) / board.name
        folder.mkdir()
        (folder / "board.toml").write_text(real_time(board.text) if is_real_time else board.text)
        command = [str(find_daemon()), "--board", str(folder), "--camera", f"replay:{sensor}", "--link", "pty",
                   "--store", str(Path(scratch) / "store"), "--loop"]  # fmt: skip
        daemon = subprocess.Popen([*command, *["--lock-memory"] * is_real_time], stdout=subprocess.PIPE, text=True)
        try:
            assert daemon.stdout is not None
            port = daemon.stdout.readline().removeprefix("link: ").strip()
            with Connection(port) as host:
                host.flash((sensor / "calibration.safetensors").read_bytes())
                read_for(host, WARM_S)
                seconds = n_frames * 1e3 / RATE_MHZ
                if has_priority := is_real_time and take_priority(READER_PRIORITY):
                    multiprocessing.Process(target=machine_delays, args=(seconds, machine), daemon=True).start()
                before = host.status()
                statuses = read_for(host, seconds)
        finally:
            daemon.kill()
            daemon.wait(timeout=10)
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    last = statuses[-1]
    late, place = last.line_latency, last.scheduling
    cpus = ",".join(str(i) for i in range(64) if place.cpus >> i & 1) or "any"
    locked = "locked" if place.is_memory_locked else "not locked"
    return Run(
        placed=f"priority {place.priority or 'ordinary'}, CPU {cpus}, memory {locked}",
        n_frames=late.n_frames,
        frame_ms=float(np.mean([sum(t.mean_ns for t in s.stage_times) for s in statuses])) * 1e-6,
        latency_ms={name: us / 1e3 for name, us in (("p50", late.p50_us), ("p99", late.p99_us),
                                                    ("p99.9", late.p999_us), ("largest", late.max_us))},
        n_lost=last.drops.capture_overrun - before.drops.capture_overrun,
        machine_ms=own_delays(machine) if has_priority else {},
    )  # fmt: skip


def read_for(host: Connection, seconds: float) -> list:
    """The STATUS messages of so long; latency is of the frames from here on."""
    host.subscribe(wrench=1, contacts=1, status=1)
    end = time.monotonic() + seconds
    found = []
    for frame, message in host.stream(timeout_s=20):
        if host.schema.type_name(frame.type) == "STATUS":
            found.append(message)
        if time.monotonic() > end and found:
            break
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=3600, help="of each run; an hour: 216000")
    parser.add_argument("--only", choices=RUNS, help="one of the four runs; without it all, one after the other")
    parser.add_argument("--loops", type=int, default=2 * (os.cpu_count() or 1), help="busy loops beside it")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    parser.add_argument("--beside", default="", help="what else runs on the machine, for the row's name")
    arguments = parser.parse_args()
    board = seventy_markers(320)
    at = commit(JUDGED)
    print(
        f"{os.cpu_count()} cores, load before {os.getloadavg()[0]:.1f}; milliseconds, SIMULATED pictures, this machine"
    )
    with tempfile.TemporaryDirectory(prefix="ruffini-line-time-") as made:
        sensor = Path(made) / "320x240"
        write_sensor(board, sensor)
        for name in [arguments.only] if arguments.only else RUNS:
            n_loops = arguments.loops if name.startswith("busy") else 0
            print(f"{name}: {arguments.frames * 1e3 / RATE_MHZ / 60:.1f} minutes", flush=True)
            with busy(n_loops):
                is_real_time = name.endswith("real-time")
                run = measure(sensor, board, is_real_time=is_real_time, n_frames=arguments.frames)
            met = all(run.latency_ms[part] <= run.frame_ms + more for part, more in WANTED_MS.items())
            print(f"{n_loops} busy loops, {run.placed}: {run.n_frames} frames, {run.n_lost} lost")
            print(f"    stages {run.frame_ms:.2f}   latency {shown(run.latency_ms)}   "
                  f"wanted: stages + 1 at p50, + 3 at p99.9: {'met' if met else 'NOT met'}", flush=True)  # fmt: skip
            if run.machine_ms:
                print(f"    counting {COUNTED_MS:.2f}  the machine's own {shown(run.machine_ms)}", flush=True)
            if arguments.table is not None:
                row = row_of(", ".join(part for part in (name, arguments.beside) if part), run, at)
                write_whole(arguments.table, with_row(arguments.table.read_text(), row, SECTION, COLUMNS).encode())


def row_of(name: str, run: Run, at: str) -> str:
    """Of the table, milliseconds."""
    own = (f"{run.machine_ms[part]:.1f}" if run.machine_ms else "" for part in ("p50", "p99.9"))
    times = (f"{ms:.1f}" for ms in (run.frame_ms, *run.latency_ms.values()))
    day = datetime.date.today().isoformat()
    return f"| {' | '.join((name, str(run.n_frames), str(run.n_lost), *times, *own, at, day))} |"


def shown(delays_ms: dict[str, float]) -> str:
    return "  ".join(f"{part} {ms:.2f}" for part, ms in delays_ms.items())


if __name__ == "__main__":
    main()
