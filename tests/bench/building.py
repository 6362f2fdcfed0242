"""What making an operator takes: `cal fit --only operator` on the default board's pad with 31 x 25 and 61 x 49 nodes.

Seven element layers, with the second pass. Each is a process of its own, so that time and memory are its own.
Wanted on two cores: 8 s for the smaller one, 4 minutes and 12 GB for the larger one.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ruffini.boards import Board, find_board

N_LAYERS = 7
GRIDS = ((31, 25), (61, 49))


@dataclass(frozen=True)
class Built:
    """Time, memory and size of one `cal fit --only operator`."""

    grid: tuple[int, int]
    touches: int
    seconds: float
    processor_s: float  # of all cores together
    peak_mb: float
    megabytes: float


def with_grid(board: Board, n_x: int, n_y: int) -> str:
    """The board's text with other nodes."""
    text = board.text
    for key, value in (("n_x", n_x), ("n_y", n_y), ("n_layers", N_LAYERS)):
        # [grid] comes before [markers], whose keys have the same names.
        text = re.sub(rf"(?m)^{key}\s*=\s*\d+", f"{key} = {value}", text, count=1)
    return text


def processor_seconds() -> float:
    """Of all child processes so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def build(board: Board, n_x: int, n_y: int, touches: int) -> Built:
    """Run the command."""
    with tempfile.TemporaryDirectory() as folder:
        variant = Path(folder) / board.name
        variant.mkdir()
        (variant / "board.toml").write_text(with_grid(board, n_x, n_y))
        command = [
            str(Path(sys.executable).parent / "ruffini"),
            "cal",
            "fit",
            "--only",
            "operator",
            "--json",
            "--touches",
            str(touches),
        ]
        command += ["--board", str(variant), "--out", str(Path(folder) / "cal.safetensors")]
        before = processor_seconds()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed: {done.stderr.strip()}")
    result = json.loads(done.stdout)
    assert result["grid"] == [n_x, n_y]
    used = processor_seconds() - before
    return Built((n_x, n_y), touches, result["seconds"], used, result["peak_mb"], result["bytes"] / 1e6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the smaller one only")
    arguments = parser.parse_args()
    board = find_board("gelslim")
    print(f"making and compiling an operator with its second pass, {N_LAYERS} layers")
    print(f"  {'nodes':>8}{'touches':>9}{'seconds':>10}{'of cores':>10}{'MB of memory':>14}{'MB of tables':>14}")
    jobs = [(*GRIDS[0], 0), (*GRIDS[0], 120)] + ([] if arguments.quick else [(*GRIDS[1], 0)])
    for n_x, n_y, touches in jobs:
        b = build(board, n_x, n_y, touches)
        print(f"  {f'{n_x} x {n_y}':>8}{touches:9d}{b.seconds:10.1f}{b.processor_s:10.1f}", end="")
        print(f"{b.peak_mb:14.0f}{b.megabytes:14.1f}", flush=True)


if __name__ == "__main__":
    main()
