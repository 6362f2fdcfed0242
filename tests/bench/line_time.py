"""Latency of the real ruffinid on a pseudo-terminal, idle and beside busy loops, ordinary and with real-time threads.

    python tests/bench/line_time.py [--frames 3600] [--loops 4]

Board and pictures are those of tests/bench/benchmarks.py at 320x240, SIMULATED and played in a loop at 60 frames a
second. Latency is the device's own (STATUS line_latency): from the picture's stamp, when it is handed over, to the last
byte of its WRENCH and CONTACTS that the line accepted. "Real-time" is SCHED_FIFO for all threads (this program needs
the right to it), CPU affinity of the frame thread and --lock-memory, as firmware/deploy/ruffinid.service grants them.
Beside the percentiles is the time of the stages in the same run.
"""

from __future__ import annotations

import argparse
import contextlib
import os
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

from ruffini.boards import Board
from ruffini.daemon import find_daemon
from ruffini.device import Connection

N_PICTURES, RATE_MHZ = 60, 60_000
WARM_S = 3.0  # rest is learned, every page was touched
PRIORITIES = {"capture": 42, "frame": 41, "link": 40}  # below the kernel's interrupt threads, 50
WANTED_MS = {"p50": 1.0, "p99.9": 3.0}  # above the frame's time


@dataclass(frozen=True)
class Run:
    """Milliseconds of one run."""

    placed: str
    n_frames: int
    frame_ms: float  # all stages, mean
    latency_ms: dict[str, float]
    n_lost: int


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


def measure(sensor: Path, board: Board, *, is_real_time: bool, n_frames: int) -> Run:
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
                before = host.status()
                statuses = read_for(host, n_frames * 1e3 / RATE_MHZ)
        finally:
            daemon.kill()
            daemon.wait(timeout=10)
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
    parser.add_argument("--frames", type=int, default=3600, help="of each of the four runs; an hour: 216000")
    parser.add_argument("--loops", type=int, default=2 * (os.cpu_count() or 1), help="busy loops beside it")
    arguments = parser.parse_args()
    board = seventy_markers(320)
    print(
        f"{os.cpu_count()} cores, load before {os.getloadavg()[0]:.1f}; milliseconds, SIMULATED pictures, this machine"
    )
    with tempfile.TemporaryDirectory(prefix="ruffini-line-time-") as made:
        sensor = Path(made) / "320x240"
        write_sensor(board, sensor)
        for n_loops in (0, arguments.loops):
            for is_real_time in (False, True):
                with busy(n_loops):
                    run = measure(sensor, board, is_real_time=is_real_time, n_frames=arguments.frames)
                shown = "  ".join(f"{name} {ms:.2f}" for name, ms in run.latency_ms.items())
                met = all(run.latency_ms[name] <= run.frame_ms + more for name, more in WANTED_MS.items())
                print(f"{n_loops} busy loops, {run.placed}: {run.n_frames} frames, {run.n_lost} lost", flush=True)
                print(f"    stages {run.frame_ms:.2f}   latency {shown}   wanted: stages + 1 at p50, + 3 at p99.9: "
                      f"{'met' if met else 'NOT met'}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
