"""Core stages that the bit-exact tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from core_stages import CoreStages
from mirror.board import Board, read_board

from ruffini.core import native_folder


@pytest.fixture
def open_stages() -> Iterator[Callable[[str], tuple[CoreStages, Board]]]:
    """Core stages and mirror's board of one board.toml text."""
    opened: list[CoreStages] = []

    def open_one(text: str) -> tuple[CoreStages, Board]:
        stages = CoreStages(native_folder() / "libruffini_stages.so", text)
        opened.append(stages)
        return stages, read_board(text)

    yield open_one
    for stages in opened:
        stages.close()
