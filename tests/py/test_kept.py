"""What tests keep between runs is made once, and never taken where it is spoilt or of other code."""

from __future__ import annotations

from pathlib import Path

import kept as module
import pytest
from kept import kept


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


def test_the_oldest_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FILES", 2)
    for x in (1.0, 2.0, 3.0):
        kept(square, x)
    assert len(files(folder)) == 2
