"""Does a learned network delay the frame path? The real ruffinid at the camera's pace, without and with a network.

    python tests/bench/learned.py --board BOARD --frames RECORDING --network FILE [--calibration FILE]

RECORDING is a folder with frames/, played in a loop. Prints milliseconds of all stages of a frame (mean, and largest of
each second's, from STATUS), frames that were lost, the most memory, and the network's own rate, time and latency.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ruffini.boards import Board, find_board
from ruffini.daemon import find_daemon
from ruffini.device import Connection, Learned

NAME = "network.onnx"
WARM_S = 3.0  # rest is learned, the network is loaded


@dataclass(frozen=True)
class Figures:
    """Of one run."""

    frame_ms: float
    most_ms: float
    rate_hz: float
    lost: int
    memory_mb: int
    learned: list[Learned]


@contextlib.contextmanager
def daemon(folder: Path, frames: Path, store: Path) -> Iterator[tuple[str, int]]:
    """A running ruffinid; gives its port and process."""
    command = [str(find_daemon()), "--board", str(folder), "--camera", f"replay:{frames}", "--link", "pty",
               "--store", str(store), "--loop"]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().removeprefix("link: ").strip(), process.pid
    finally:
        process.kill()
        process.wait(timeout=10)


def board_folder(board: Board, root: Path, has_network: bool) -> Path:
    """The board, asking for the network or not."""
    assert board.folder is not None
    folder = root / board.name
    shutil.copytree(board.folder, folder)
    if has_network:
        with (folder / "board.toml").open("a") as file:
            file.write(f'\n[learned]\nnetwork = "{NAME}"\n')
    return folder


def measure(board: Board, frames: Path, network: Path | None, calibration: Path | None, seconds: float) -> Figures:
    with tempfile.TemporaryDirectory(prefix="ruffini-learned-") as scratch:
        root, store = Path(scratch), Path(scratch) / "store"
        store.mkdir()
        folder = board_folder(board, root, network is not None)
        if network is not None:
            shutil.copy(network, store / NAME)
        with daemon(folder, frames, store) as (port, pid), Connection(port) as host:
            if calibration is not None:
                host.flash(calibration.read_bytes())
            host.subscribe(contacts=1, markers=1, learned=1, status=1)
            status, learned = [], []
            end = time.monotonic() + WARM_S + seconds
            for frame, message in host.stream(timeout_s=10):
                kind = host.schema.type_name(frame.type)
                is_warm = time.monotonic() > end - seconds
                if kind == "STATUS" and is_warm:
                    status.append(message)
                elif kind == "LEARNED" and is_warm:
                    learned.append(Learned.from_message(message))
                if time.monotonic() > end:
                    break
            memory_mb = most_memory_mb(pid)
    means = [sum(t.mean_ns for t in s.stage_times) for s in status]
    worst = max(sum(t.max_ns for t in s.stage_times) for s in status)
    first, last = status[0], status[-1]
    rate = (last.frames_processed - first.frames_processed) / (last.uptime_us - first.uptime_us) * 1e6
    lost = last.drops.capture_overrun - first.drops.capture_overrun
    return Figures(float(np.mean(means)) * 1e-6, worst * 1e-6, rate, lost, memory_mb, learned)


def most_memory_mb(pid: int) -> int:
    """Most that a process ever had resident."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("VmHWM:"))) // 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", required=True)
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument("--network", type=Path, required=True)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    board = find_board(options.board)
    print(f"{'':20}{'frame, ms':>10}{'longest':>9}{'Hz':>7}{'lost':>6}{'MB':>6}")
    for name, network in (("without a network", None), ("with", options.network)):
        f = measure(board, options.frames, network, options.calibration, options.seconds)
        print(f"{name:20}{f.frame_ms:10.2f}{f.most_ms:9.2f}{f.rate_hz:7.2f}{f.lost:6d}{f.memory_mb:6d}")
    if f.learned:
        took, late = (np.median([getattr(one, key) for one in f.learned]) * 1e3 for key in ("took_s", "latency_s"))
        rate = np.median([one.rate_hz for one in f.learned])
        print(f"the network: {took:.0f} ms a frame, {late:.0f} ms behind it, {rate:.2f} Hz, {len(f.learned)} results")
    else:
        print("the network said nothing")


if __name__ == "__main__":
    main()
