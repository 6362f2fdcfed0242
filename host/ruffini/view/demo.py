"""A sensor for who has none: the real daemon on a pty, the live twin as its camera, pressed again and again."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ruffini.boards import find_board
from ruffini.cli.common import progress_bar
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Scripted, TwinServer


@contextlib.contextmanager
def running_demo(board_name: str) -> Iterator[str]:
    """A SIMULATED sensor, calibrated and pressed without end; yields its port.

    Raises
    ------
    InputError
        The board has no twin.
    """
    from ruffini.demo.calibration import kept_calibration
    from ruffini.sim.units import build_unit

    board = find_board(board_name)
    with progress_bar("pad mechanics") as progress:
        unit = build_unit(board, progress=progress)
    calibration = kept_calibration(board, unit)
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
                sensor.flash(calibration.data)
            yield port
