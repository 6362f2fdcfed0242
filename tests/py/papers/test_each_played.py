"""Runs are played side by side and come back in their order."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any, cast

import pytest
from papers.recorded import Recorded, each_played


def runs(n: int) -> list[Recorded]:
    return [Recorded(cast(Any, None), Path(str(i))) for i in range(n)]


def test_two_play_at_once_and_none_changes_its_place() -> None:
    both = threading.Barrier(2)

    def play(run: Recorded) -> str:
        both.wait(60)  # alone it would never go on
        return run.folder.name

    done: list[float] = []
    assert each_played(play, runs(4), 2, done.append) == ["0", "1", "2", "3"]
    assert done == [0.25, 0.5, 0.75, 1.0]


def test_a_run_that_fails_is_not_left_out() -> None:
    def play(run: Recorded) -> int:
        return 1 // int(run.folder.name)

    with pytest.raises(ZeroDivisionError):
        each_played(play, runs(2), 2)
