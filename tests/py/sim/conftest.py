"""A coarse simulated unit, solved once; a daemon that a twin serves."""

import functools
import json
import os
import subprocess
import sys

import pytest
from command_line import run_ruffini
from hang import HANG_S, until
from kept import kept

from ruffini.boards import find_board
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit


@pytest.fixture(scope="session")
def coarse_unit() -> TwinUnit:
    board = find_board("gelslim")
    pad = board.pad
    model = PadModel(
        pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6, pad.modulus_pa,
        pad.poisson_1e4 * 1e-4, n_cells_x=12, n_cells_y=10, layers=(0.3, 0.7),
    )  # fmt: skip
    return TwinUnit(board, load_twin(board), model, kept(surface_compliance, model))


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    return {**os.environ, "XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache")), "OMP_NUM_THREADS": "1"}


def command(*words):
    return [sys.executable, "-c", "from ruffini.cli import main; import sys; sys.exit(main())", *map(str, words)]


@pytest.fixture(scope="module")
def ruffini(environment):
    """Runs `ruffini` with the words given, its cache private to the module."""
    return functools.partial(run_ruffini, XDG_CACHE_HOME=environment["XDG_CACHE_HOME"])


@pytest.fixture
def serve_once(environment, tmp_path):
    """Plays twelve untouched frames of a board to the daemon by `ruffini sim serve --once`."""

    def serve(board):
        socket, scenario = tmp_path / "twin", tmp_path / "s.toml"
        scenario.write_text('schema = 1\nprogram = "rest"\nn = 12\n')
        words = ("sim", "serve", "--board", board, "--socket", socket, "--scenario", scenario, "--once", "--json")
        with subprocess.Popen(command(*words), stdout=subprocess.PIPE, text=True, env=environment) as twin:
            until(socket.exists, "the twin's socket")
            with (
                running_daemon(board, f"twin:{socket}", tmp_path / "store", "--lockstep", "--wait-for-host") as port,
                Connection(port) as sensor,
            ):
                sensor.subscribe(wrench=1)
                assert next(sensor.stream(timeout_s=HANG_S)) is not None
                output, _ = twin.communicate(timeout=HANG_S)
        assert json.loads(output) == {"frames": 12, "simulated": True}
        assert twin.returncode == 0
        assert not socket.exists()

    return serve
