"""The twin's verbs on every board that is no marked pad: whole recordings, and one sentence for what cannot be."""

import json
import re
import shutil

import h5py
import numpy as np
import pytest
from command_line import refusal_in

from ruffini.boards import find_board

COARSER = {  # twin.toml so that every verb takes seconds: replaced, or appended where there is nothing to replace
    "contact-glitter": ("cells_x = 18\ncells_y = 14", "cells_x = 10\ncells_y = 8"),
    "eltac": ("", "cells_x = 6\ncells_y = 12\n"),  # of [skin], which is the last section
    "ftouch": ("", "\n[mesh]\ncells_x = 10\ncells_y = 8\n"),
    "stereo-fingertip": ("cells = 18", "cells = 8"),
}
FEWER = 6  # the camera's rate is divided by this
SMALLER = {"contact-glitter": 2, "eltac": 5, "ftouch": 2, "stereo-fingertip": 4}  # pictures' sides are divided by this
RATE = r"(?m)(^rate_mhz = )(\d+)"
CAMERA_SIZES = r"((?:width_px|height_px|focal_mpx|center_x_mpx|center_y_mpx) = )(\d+)"


@pytest.fixture(scope="module", params=sorted(COARSER))
def board(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards") / request.param
    shutil.copytree(find_board(request.param).folder, folder)
    old, new = COARSER[request.param]
    text = (folder / "twin.toml").read_text()
    assert old in text
    (folder / "twin.toml").write_text(text.replace(old, new) if old else text + new)
    share, settings = SMALLER[request.param], (folder / "board.toml").read_text()
    smaller, n = re.subn(CAMERA_SIZES, lambda found: f"{found[1]}{int(found[2]) // share}", settings)
    assert n == 5
    slower, n = re.subn(RATE, lambda found: f"{found[1]}{int(found[2]) // FEWER}", smaller)
    assert n == 1
    (folder / "board.toml").write_text(slower)
    return folder


def test_press_records_pictures_and_the_load(board, ruffini, tmp_path):
    out = tmp_path / "out"
    done = ruffini("sim", "press", "--board", board, "--program", "press", "--indenter", "sphere",
        "--radius-mm", 5, "--depth-mm", 0.6, "--out", out, "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert len(list((out / "frames").iterdir())) == json.loads(done.out)["frames"]
    with np.load(out / "truth.npz") as truth:
        load, depth, tray = np.linalg.norm(truth["wrench"][:, :3], axis=1), truth["pose"][:, 2], truth["tray"]
    deepest = int(np.nanargmax(depth))
    assert depth[deepest] == pytest.approx(0.6e-3)
    assert load[deepest] > 0.05
    assert load[np.isnan(depth)] == pytest.approx(0, abs=1e-6)
    assert (tray[deepest, 2] < -1e-6) == (board.name == "ftouch")  # only one of them has a tray


def test_dataset_holds_what_was_asked_for(board, ruffini, tmp_path):
    out = tmp_path / "d"
    done = ruffini("sim", "dataset", "--board", board, "--n", 2, "--shard-size", 2, "--out", out, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["samples"] == 2
    (shard,) = out.glob("*.h5")
    with h5py.File(shard) as file:
        wrench = file["wrench"][:]
    assert (np.linalg.norm(wrench[:, :3], axis=1) > 0.01).all()


def test_serve_feeds_a_daemon_and_ends_with_it(board, serve_once):
    serve_once(board)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--program", "press", "--depth-mm", "15"), "press less deep"),
        (("--program", "press", "--indenter", "spoon"), "spoon"),
    ],
)
def test_what_a_body_cannot_do_is_one_sentence(board, ruffini, tmp_path, words, sentence):
    done = ruffini("sim", "press", "--board", board, *words, "--out", tmp_path / "out")
    assert done.code == 2, done.err
    assert sentence in refusal_in(done.err)


def test_a_connector_loads_the_tray_only(board, ruffini, tmp_path):
    done = ruffini("sim", "press", "--board", board, "--program", "connector", "--n", 2, "--out", tmp_path / "out")
    if board.name == "ftouch":
        assert done.code == 0, done.err
        with np.load(tmp_path / "out" / "truth.npz") as truth:
            assert np.abs(truth["wrench"]).max(axis=0) == pytest.approx([1, 1, 8, 0.02, 0.02, 0.02], rel=0.5)
    else:
        assert done.code == 2
        assert "no platform that a connector could load" in done.err


def test_balls_need_a_flat_pad(ruffini, tmp_path):
    done = ruffini("sim", "press", "--board", "stereo-fingertip", "--program", "balls", "--n", 1, "--out", tmp_path)
    assert done.code == 2
    assert "balls calibrate colour on a flat pad" in done.err
