"""The speed report measures what it says."""

import shutil

import pytest

from ruffini.boards import find_board
from ruffini.sim import speed
from ruffini.sim.speed import measure

COARSE = {  # end of twin.toml; of the skin it is the last section
    "gelslim": "\n[mesh]\ncells_x = 10\ncells_y = 8\n",
    "eltac": "cells_x = 6\ncells_y = 12\n",
    "stereo-fingertip": "",
}


def coarse_board(name, folder):
    shutil.copytree(find_board(name).folder, folder / name)
    with (folder / name / "twin.toml").open("a") as twin:
        twin.write(COARSE[name])
    return find_board(folder / name)


def test_flat_pads_are_pressed_and_rendered(tmp_path):
    result = measure(coarse_board("gelslim", tmp_path))
    assert result["board"] == "gelslim"
    assert result["rendering_fps"] > 1
    assert result["mechanics_fps"] > 1
    assert result["memory_mb"] > 20


@pytest.mark.parametrize("name", ["stereo-fingertip", "eltac"])
def test_other_bodies_are_pressed_too(name, monkeypatch, tmp_path):
    monkeypatch.setattr(speed, "N_FRAMES", 3)
    assert measure(coarse_board(name, tmp_path))["mechanics_fps"] > 0.1
