"""A calibration for each simulated board, made once and kept in build/hostile."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from ruffini.boards import find_board

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "hostile"
FILE = "calibration.safetensors"


def calibration(name: str) -> bytes:
    """That of the main job, or of `ruffini cal auto --rig sim --quick`."""
    path = KEPT / name / FILE
    if not path.exists():
        print(f"  {name}: no calibration yet: making {path}", file=sys.stderr)
        path.parent.mkdir(parents=True, exist_ok=True)
        stages = find_board(name).pipeline.stages
        if "support" in stages:
            _of_the_main_job(name, path)
        else:
            verb = "import sys; from ruffini.cli import main; sys.exit(main())"
            options = ["--board", name, "--rig", "sim", "--quick", "--force", "--out", str(path.parent)]
            made = [sys.executable, "-c", verb, "cal", "auto", *options]
            subprocess.run(made, check=True, stdout=subprocess.DEVNULL)
    return path.read_bytes()


def _of_the_main_job(name: str, path: Path) -> None:
    """As `ruffini demo` makes it, of the same simulated unit."""
    from ruffini.calibrate import container
    from ruffini.demo.calibration import calibrated
    from ruffini.demo.main_job import DEMO_ERROR
    from ruffini.sim.unit import PadError, TwinUnit

    board = find_board(name)
    file, _ = calibrated(board, TwinUnit.build(board, PadError(**DEMO_ERROR)), path.parent)
    container.write(path, file)
