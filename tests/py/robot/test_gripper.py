"""A gripper that feels: adaptive grip of the example, the Gymnasium environment, and the film."""

import sys
from pathlib import Path

import numpy as np
import pytest
from worlds import BOARD

pytest.importorskip("mujoco", reason="extra [robot]")
pytest.importorskip("gymnasium", reason="extra [robot]")

import gymnasium

from ruffini.errors import InputError
from ruffini.robot import Gripper, Thing
from ruffini.robot.environment import NAME
from ruffini.robot.film import Film

sys.path.insert(0, str(Path(__file__).parents[3] / "host" / "examples" / "robot"))


def test_both_pads_carry_the_weight_and_a_weak_grip_drops_it(calibrations):
    thing = Thing(mass_kg=0.15, friction=0.6)
    with Gripper(BOARD, thing, calibrations=calibrations) as gripper:
        gripper.grip_n = 2.0
        for i in range(70):
            gripper.lift_m = 0.02 * np.clip((i - 15) / 30, 0, 1)
            frames = gripper.step()
        up = sum(float(np.hypot(*frame.wrench.force[:2])) for frame in frames.values())
        assert up == pytest.approx(0.15 * 9.81, rel=0.05)
        assert all(-frame.wrench.force[2] == pytest.approx(2.0, rel=0.05) for frame in frames.values())
        assert abs(gripper.slipped_m) < 2e-3
        gripper.grip_n = 0.8 * 0.15 * 9.81 / (2 * 0.6)
        for _ in range(40):
            frames = gripper.step()
        assert gripper.slipped_m > 5e-3
        film = Film()
        film.take(gripper, frames, "dropped")
        assert len(film) == 1


def test_an_empty_film_is_refused(tmp_path):
    with pytest.raises(InputError, match="has no picture"):
        Film().write(tmp_path / "film.gif")


def test_the_example_lifts_what_it_is_not_told(calibrations, monkeypatch):
    import adaptive_grip

    monkeypatch.setattr("ruffini.robot.world.default_calibration", lambda board: calibrations[board.name])
    task = adaptive_grip.Task(Thing(mass_kg=0.2, friction=0.5), (0.0, 0.0, -0.5), 6.0)
    result = adaptive_grip.run("slip margin", task, BOARD)
    assert result.is_success
    assert 1.0 < result.grip_n / result.least_n < 1.5


def test_the_environment_keeps_gymnasiums_rules(calibrations):
    env = gymnasium.make(NAME, board=BOARD, calibrations=calibrations)
    first, _ = env.reset(seed=4)
    again, _ = env.reset(seed=4)
    for name, value in first.items():
        np.testing.assert_array_equal(value, again[name])
    assert env.observation_space.contains(first)
    assert first["wrench"][:, 2] == pytest.approx(-0.6, abs=0.1)
    rewards = [env.step(np.array([grip], np.float32))[1] for grip in (2.0, 4.0)]
    assert rewards == pytest.approx([1 - 2 / 12, 1 - 4 / 12])
    env.close()
