"""A sensor for who has none: the real daemon on a pty, the live twin as its camera, pressed again and again."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ruffini.boards import Board, find_board
from ruffini.cli.common import note, progress_bar
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.errors import InputError
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Scripted, TwinServer
from ruffini.sim.unit import TwinUnit

N_BALLS, BALL_MM = 40, 5.0


@contextlib.contextmanager
def running_demo(board_name: str) -> Iterator[str]:
    """A SIMULATED sensor, calibrated and pressed without end; yields its port.

    Raises
    ------
    InputError
        The board has no flat pad to press.
    """
    from ruffini.sim.units import build_unit

    board = find_board(board_name)
    with progress_bar("pad mechanics") as progress:
        unit = build_unit(board, progress=progress)
    if not isinstance(unit, TwinUnit) or not board.writes("node_forces"):
        raise InputError(f"--demo shows a force field: board {board.name!r} has none")
    calibration = _calibration(board, unit)
    scenario = Scenario()
    with progress_bar("touches") as progress:
        frames = Scripted(unit, scenario, progress)
    assert board.folder is not None
    with tempfile.TemporaryDirectory(prefix="ruffini-") as folder:
        socket = Path(folder) / "twin"
        twin = TwinServer(unit.renderer(), frames, scenario, socket)
        with progress_bar("pictures") as progress:
            twin.keep(len(frames), progress)
        with (
            twin,
            running_daemon(board.folder, f"twin:{socket}", Path(folder) / "store") as port,
        ):
            with Connection(port) as sensor:
                sensor.flash(calibration)
            yield port


def _calibration(board: Board, unit: TwinUnit) -> bytes:
    """What `make run` makes of the twin, kept for the next time."""
    from ruffini.calibrate import container
    from ruffini.estimators.operator.error_model import N_TOUCHES
    from ruffini.estimators.operator.fit import make_operator
    from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
    from ruffini.estimators.photometric.pad_view import Pinhole
    from ruffini.estimators.photometric.presses import load_presses
    from ruffini.fem.operators import Noise
    from ruffini.sim.recording import record_balls
    from ruffini.version import __version__

    assert board.folder is not None
    sources = [(board.folder / name).read_bytes() for name in ("board.toml", "twin.toml")]
    key = hashlib.sha256(b"\0".join([__version__.encode(), b"%d" % N_TOUCHES, *sources])).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ruffini"
    kept = cache / f"demo-{board.name}-{key}.safetensors"
    if kept.is_file():
        return kept.read_bytes()
    note(f"calibrating the simulated {board.name}, once: about a minute")
    c = board.camera
    pinhole = Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)
    with tempfile.TemporaryDirectory(prefix="ruffini-") as folder:
        with progress_bar("ball presses") as progress:
            record_balls(unit, N_BALLS, Path(folder) / "balls", ball_mm=BALL_MM, seed=11, progress=progress)
        with progress_bar("photometric") as progress:
            samples = collect_samples(load_presses(Path(folder) / "balls"), pinhole)
            fit = fit_photometric(samples, progress=progress)
    noise = Noise((5e-6, 5e-6, 20e-6), gauge_m=100e-6, tilt_m=30e-6)
    with progress_bar("inverse FEM") as progress:
        kind = make_operator(board, method="support", noise=noise, n_touches=N_TOUCHES, progress=progress)
    metadata = {**container.base_metadata(board), **kind.metadata, "residuals": json.dumps(fit.report())}
    file = container.pack({**kind.tensors, **tabulate(fit.model)}, metadata)
    with contextlib.suppress(OSError):  # next time it takes as long again
        cache.mkdir(parents=True, exist_ok=True)
        container.write(kept, file)
    return file.data
