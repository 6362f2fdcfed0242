"""What the tests of camera faults share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board
from ruffini.core import Pipeline


class Scene(Protocol):
    """Pictures of one pad."""

    def frame(self, state: str) -> npt.NDArray[np.uint8]:
        """A picture of the pad in a state, e.g. "untouched", with noise of its own."""


@pytest.fixture
def core(board: Board, calibration: bytes, scene: Scene) -> Iterator[Pipeline]:
    """The core as on a live camera, which has learned rest. The module says which board, calibration and scene."""
    with Pipeline(board, calibration) as pipeline:
        pipeline.set_live()
        while not pipeline.process(scene.frame("untouched")).has_reference:
            pass
        yield pipeline
