"""A stage over a pad: limits, contact, force aborts, and the way out."""

from __future__ import annotations

import os
import pty
import threading
from dataclasses import replace

import numpy as np
import pytest
from hang import until

from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.rig.emulated_dialects import EmulatedMarlin
from ruffini.rig.guarded_stage import APPROACH_STEP_M, CONTACT_N, DryStage, GuardedStage, Limits, force_guard
from ruffini.rig.manual import HandPress, Target
from ruffini.rig.marlin import Marlin
from ruffini.rig.stage import Place
from ruffini.rig.stop_key import stop_key

ORIGIN = Place(0.001, 0.002, 0.046)
LIMITS = Limits(0.006, 0.006, 0.003, -0.002, 0.0015, 2.0)
STIFFNESS_N_M = 1000.0


class Spring:
    """A pad that pushes back in proportion; `place` is where the tip is in the machine's frame."""

    def __init__(self, place, height_m: float = 0.0) -> None:
        self.place, self.height_m, self.stuck_n = place, height_m, 0.0

    def force(self) -> np.ndarray:
        depth = max(0.0, ORIGIN.z_m + self.height_m - self.place().z_m)
        return np.array([0, 0, -STIFFNESS_N_M * depth - self.stuck_n])


def touch_for_ever(rig: GuardedStage) -> None:
    with rig.safely():
        while True:
            rig.approach(0, 0)


def press_while_it_hardens(rig: GuardedStage, spring: Spring) -> None:
    with rig.safely():
        for _ in rig.press(0, 0, rig.approach(0, 0), 0.0015):
            spring.height_m += 0.0006


@pytest.fixture
def dry():
    stage = DryStage(ORIGIN.plus(Place(0, 0, 0.003)))
    spring = Spring(stage.position)
    return stage, spring, GuardedStage(stage, ORIGIN, LIMITS, spring.force)


def test_contact_is_found_and_pressed_in_steps(dry):
    stage, _, rig = dry
    z = rig.approach(0.002, -0.001)
    assert -0.0003 < z <= -CONTACT_N / STIFFNESS_N_M
    depths = list(rig.press(0.002, -0.001, z, 0.0005))
    assert np.allclose(depths, [1e-4, 2e-4, 3e-4, 4e-4, 5e-4])
    assert stage.position().distance(ORIGIN.plus(Place(0.002, -0.001, z - 0.0005))) < 1e-9
    end = Place(0.0023, -0.001, z - 0.0005)
    assert len(list(rig.slide_to(end))) == 3
    rig.lift()
    assert rig.place().z_m == pytest.approx(LIMITS.top_m)
    assert rig.place().x_m == pytest.approx(0.0023)


def test_above_the_pad_it_travels_fast_and_a_deep_press_takes_twenty_steps(dry):
    stage, _, rig = dry
    rig.go_above(0.006, 0)
    assert stage.duration_s == pytest.approx(0.006 / 0.030)
    deep = GuardedStage(stage, ORIGIN, replace(LIMITS, bottom_m=-0.004, deepest_m=0.004), lambda: np.zeros(3))
    depths = list(deep.press(0, 0, -0.0001, 0.0036))
    assert np.allclose(np.diff(depths), 0.0036 / 20)


def test_no_step_of_a_press_is_longer_than_the_way_that_a_machine_goes_after_a_stop(dry):
    stage = dry[0]
    limits = replace(LIMITS, bottom_m=-0.007, deepest_m=0.007)
    depths = list(GuardedStage(stage, ORIGIN, limits, lambda: np.zeros(3)).press(0, 0, -0.0001, 0.006))
    assert np.diff([0, *depths]).max() <= APPROACH_STEP_M + 1e-9


def test_slow_only_near_the_pad_and_a_reference_that_stands_askew_stops_it_too():
    stage = DryStage(ORIGIN.plus(Place(0, 0, 0.003)))
    spring = Spring(stage.position)
    askew = lambda: spring.force()[[2, 0, 1]]  # noqa: E731 - presses come on x
    rig = GuardedStage(stage, ORIGIN, replace(LIMITS, near_m=0.0005), askew)
    assert -0.0004 < rig.approach(0, 0) < 0
    heights = [m.z_m - ORIGIN.z_m for m in stage.moves]
    assert heights[2] == pytest.approx(0.0005)  # after lifting and going there
    assert np.allclose(np.diff(heights[2:]), -2e-4)
    assert len(heights) < 10


@pytest.mark.parametrize(("x", "y", "sentence"), [(0.007, 0, "beside the pad"), (0, -0.0061, "beside the pad")])
def test_beside_the_pad_is_refused_before_it_moves(dry, x, y, sentence):
    stage, _, rig = dry
    with pytest.raises(RefusedError, match=sentence):
        rig.approach(x, y)
    assert stage.moves == []


def test_no_pad_below_the_tip(dry):
    stage, spring, rig = dry
    spring.height_m = -1
    with pytest.raises(RefusedError, match="no contact"):
        rig.approach(0, 0)
    assert min(m.z_m for m in stage.moves) >= ORIGIN.z_m + LIMITS.bottom_m - 1e-9


def test_too_deep_is_refused(dry):
    _, _, rig = dry
    with pytest.raises(RefusedError, match="a depth of 2 mm"):
        next(rig.press(0, 0, 0, 0.002))


