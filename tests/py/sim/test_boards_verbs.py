"""The twin's verbs on boards that are no marked pad: glitter, and a dome seen by two cameras."""

import json
import os
import shutil
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.demo.daemon import running_daemon
from ruffini.device import Connection

COARSER = {  # so that every verb takes seconds
    "contact-glitter": ("cells_x = 18\ncells_y = 14", "cells_x = 10\ncells_y = 8"),
    "stereo-fingertip": ("cells = 18", "cells = 8"),
}


@pytest.fixture(scope="module", params=sorted(COARSER))
def board(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards") / request.param
    shutil.copytree(find_board(request.param).folder, folder)
    old, new = COARSER[request.param]
    text = (folder / "twin.toml").read_text()
    assert old in text
    (folder / "twin.toml").write_text(text.replace(old, new))
    return folder


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    return {**os.environ, "XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache")), "OMP_NUM_THREADS": "1"}


def command(*words):
    return [sys.executable, "-c", "from ruffini.cli import main; import sys; sys.exit(main())", *map(str, words)]


def ruffini(environment, *words):
    return subprocess.run(command(*words), capture_output=True, text=True, timeout=120, env=environment)


def test_press_records_pictures_and_the_load(board, environment, tmp_path):
    out = tmp_path / "out"
    done = ruffini(
        environment, "sim", "press", "--board", board, "--program", "press", "--indenter", "square",
        "--radius-mm", 5, "--depth-mm", 0.6, "--out", out, "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    frames = json.loads(done.stdout)["frames"]
    assert len(list((out / "frames").iterdir())) == frames
    with np.load(out / "truth.npz") as truth:
        load, depth = -truth["wrench"][:, 2], truth["pose"][:, 2]
    deepest = int(np.nanargmax(depth))
    assert depth[deepest] == pytest.approx(0.6e-3)
    assert load[deepest] > 0.05
    assert load[np.isnan(depth)] == pytest.approx(0, abs=1e-6)


def test_dataset_holds_what_was_asked_for(board, environment, tmp_path):
    out = tmp_path / "d"
    done = ruffini(environment, "sim", "dataset", "--board", board, "--n", 2, "--shard-size", 2, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["samples"] == 2
    (shard,) = out.glob("*.h5")
    with h5py.File(shard) as file:
        wrench = file["wrench"][:]
    assert len(wrench) == 2
    assert (wrench[:, 2] < 0).all()


def test_bench_measures_pictures_and_mechanics(board, environment):
    done = ruffini(environment, "sim", "bench", "--board", board, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["rendering_fps"] > 1
    assert result["mechanics_fps"] > 0.2


def test_serve_feeds_a_daemon(board, environment, tmp_path):
    socket = tmp_path / "twin"
    (tmp_path / "s.toml").write_text('schema = 1\nprogram = "rest"\nn = 12\n')
    words = (
        "sim",
        "serve",
        "--board",
        board,
        "--socket",
        socket,
        "--scenario",
        tmp_path / "s.toml",
        "--once",
        "--json",
    )
    with subprocess.Popen(command(*words), stdout=subprocess.PIPE, text=True, env=environment) as twin:
        deadline = time.monotonic() + 60
        while not socket.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        with (
            running_daemon(board, f"twin:{socket}", tmp_path / "store", "--lockstep", "--wait-for-host") as port,
            Connection(port) as sensor,
        ):
            sensor.subscribe(wrench=1)
            assert next(sensor.stream(timeout_s=10.0)) is not None
            output, _ = twin.communicate(timeout=60)
    assert json.loads(output) == {"frames": 12, "simulated": True}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--program", "press", "--depth-mm", "15"), "press less deep"),
        (("--program", "connector"), "no platform that a connector could load"),
        (("--program", "press", "--indenter", "spoon"), "spoon"),
    ],
)
def test_what_a_body_cannot_do_is_one_sentence(board, environment, tmp_path, words, sentence):
    done = ruffini(environment, "sim", "press", "--board", board, *words, "--out", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1


def test_balls_need_a_flat_pad(environment, tmp_path):
    done = ruffini(
        environment, "sim", "press", "--board", "stereo-fingertip", "--program", "balls", "--n", 1, "--out", tmp_path
    )
    assert done.returncode == 2
    assert "balls calibrate colour on a flat pad" in done.stderr
