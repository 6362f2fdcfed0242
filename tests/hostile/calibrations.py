"""A calibration for each simulated board, made once and kept in build/hostile."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.demo.calibration import calibrated
from ruffini.demo.main_job import DEMO_ERROR
from ruffini.sim.rig import Unit
from ruffini.sim.unit import PadError, TwinUnit
from ruffini.sim.units import build_unit

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "hostile"
FILE = "calibration.safetensors"


def calibration(name: str) -> bytes:
    """That of the main job; of a skin the demo's, as `cal auto` takes up to an hour; else `cal auto --quick`'s."""
    path = KEPT / name / FILE
    if not path.exists():
        print(f"  {name}: no calibration yet: making {path}", file=sys.stderr)
        path.parent.mkdir(parents=True, exist_ok=True)
        board = find_board(name)
        if "support" in board.pipeline.stages:
            _of_the_demo(board, TwinUnit.build(board, PadError(**DEMO_ERROR)), path)
        elif board.skin is not None:
            _of_the_demo(board, build_unit(board), path)
        else:
            verb = "import sys; from ruffini.cli import main; sys.exit(main())"
            options = ["--board", name, "--rig", "sim", "--quick", "--force", "--out", str(path.parent)]
            made = [sys.executable, "-c", verb, "cal", "auto", *options]
            subprocess.run(made, check=True, stdout=subprocess.DEVNULL)
    return path.read_bytes()


def _of_the_demo(board: Board, unit: Unit, path: Path) -> None:
    file, _ = calibrated(board, unit, path.parent)
    container.write(path, file)
