"""A small board with a calibration of its own, and the command line as a function."""

from __future__ import annotations

import numpy as np
import pytest
from command_line import run_ruffini
from kept import kept
from small_board import BASE, COARSE, Files, Run

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("boards") / "small"
    folder.mkdir()
    text = BASE.read_text()
    for old, new in COARSE.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "board.toml").write_text(text)
    board = find_board(folder)
    kind = kept(make_operator, board, method="ridge", noise=Noise((5e-6, 5e-6, 20e-6)))
    metadata = {**container.base_metadata(board), **kind.metadata}
    colours = {
        "photometric.unmix": np.zeros((13, 17, 2, 3), np.int16),
        "photometric.slope": np.zeros((65, 65, 2), np.int16),
    }
    operator, calibration = folder / "operator.safetensors", folder / "calibration.safetensors"
    container.write(operator, container.pack(kind.tensors, metadata))
    container.write(calibration, container.pack({**kind.tensors, **colours}, metadata))
    return Files(board, folder, operator, calibration)


@pytest.fixture
def run() -> Run:
    """Exit code, stdout and stderr of `ruffini` with these words."""
    return run_ruffini
