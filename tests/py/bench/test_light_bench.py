"""The benchmark of drifting light: what it says, what it refuses, and that following takes the drift away."""

import numpy as np
import pytest

from ruffini.bench import light
from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.core import Pipeline
from ruffini.errors import InputError


def test_a_drift_that_is_followed_changes_the_colours_of_rest_tenfold_less():
    board, gain = find_board("gelslim"), 1 + 0.05 * light.WAY
    scene = light.Scene(board)
    table = {
        "photometric.unmix": np.zeros((4, 5, 2, 3), np.int16),
        "photometric.slope": np.zeros((65, 65, 2), np.int16),
    }
    changes = []
    with Pipeline(board, container.pack(table, container.base_metadata(board)).data) as pipeline:
        scene.learn(pipeline)
        for i in range(160):
            frame = pipeline.process(scene.frame(gain=1 + 0.05 * light.WAY * min(i / 110, 1)))
            assert not frame.flags & 1024  # slow enough to be followed
        changes.append(np.median(pipeline.raw("change").reshape(-1, 3), axis=0) / 4096)

    with Pipeline(board, container.pack(table, container.base_metadata(board)).data) as pipeline:
        scene.learn(pipeline)
        assert pipeline.process(scene.frame(gain=gain)).flags & 1024  # at a stroke: said
        changes.append(np.median(pipeline.raw("change").reshape(-1, 3), axis=0) / 4096)
    followed, at_once = (np.abs(c).max() for c in changes)
    assert at_once == pytest.approx(0.05, abs=0.005)
    assert followed < 0.1 * at_once


def test_a_board_without_a_twin_is_refused():
    with pytest.raises(InputError, match="no optics to simulate"):
        light.run(find_board("gelsight-mini"))


def test_the_table_says_every_part():
    row = {"drift": 0.05, "is_followed": True, "untouched_depth_um": 5.0, "untouched_force_n": 0.0,
           "press_error_n": -0.02, "flags": 0}  # fmt: skip
    held = {"frames": 7200, "first_n": 0.8, "last_n": 0.8}
    result = {"board": "b", "simulated": True, "force_n": 0.84, "drift": [row], "held": held}
    text = light.table(result)
    assert "SIMULATED" in text
    assert "followed" in text
    assert "held for 7200 frames: 0.8000 N at first" in text