def test_force_that_is_there_before_contact(dry):
    _, spring, rig = dry
    spring.stuck_n = 0.2
    with pytest.raises(RefusedError, match="above the pad"):
        rig.approach(0, 0)


def test_lost_steps_are_seen_at_the_second_touch(dry):
    _, spring, rig = dry
    rig.approach(0, 0)
    spring.height_m = 0.0004
    with pytest.raises(RefusedError, match="lost steps"):
        rig.approach(0, 0)


def test_maximum_force_lifts_the_tip_and_names_who_measured(dry):
    stage, spring, _ = dry
    stiff = lambda: 10 * spring.force()  # noqa: E731
    rig = GuardedStage(stage, ORIGIN, LIMITS, spring.force, [force_guard("the sensor", stiff, 2.0)])
    z = rig.approach(0, 0)
    with pytest.raises(RefusedError, match="the sensor measures"), rig.safely():
        list(rig.press(0, 0, z, 0.0015))
    assert rig.place().z_m == pytest.approx(LIMITS.top_m)
    with pytest.raises(RefusedError, match="the reference measures"), rig.safely():
        GuardedStage(stage, ORIGIN, LIMITS, lambda: np.array([3.0, 0, 0])).approach(0, 0)


def test_ctrl_c_and_a_lost_reference_lift_too(dry):
    _, _, rig = dry
    for error in (KeyboardInterrupt(), NoDeviceError("reference unplugged")):
        rig.approach(0, 0)
        with pytest.raises(type(error)), rig.safely():
            raise error
        assert rig.place().z_m == pytest.approx(LIMITS.top_m)


def test_ctrl_c_whose_lift_fails_is_told(dry, monkeypatch):
    stage, _, rig = dry

    def fail(*_):
        raise NoDeviceError("unplugged")

    rig.approach(0, 0)
    monkeypatch.setattr(stage, "move", fail)
    with pytest.raises(NoDeviceError, match="THE TIP WAS NOT LIFTED: unplugged"), rig.safely():
        raise KeyboardInterrupt


def test_it_is_told_when_the_tip_could_not_be_lifted():
    with EmulatedMarlin() as machine:
        stage = Marlin(machine.port)
        stage.home()
        spring = Spring(machine.place)
        rig = GuardedStage(stage, ORIGIN, LIMITS, spring.force)
        rig.go_above(0, 0)
        threading.Timer(0.05, machine.power_glitch).start()
        with pytest.raises(NoDeviceError, match="was reset") as caught:
            touch_for_ever(rig)
        assert any("THE TIP WAS NOT LIFTED" in note for note in caught.value.__notes__)
        stage.close()


def test_force_abort_on_a_moving_machine_is_prompt():
    """The pad gets hard on the way: the machine halts within the step, and lifts."""
    with EmulatedMarlin() as machine:
        stage = Marlin(machine.port)
        stage.home()
        spring = Spring(machine.place)
        rig = GuardedStage(stage, ORIGIN, LIMITS, spring.force)
        with pytest.raises(RefusedError, match="more than the 2 N allowed"):
            press_while_it_hardens(rig, spring)
        assert machine.place().z_m == pytest.approx(ORIGIN.z_m + LIMITS.top_m)
        stage.close()


def test_limits_without_a_way_back_are_refused(dry):
    stage, spring, _ = dry
    with pytest.raises(InputError, match="no way to the pad and back"):
        GuardedStage(stage, ORIGIN, Limits(1, 1, 0.003, 0.001, 0.001, 1), spring.force)


def test_a_key_stops_and_the_terminal_is_as_before():
    import termios

    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    with stop_key(slave) as guard:
        guard()
        os.write(master, b" ")
        with pytest.raises(RefusedError, match="stopped by a key"):
            until(lambda: guard() is not None, "the guard")
        guard()
    assert termios.tcgetattr(slave) == before
    os.close(master)
    os.close(slave)


def test_no_terminal_no_key(tmp_path):
    with (tmp_path / "x").open("w") as stream, stop_key(stream.fileno()) as guard:
        guard()


def test_hand_press_is_guided_to_the_force():
    said: list[str] = []
    forces = iter([0, 0, -0.5, -0.5, -1.5] + 100 * [-1.02])
    hand = HandPress(lambda: np.array([0, 0, next(forces)]), 5, said.append)
    start, end = hand.press(Target(0.001, 0, 1, 0.05, hold_s=0.1))
    assert said == ["press at x +1.0, y +0.0 mm with 1.00 N", "harder", "softer", "hold still", "good"]
    assert end - start >= 0.1


def test_hand_press_too_hard_too_late_or_never_released():
    with pytest.raises(RefusedError, match=r"pressed with 6\.00 N"):
        HandPress(lambda: np.array([0, 0, -6.0]), 5, str).press(Target(0, 0, 1, 0.1))
    with pytest.raises(RefusedError, match=r"no steady press of 1\.00"):
        HandPress(lambda: np.array([0, 0, -0.5]), 5, str).press(Target(0, 0, 1, 0.1), timeout_s=0.1)
    with pytest.raises(RefusedError, match="still press"):
        HandPress(lambda: np.array([0, 0, -0.5]), 5, str).release(0.1, timeout_s=0.1)
