"""What `make run` and `ruffini view --demo` need of every board: a twin, touches to show, a short bench to fit on."""

import shutil

import pytest

from ruffini.boards import board_names, boards_folder, find_board
from ruffini.demo.calibration import BENCH, has_field
from ruffini.errors import InputError
from ruffini.sim.bodies import touches
from ruffini.sim.programs import n_frames_of
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce
from ruffini.sim.settings import load_twin

MAX_FRAMES = 200  # to draw one takes up to half a second


def test_a_board_without_a_twin_is_refused_in_one_sentence(tmp_path):
    folder = tmp_path / "gelslim"
    folder.mkdir()
    shutil.copy(boards_folder() / "gelslim" / "board.toml", folder)
    instead = (
        r"twin\.toml does not exist; show a recording with `ruffini live --camera VIDEO --board gelslim`, simulate"
    )
    with pytest.raises(InputError, match=instead):
        load_twin(find_board(folder))


@pytest.mark.parametrize("name", board_names())
def test_every_board_can_be_shown_without_a_sensor(name):
    board = find_board(name)
    story = touches.demo(board, load_twin(board))
    assert board.pipeline.n_rest_frames < n_frames_of(story) <= MAX_FRAMES
    if not has_field(board):
        runs = runs_of(load_reproduce(board, BENCH), quick=False)
        assert {run.settings.part for run in runs} == {"fit"}
        assert 8 <= len(runs) <= 30
