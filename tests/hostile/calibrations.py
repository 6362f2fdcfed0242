"""A calibration for each simulated board, made once and kept in build/hostile."""

from __future__ import annotations

import json
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
    from ruffini.demo.main_job import BALL_MM, DEMO_ERROR, N_BALLS, NOISE
    from ruffini.estimators.operator.error_model import N_TOUCHES
    from ruffini.estimators.operator.fit import make_operator
    from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
    from ruffini.estimators.photometric.pad_view import Pinhole
    from ruffini.estimators.photometric.presses import load_presses
    from ruffini.sim.recording import record_balls
    from ruffini.sim.unit import PadError, TwinUnit

    board = find_board(name)
    c = board.camera
    record_balls(
        TwinUnit.build(board, PadError(**DEMO_ERROR)), N_BALLS, path.parent / "balls", ball_mm=BALL_MM, seed=11
    )
    pinhole = Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)
    fit = fit_photometric(collect_samples(load_presses(path.parent / "balls"), pinhole))
    kind = make_operator(board, method="support", noise=NOISE, n_touches=N_TOUCHES)
    metadata = {**container.base_metadata(board), **kind.metadata, "residuals": json.dumps(fit.report())}
    container.write(path, container.pack({**kind.tensors, **tabulate(fit.model)}, metadata))
