"""The examples that hold what breaks and sort what is soft, and soft things in a world."""

import sys
from pathlib import Path

import numpy as np
import pytest
from worlds import BOARD, lying

pytest.importorskip("mujoco", reason="extra [robot]")

from ruffini.errors import InputError
from ruffini.robot import Gripper, Thing, World

sys.path.insert(0, str(Path(__file__).parents[3] / "host" / "examples" / "robot"))

PAD_PA = 200_000
BALL = 'name="ball" type="sphere" size=".02"'


@pytest.fixture(autouse=True)
def cheap_calibration(calibrations, monkeypatch):
    monkeypatch.setattr("ruffini.robot.world.default_calibration", lambda board: calibrations[board.name])


def pressed(depth_m, way_m=0.0, **options):
    """The pad's force and the displacement of its nodes (n, 3) under a ball that is held so deep."""
    model = lying(BALL, above_m=0.0201, friction=5.0)
    with World(model, {"pad": BOARD}, is_feeling=False, **options) as world:
        world.start()
        for share in np.linspace(0, 1, 50):
            world.data.qpos[:] = (0.0, 0.0, 0.02 - share * depth_m, 1.0, 0.0, 0.0, 0.0)
            world.data.qvel[:] = 0.0
            world.advance()
        for share in np.linspace(0, 1, 50):
            world.data.qpos[:] = (share * way_m, 0.0, 0.02 - depth_m, 1.0, 0.0, 0.0, 0.0)
            world.data.qvel[:] = 0.0
            world.advance()
        pad = world.pads["pad"]
        return pad.wrench[:3].copy(), pad.contact.board_displacement()


def test_a_thing_as_soft_as_the_pad_takes_half_of_the_depth_and_of_the_shear():
    force, moved = pressed(0.4e-3, 0.1e-3)
    half_force, half_moved = pressed(0.4e-3, 0.1e-3, moduli_pa={"ball": PAD_PA})
    assert force[2] < -0.5
    assert abs(force[0]) > 0.05
    np.testing.assert_allclose(half_force, force / 2, rtol=0.02)
    np.testing.assert_allclose(half_moved, moved / 2, atol=0.02 * np.abs(moved).max())


def test_a_soft_thing_is_met_as_gently_as_it_gives():
    """Also in the step of the first touch, where the pad damps the approach: all is linear in the depth."""
    forces = []
    for moduli in ({}, {"ball": PAD_PA / 4}):
        with World(
            lying(BALL, above_m=0.021, friction=5.0), {"pad": BOARD}, is_feeling=False, moduli_pa=moduli
        ) as world:
            world.start()
            forces.append([])
            for above_m in np.linspace(0.02031, 0.01971, 25):
                world.data.qpos[:] = (0.0, 0.0, above_m, 1.0, 0.0, 0.0, 0.0)
                world.data.qvel[:] = 0.0
                world.advance()
                forces[-1].append(world.pads["pad"].wrench[2])
    rigid, soft = np.array(forces)
    touched = np.flatnonzero(rigid)
    assert 0 < touched[0] < touched[-1] == 24
    np.testing.assert_allclose(soft[touched], rigid[touched] / 5, rtol=0.02)


@pytest.mark.parametrize("modulus", [0.0, -1.0, float("nan")])
def test_a_modulus_that_cannot_be(modulus):
    with pytest.raises(InputError, match="give a number above zero"):
        World(lying(BALL, above_m=0.03), {"pad": BOARD}, is_feeling=False, moduli_pa={"ball": modulus})
    with pytest.raises(InputError, match="give a number above zero"):
        Gripper(BOARD, Thing(modulus_pa=modulus), is_feeling=False)


def test_a_soft_geom_that_is_not_there():
    with pytest.raises(InputError, match="no geom 'egg'"):
        World(lying(BALL, above_m=0.03), {"pad": BOARD}, is_feeling=False, moduli_pa={"egg": 1e5})


