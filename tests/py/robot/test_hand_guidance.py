"""The example in which a person's fingers push the link of an arm."""

import sys
from pathlib import Path

import numpy as np
import pytest
from worlds import BOARD

pytest.importorskip("mujoco", reason="extra [robot]")

sys.path.insert(0, str(Path(__file__).parents[3] / "host" / "examples" / "robot"))

WAY = {"left": np.array([0.02, 0.006]), "right": np.array([-0.015, 0.005])}


@pytest.fixture
def guidance(calibrations, monkeypatch):
    """The example with short pushes."""
    import hand_guidance

    monkeypatch.setattr("ruffini.robot.world.default_calibration", lambda board: calibrations[board.name])
    for name, frames in {"PUSH": 70, "RELEASE": 14}.items():
        monkeypatch.setattr(hand_guidance, name, frames)
    return hand_guidance


def test_the_link_goes_where_it_is_pushed_and_dragged_and_stays_there(guidance):
    person = guidance.Person(WAY, {"left": 2.5, "right": 2.0})
    result = guidance.run("wrench", person, BOARD)
    assert result.is_success
    assert max(result.off_m) < 2.5e-3
    assert result.drift_m < 1e-4
    assert 1.5 < result.most_n < 7.0


def test_a_link_that_does_not_feel_stays_and_so_does_one_whose_frames_are_invalid(guidance):
    person = guidance.Person(WAY, {"left": 2.5, "right": 2.0})
    result = guidance.run("none", person, BOARD)
    assert result.is_not_there
    give_m = 2.5 / 8000  # the push over the stiffness of the arm's servo
    assert result.off_m == pytest.approx([np.linalg.norm(way) for way in WAY.values()], abs=1.1 * give_m)

    class Invalid:
        is_valid = False

    still = guidance.ByWrench()({"left": Invalid(), "right": Invalid()}, {})
    assert not np.any(list(still.values()))
