"""The corpus of board files through the C interface (tests/cpp/board judges the same)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ruffini.boards import board_names, find_board, parse_board
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
def test_the_host_says_what_the_parser_says(name: str, word: str) -> None:
    data = (FOLDER / name).read_bytes()
    if name.startswith("good/"):
        parse_board(data, name)
        return
    with pytest.raises(InputError) as error:
        parse_board(data, name)
    assert name in str(error.value)
    assert word in str(error.value)


def test_the_generator_makes_what_is_committed(tmp_path: Path) -> None:
    subprocess.run([sys.executable, FOLDER / "make_corpus.py", tmp_path], check=True)
    for name, _ in [*INDEX, ["index.txt", ""]]:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


def test_every_board_that_comes_with_ruffini_is_accepted() -> None:
    assert len(board_names()) >= 2
    for name in board_names():
        board = find_board(name)
        assert board.name == name


def test_an_unknown_board_lists_those_there_are() -> None:
    with pytest.raises(InputError, match=r"no board 'nothing'.*gelslim"):
        find_board("nothing")
