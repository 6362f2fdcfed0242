"""What tests keep between runs is made once, and never taken where it is spoilt or of other code."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import kept as module
import pytest
from kept import kept

from ruffini.boards import find_board


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RUFFINI_TEST_CACHE", str(tmp_path))
    return tmp_path


calls: list[float] = []


def square(x: float, *, sign: int = 1) -> float:
    calls.append(x)
    return sign * x * x


def files(folder: Path) -> list[Path]:
    return [p for p in folder.iterdir() if not p.suffix]


def test_it_is_made_once_for_each_argument(folder: Path) -> None:
    calls.clear()
    assert [kept(square, 3.0), kept(square, 3.0), kept(square, 2.0), kept(square, 3.0, sign=-1)] == [9, 9, 4, -9]
    assert calls == [3, 2, 3]
    assert len(files(folder)) == 3


def test_a_spoilt_file_is_made_again(folder: Path) -> None:
    kept(square, 5.0)
    calls.clear()
    (path,) = files(folder)
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    assert kept(square, 5.0) == 25
    assert calls == [5]


def test_other_code_makes_its_own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(square, 7.0)
    calls.clear()
    monkeypatch.setattr(module, "code_version", lambda: b"other")
    assert kept(square, 7.0) == 49
    assert calls == [7]
    monkeypatch.setattr(module, "_sources_beside", lambda _: b"other")  # the function is one of a test's
    assert kept(square, 7.0) == 49
    assert calls == [7, 7]


def test_sources_beside_a_function_of_a_test_count_and_no_library_s() -> None:
    assert module._sources_beside(__name__) != module._sources_beside("ruffini.boards")
    assert module._sources_beside("ruffini.boards") == module._sources_beside("builtins")


def test_the_oldest_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(square, 1.0)
    (first,) = files(folder)
    os.utime(first, (0, 0))
    monkeypatch.setattr(module, "MAX_BYTES", 2 * first.stat().st_size)
    kept(square, 2.0)
    kept(square, 3.0)
    assert len(files(folder)) == 2
    assert not first.exists()


KEEP_A_BOARD = """
from kept import kept
from ruffini.boards import find_board
kept(repr, find_board("gelslim"))
kept(repr, find_board("gelsight-mini"))
"""


def test_another_process_finds_a_boards_result(folder: Path) -> None:
    """Whatever the order of its sets, which the hash seed decides."""
    for seed in ("1", "2", "3"):
        path = os.pathsep.join(p for p in sys.path if p)
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path}
        subprocess.run([sys.executable, "-c", KEEP_A_BOARD], check=True, env=environment)
    assert len(files(folder)) == 2


def test_another_twin_in_a_boards_folder_makes_its_own(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    parent = tmp_path_factory.mktemp("boards")
    for place, more in (("a", ""), ("b", ""), ("c", "\n[mesh]\ncells_x = 10\ncells_y = 8\n")):
        shutil.copytree(find_board("gelslim").folder, parent / place / "gelslim")
        with (parent / place / "gelslim" / "twin.toml").open("a") as twin:
            twin.write(more)
        kept(repr, find_board(parent / place / "gelslim"))
    assert len(files(folder)) == 2
