"""How fast the digital twin is: each board on one core, datasets by one and two processes.

`--quick`: one board and a small dataset, to see that it runs; no figures to quote.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from ruffini.boards import board_names, find_board
from ruffini.sim.dataset.make import make_dataset
from ruffini.sim.dataset.plan import Plan
from ruffini.sim.unit import PadError

SAMPLES, QUICK_SAMPLES, SHARD = 192, 16, 8


def boards_with_twin() -> list[str]:
    """Names of the boards that can be simulated."""
    return [n for n in board_names() if (find_board(n).folder / "twin.toml").is_file()]


def board_row(name: str) -> str:
    """One board, measured in a process of its own: its memory is then its own."""
    code = "from ruffini.cli import main; import sys; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, "bench", "twin", "--board", name, "--json"], check=True, capture_output=True
    )
    result = json.loads(done.stdout)
    mechanics = f"{result['mechanics_fps']:9.1f}" if result["mechanics_fps"] else "        -"
    return f"{name:<18} {result['resolution']:>9} {result['rendering_fps']:9.1f} {mechanics} {result['memory_mb']:9.0f}"


def dataset_rates(board: str, n: int) -> tuple[float, float]:
    """Samples a second by one process and by two; the start of the processes counts."""
    plan = Plan.of(find_board(board), n=n, shard_size=SHARD, seed=1, error=PadError())
    rates = []
    for n_workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            outcome = make_dataset(plan, Path(folder), n_workers=n_workers)
            rates.append(outcome.n_samples_made / outcome.took_s)
    return rates[0], rates[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset-board", default="gelslim")
    parser.add_argument("--quick", action="store_true", help="this board only, fewer samples")
    arguments = parser.parse_args()
    n_samples = QUICK_SAMPLES if arguments.quick else SAMPLES
    print("\ntwin, SIMULATED, one core: frames a second")
    print(f"{'board':<18} {'picture':>9} {'rendered':>9} {'mechanics':>9} {'MB':>9}")
    for name in [arguments.dataset_board] if arguments.quick else boards_with_twin():
        print(board_row(name), flush=True)
    one, two = dataset_rates(arguments.dataset_board, n_samples)
    print(
        f"dataset of {arguments.dataset_board}, {n_samples} samples: {one:.1f} a second by one process, "
        f"{two:.1f} by two (efficiency {two / one / 2:.2f})"
    )


if __name__ == "__main__":
    main()
