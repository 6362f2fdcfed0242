"""Boards whose simulated pad is coarse enough for tests."""

import shutil

import pytest

from ruffini.boards import find_board

MESH = "\n[mesh]\ncells_x = 10\ncells_y = 8\n"


@pytest.fixture(scope="session")
def coarse_board(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards") / "gelslim"
    shutil.copytree(find_board("gelslim").folder, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write(MESH)
    return find_board(folder)