@pytest.fixture
def egg(monkeypatch):
    """The example in less time."""
    import egg_bottle_ball

    for name, frames in {"CLOSE": 22, "LIFT": 30, "HOLD": 1, "TROUBLE": 24}.items():
        monkeypatch.setattr(egg_bottle_ball, name, frames)
    return egg_bottle_ball


@pytest.mark.parametrize(("seed", "name"), [(0, "egg"), (1, "bottle"), (2, "ball")])
def test_egg_bottle_and_ball_are_neither_dropped_nor_broken(egg, seed, name):
    task = egg.Task.of_seed(seed)
    result = egg.run("friction", task, BOARD, seed)
    assert task.name == name
    assert result.is_success
    assert 0.3 < result.most_n / result.breaks_n < 0.9


@pytest.mark.parametrize(("grip_n", "is_dropped"), [(5.0, False), (1.0, True)])
def test_too_much_breaks_the_egg_and_too_little_drops_it(egg, monkeypatch, grip_n, is_dropped):
    task = egg.Task("egg", Thing("ellipsoid", (0.024, 0.024, 0.033), 0.2, 0.5), 0.0, 4.0)
    monkeypatch.setitem(egg.FEEDBACK, "none", lambda: lambda _, __: grip_n)
    monkeypatch.setattr(egg, "TROUBLE", 1)  # it breaks under the grip, or is dropped under its weight
    result = egg.run("none", task, BOARD)
    assert (result.is_dropped, result.is_broken) == (is_dropped, not is_dropped)


@pytest.mark.parametrize(
    ("modulus", "is_left", "thing"),
    [
        (6e4, False, ("sphere", (0.019,))),
        (1.5e6, True, ("cylinder", (0.028, 0.03))),
    ],
)
def test_soft_ones_are_picked_and_hard_ones_left_whatever_their_shape(monkeypatch, thing, modulus, is_left):
    import sort_by_hardness

    for name, frames in {"CLOSE": 22, "SQUEEZE": 20, "LIFT": 25, "HOLD": 5}.items():
        monkeypatch.setattr(sort_by_hardness, name, frames)
    task = sort_by_hardness.Task(Thing(*thing, 0.08, 0.7, modulus), 2.1)
    result = sort_by_hardness.run("stream", task, BOARD)
    assert result.is_success
    assert (result.modulus_off * modulus > sort_by_hardness.BOUND_PA) == is_left
    if not is_left:
        assert result.modulus_off == pytest.approx(1, abs=0.3)


def test_what_the_squeeze_bruises_is_bruised(monkeypatch):
    import sort_by_hardness

    for name, frames in {"CLOSE": 25, "SQUEEZE": 15, "LIFT": 2, "HOLD": 1}.items():
        monkeypatch.setattr(sort_by_hardness, name, frames)
    task = sort_by_hardness.Task(Thing("cylinder", (0.028, 0.03), 0.08, 0.7, 1.5e6), 5.0)
    assert not sort_by_hardness.run("stream", task, BOARD).is_bruised
    squeeze = sort_by_hardness.squeeze
    monkeypatch.setattr(sort_by_hardness, "squeeze", lambda gripper, film: (squeeze(gripper, film)[0], 5.1))
    assert sort_by_hardness.run("stream", task, BOARD).is_bruised


def test_force_over_travel_takes_a_broad_soft_thing_for_the_harder(monkeypatch):
    import sort_by_hardness

    monkeypatch.setattr(sort_by_hardness, "CLOSE", 25)
    monkeypatch.setattr(sort_by_hardness, "SQUEEZE", 15)
    stiffness = []
    for thing in (Thing("cylinder", (0.028, 0.03), modulus_pa=2.5e5), Thing("sphere", (0.018,), modulus_pa=5e5)):
        with Gripper(BOARD, thing, is_feeling=False) as gripper:
            stiffness.append(sort_by_hardness.stiffness(sort_by_hardness.squeeze(gripper)[0]))
    assert stiffness[0] > 1.1 * stiffness[1]
