"""The streamed wrench, friction and rest against what MuJoCo itself measures and knows."""

import mujoco
import numpy as np
import pytest
from kept import kept
from worlds import BOARD, lying, scale, standing

from ruffini.robot import World

BALL = 'type="sphere" size=".015"'
BLOCK = 'type="box" size=".006 .005 .015"'
FRICTION = 0.6
PRESS_N = 2.0


def settled(one, frames, **ctrl):
    """The last frame, after motors have pulled for so long."""
    for name, value in ctrl.items():
        one.data.ctrl["xyz".index(name)] = value
    return [one.step()["pad"] for _ in range(frames)][-1]


@pytest.mark.parametrize("geom", [BALL, BLOCK, 'type="capsule" size=".008 .012" euler="90 0 0"'])
@pytest.mark.parametrize("place", [(0.0, 0.0), (2e-3, -1.5e-3)])
def test_the_streamed_wrench_is_what_mujoco_measures_under_the_pad(world, geom, place):
    one = world(scale(geom))
    one.data.qpos[:2] = place
    one.data.qpos[2] = 0.015 - 0.0151 if "capsule" not in geom else 0.008 - 0.0151
    settled(one, 25, z=-PRESS_N)
    frame = settled(one, 25, x=0.5, y=-0.3)
    true = -one.data.sensordata  # of the finger on the pad, MuJoCo measures what the finger gets from below
    assert np.linalg.norm(true[:3] - [0.5, -0.3, -PRESS_N]) < 0.02
    assert frame.is_valid
    assert frame.is_simulated
    assert np.abs(frame.wrench.force - true[:3]).max() < 0.05 * np.linalg.norm(true[:3])
    arm_m = 5e-3  # moments are compared as forces at this arm
    assert np.abs(frame.wrench.torque - true[3:]).max() < arm_m * (0.05 * np.linalg.norm(true[:3]) + 0.05)


def test_a_plane_carries_what_stands_on_it_and_is_not_felt_from_afar(world):
    one = world(standing(above_m=0.05), is_feeling=False)
    one.step()
    assert not one.pads["pad"].wrench.any()
    one.data.qpos[0] = -0.05
    for _ in range(40):
        one.step()
    assert one.pads["pad"].wrench[:3] == pytest.approx([0, 0, -0.2 * 9.81], abs=0.02)


def test_it_slips_at_the_load_of_its_friction(world):
    one = world(scale(BALL))
    settled(one, 30, z=-PRESS_N)
    limit = FRICTION * PRESS_N
    assert settled(one, 25, x=0.5 * limit).contacts.contacts[0].slip_state in ("sticks", "incipient")
    settled(one, 25, x=0.9 * limit)
    assert abs(one.data.qvel[0]) < 1e-4
    way = one.data.qpos[0]
    states = []
    for load in np.linspace(0.9, 1.1, 21) * limit:
        states.append(settled(one, 2, x=load).contacts.contacts[0])
        if one.data.qpos[0] - way > 0.5e-3:
            break
    assert abs(load - limit) < 0.1 * limit
    assert states[-1].slip_state == "slides"
    assert states[-1].friction == pytest.approx(FRICTION, rel=0.1)
    assert any(one.slip_state == "incipient" or one.slip_margin_n < 0.1 * PRESS_N for one in states[:-1])


def left_alone(stiffness, step_s, frames, _mujoco):
    """Kinetic and potential energy of each frame of a block that slides to rest, and what it presses at the end."""
    world = lying(BLOCK, above_m=0.0151, step_s=step_s, friction=FRICTION)
    kinetic, potential = [], []
    with World(world, {"pad": BOARD}, stiffness=stiffness, is_feeling=False) as one:
        one.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        one.data.qvel[:2] = 0.02, 0.01
        for _ in range(frames):
            one.step()
            kinetic.append(one.data.energy[1])
            potential.append(one.data.energy[0])
        return kinetic, potential, one.pads["pad"].wrench[2]


# What is left in the last third of a second: a soft pad's rocking takes longer to go.
@pytest.mark.parametrize(
    ("stiffness", "step_s", "frames", "left_j", "drift_m"),
    [(0.25, 1e-3, 150, 2e-5, 2e-4), (1.0, 1e-3, 102, 1e-7, 1e-6), (4.0, 4e-4, 60, 1e-7, 1e-6)],
)
def test_at_rest_nothing_gains_energy(stiffness, step_s, frames, left_j, drift_m):
    kinetic, potential, pressed_n = kept(left_alone, stiffness, step_s, frames, mujoco.__version__)
    weight, third = 0.1 * 9.81, frames // 3
    assert pressed_n == pytest.approx(-weight, rel=0.02)
    assert max(kinetic[2 * third :]) <= max(kinetic[third : 2 * third]) <= max(kinetic[:third])
    assert max(kinetic[-20:]) < left_j
    assert np.ptp(potential[-20:]) < weight * drift_m  # it neither creeps nor climbs
