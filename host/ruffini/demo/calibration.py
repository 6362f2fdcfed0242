"""The calibration of a board's twin for a first look: `make run` and `ruffini view --demo` flash it.

| the board's forces are | fitted on |
| --- | --- |
| of finite elements (stage `operator`) | ball presses for the colours, where it measures depth; the pad by board.toml |
| of any other estimator | the few presses of its demo.toml, made by the twin; colours likewise |

A look: few presses, no gates. For newtons to rely on there is `ruffini cal auto`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile
from ruffini.cli.common import note, progress_bar
from ruffini.errors import InputError
from ruffini.estimators.operator.error_model import N_TOUCHES
from ruffini.estimators.operator.fit import make_operator
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.pad_view import Pinhole
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.table import task_of
from ruffini.estimators.task import Turned
from ruffini.fem.operators import Noise
from ruffini.sim.recording import record_balls
from ruffini.sim.rig import Unit
from ruffini.sim.unit import TwinUnit
from ruffini.version import __version__

N_BALLS, BALL_MM = 40, 5.0
NOISE = Noise((5e-6, 5e-6, 20e-6), gauge_m=100e-6, tilt_m=30e-6)
# Without a calibrated depth u_z is not observed: the operator marginalises it.
NOISE_WITHOUT_DEPTH = Noise((5e-6, 5e-6, 1e-3))
BENCH = "demo.toml"
MAX_WORKERS = 4


def has_field(board: Board) -> bool:
    """True if the board computes the forces at the nodes."""
    return board.writes("node_forces")


def measures_depth(board: Board) -> bool:
    """True if the board measures depth from its colours."""
    return board.writes("slope") and "depth" not in board.board.not_measured


def calibrated(board: Board, unit: Unit, folder: Path) -> tuple[CalibrationFile, dict[str, Any]]:
    """The calibration of a simulated unit, and what the fit of its colours reports; presses are left in `folder`.

    Raises
    ------
    InputError
        The board's forces are not of finite elements, and it has no demo.toml.
    """
    balls = None
    if measures_depth(board):
        pressed = unit if has_field(board) else TwinUnit.build(board)  # a pad whose tray does not give way
        assert isinstance(pressed, TwinUnit)
        balls = folder / "balls"
        with progress_bar("ball presses") as progress:
            record_balls(pressed, N_BALLS, balls, ball_mm=BALL_MM, seed=11, progress=progress)
    if not has_field(board):
        return _of_bench(board, folder, balls), {}
    tensors, report = {}, {}
    if balls is not None:
        with progress_bar("photometric") as progress:
            fit = fit_photometric(collect_samples(load_presses(balls), _pinhole(board)), progress=progress)
        tensors, report = tabulate(fit.model), fit.report()
    kind_of = "support" if board.writes("residual") else "optimal"
    noise = NOISE_WITHOUT_DEPTH if balls is None else NOISE
    with progress_bar("inverse FEM") as progress:
        kind = make_operator(board, method=kind_of, noise=noise, n_touches=N_TOUCHES, progress=progress)
    metadata = {**container.base_metadata(board), **kind.metadata, "residuals": json.dumps(report)}
    return container.pack({**kind.tensors, **tensors}, metadata), report


def kept_calibration(board: Board, unit: Unit) -> CalibrationFile:
    """`calibrated` of a unit that is as its board file says, kept in the user's cache for the next time."""
    kept = _cache() / f"demo-{board.name}-{_digest(board)}.safetensors"
    if kept.is_file():
        return container.read(kept)
    note(f"calibrating the simulated {board.name}, once: about a minute")
    with tempfile.TemporaryDirectory(prefix="ruffini-") as folder:
        file, _ = calibrated(board, unit, Path(folder))
    with contextlib.suppress(OSError):  # next time it takes as long again
        kept.parent.mkdir(parents=True, exist_ok=True)
        container.write(kept, file)
    return file


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ruffini"


def _digest(board: Board) -> str:
    assert board.folder is not None
    files = [board.folder / name for name in ("board.toml", "twin.toml", BENCH)]
    sources = [path.read_bytes() for path in files if path.is_file()]
    return hashlib.sha256(b"\0".join([__version__.encode(), b"%d" % N_TOUCHES, *sources])).hexdigest()[:16]


def _pinhole(board: Board) -> Pinhole:
    c = board.camera
    return Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)


def _of_bench(board: Board, folder: Path, balls: Path | None) -> CalibrationFile:
    from ruffini.calibrate.auto.fingertip import eyes_apart_mm
    from ruffini.calibrate.fit.job import Job
    from ruffini.calibrate.fit.run import finished, run_stages
    from ruffini.sim.optics.known_points import write_known_points
    from ruffini.sim.reproduce.make import reproduce

    presses, n_workers = folder / "presses", min(MAX_WORKERS, os.cpu_count() or 1)
    with progress_bar("presses") as progress:
        outcome = reproduce(board, presses, bench=BENCH, n_workers=n_workers, progress=progress)
    if not outcome.n_made:
        raise InputError(f"{BENCH} of {board.name}: no press has a solution: {next(iter(outcome.failed.values()))}")
    is_tube = board.skin is not None and board.skin.shape == "tube"
    points = write_known_points(board, folder) if is_tube else None
    baseline_mm = eyes_apart_mm(board) if isinstance(task_of(board), Turned) else None
    job = Job(board, [presses], balls=balls, points=points, baseline_mm=baseline_mm)
    with progress_bar("fit") as progress:
        outcomes = run_stages(job, frozenset(), tell=lambda *_: None, progress=lambda _, done: progress(done))
        return finished(job, outcomes)[0]
