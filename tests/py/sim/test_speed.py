"""The speed report measures what it says."""

import shutil

import pytest

from ruffini.boards import find_board
from ruffini.sim import speed
from ruffini.sim.speed import measure


@pytest.fixture
def coarse_board(tmp_path):
    folder = tmp_path / "gelslim"
    shutil.copytree(find_board("gelslim").folder, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write("\n[mesh]\ncells_x = 10\ncells_y = 8\n")
    return find_board(folder)


def test_flat_pads_are_pressed_and_rendered(coarse_board):
    result = measure(coarse_board)
    assert result["board"] == "gelslim"
    assert result["rendering_fps"] > 1
    assert result["mechanics_fps"] > 1
    assert result["memory_mb"] > 20


@pytest.mark.parametrize("name", ["stereo-fingertip", "eltac"])
def test_other_bodies_are_pressed_too(name, monkeypatch):
    monkeypatch.setattr(speed, "N_FRAMES", 3)
    assert measure(find_board(name))["mechanics_fps"] > 0.1
