"""The corpus of board files, judged as the firmware judges it (tests/cpp/board)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ruffini.boards import board_names, find_board, parse_board
from ruffini.core.pipeline import check_board_text
from ruffini.errors import InputError

FOLDER = Path(__file__).parents[2] / "data" / "boards"
INDEX = [
    line.split(" | ") for line in (FOLDER / "index.txt").read_text().splitlines() if line and not line.startswith("#")
]


def test_the_corpus_is_large_enough_and_all_of_it_is_listed() -> None:
    listed = {name for name, _ in INDEX}
    assert listed == {p.relative_to(FOLDER).as_posix() for p in FOLDER.glob("*/*.toml")}
    assert sum(name.startswith("good/") for name in listed) >= 10
    assert sum(name.startswith("bad/") for name in listed) >= 40


@pytest.mark.parametrize(("name", "word"), INDEX, ids=[name for name, _ in INDEX])
def test_both_parsers_judge_alike(name: str, word: str) -> None:
    data = (FOLDER / name).read_bytes()
    firmware = check_board_text(data, name)
    if name.startswith("good/"):
        assert firmware is None
        parse_board(data, name)
        return
    assert firmware is not None
    with pytest.raises(InputError) as error:
        parse_board(data, name)
    for text in (firmware, str(error.value)):
        assert name in text
        assert word in text


def test_the_generator_makes_what_is_committed(tmp_path: Path) -> None:
    subprocess.run([sys.executable, FOLDER / "make_corpus.py", tmp_path], check=True)
    for name, _ in [*INDEX, ["index.txt", ""]]:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


def test_every_board_that_comes_with_ruffini_is_accepted_by_both() -> None:
    assert len(board_names()) >= 2
    for name in board_names():
        board = find_board(name)
        assert board.name == name
        assert check_board_text(board.text.encode(), name) is None


def test_an_unknown_board_lists_those_there_are() -> None:
    with pytest.raises(InputError, match=r"no board 'nothing'.*gelslim"):
        find_board("nothing")
