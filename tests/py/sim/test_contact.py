"""Contact of the twin: conditions of contact and friction at every node, and theory where it holds."""

import numpy as np
import pytest
from kept import kept

from ruffini.errors import InputError
from ruffini.sim.contact import FREE, SLIPS, STICKS, ContactSolver, Indenter, Pose
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.pose import surface_height
from ruffini.sim.surface import hat_shares, wrench_of

MM = 1e-3


@pytest.fixture(scope="module")
def pad():
    model = PadModel(14 * MM, 12 * MM, 4 * MM, 2e5, 0.48, 16, 14)
    return model, kept(surface_compliance, model)


@pytest.fixture(scope="module")
def deep_pad():
    model = PadModel(20 * MM, 20 * MM, 20 * MM, 2e5, 0.4, 20, 20, layers=(0.04, 0.09, 0.22, 0.65))
    return model, kept(surface_compliance, model)


def pressed(pad, indenter, friction, *poses):
    solver = ContactSolver(*pad, indenter, friction)
    for pose in poses:
        solver.advance(pose)
    return solver


PATH = (Pose(1 * MM, -0.5 * MM, 0.7 * MM), Pose(1.3 * MM, -0.3 * MM, 0.7 * MM, 0.05))


@pytest.mark.parametrize(
    ("shape", "friction"),
    [("sphere", 0.0), ("sphere", 0.3), ("sphere", 0.9), ("flat", 0.0), ("flat", 0.3), ("flat", 0.9), ("square", 0.6),
     ("ring", 0.6), ("cylinder", 0.6), ("usb_plug", 0.6), ("shell", 0.6)],
)  # fmt: skip
def test_conditions_hold_at_every_node(pad, shape, friction):
    model, compliance = pad
    indenter = Indenter(shape, 2 * MM if shape == "flat" else 3 * MM)
    solver = pressed(pad, indenter, friction, *PATH)
    x, y = np.meshgrid(model.node_x(), model.node_y())
    place = np.column_stack([x.ravel(), y.ravel()]) + solver.displacement[:, :2]
    surface = surface_height(indenter, PATH[-1], place)
    gap = hat_shares(model).T @ (surface - solver.displacement[:, 2])  # mean over each node's hat
    pressure, shear = -solver.hat_force[:, 2], np.hypot(*solver.hat_force[:, :2].T)
    assert pressure.min() >= 0
    assert gap.min() > -0.2e-6  # metres
    assert np.abs(gap[pressure > 0]).max() < 0.2e-6
    assert (shear <= friction * pressure * (1 + 1e-9)).all()
    np.testing.assert_allclose(solver.displacement.ravel(), compliance @ solver.nodal_force.ravel(), atol=1e-12)


def test_ball_follows_hertz(deep_pad):
    radius, depth = 6 * MM, 0.6 * MM
    solver = pressed(deep_pad, Indenter("sphere", radius), 0.0, Pose(0, 0, depth))
    exact = 4 / 3 * 2e5 / (1 - 0.4**2) * np.sqrt(radius) * depth**1.5
    # The bottom at 10 contact radii and the free sides leave a few per cent.
    assert -wrench_of(solver.model, solver.nodal_force)[2] == pytest.approx(exact, rel=0.04)


def test_press_at_the_centre_is_symmetric(pad):
    wrench = wrench_of(pad[0], pressed(pad, Indenter("sphere", 3 * MM), 0.7, Pose(0, 0, 0.8 * MM)).nodal_force)
    assert np.abs(wrench[[0, 1]]).max() < 1e-5 * abs(wrench[2])
    assert np.abs(wrench[3:]).max() < 1e-5 * MM * abs(wrench[2])


def test_press_off_centre_has_its_moment(pad):
    wrench = wrench_of(pad[0], pressed(pad, Indenter("flat", 2 * MM), 0.0, Pose(2 * MM, -1 * MM, 0.5 * MM)).nodal_force)
    # M = r x F with F along z: Mx = y Fz, My = -x Fz; the pad's sides pull the pressure a little.
    assert wrench[3] == pytest.approx(-1 * MM * wrench[2], rel=0.1)
    assert wrench[4] == pytest.approx(-2 * MM * wrench[2], rel=0.1)


def test_small_shear_sticks_and_large_shear_slides(pad):
    depth, friction, indenter = 0.7 * MM, 0.4, Indenter("sphere", 3 * MM)
    force = []
    for shift in (0.02, 0.04, 3.0):
        solver = pressed(pad, indenter, friction, Pose(-1 * MM, 0, depth), Pose((shift - 1) * MM, 0, depth))
        force.append(wrench_of(solver.model, solver.nodal_force))
    start = wrench_of(pad[0], pressed(pad, indenter, friction, Pose(-1 * MM, 0, depth)).nodal_force)
    assert force[1][0] - start[0] == pytest.approx(2 * (force[0][0] - start[0]), rel=0.1)
    assert force[2][0] == pytest.approx(-friction * force[2][2], rel=0.01)


def test_rolling_makes_less_shear_than_sliding(pad):
    depth, ball, way = 0.7 * MM, Indenter("sphere", 3 * MM), 0.3 * MM
    rolled = pressed(pad, ball, 0.4, Pose(0, 0, depth), Pose(way, 0, depth, pitch_rad=way / ball.radius_m))
    slid = pressed(pad, ball, 0.4, Pose(0, 0, depth), Pose(way, 0, depth))
    shear = [wrench_of(s.model, s.nodal_force)[0] for s in (rolled, slid)]
    assert abs(shear[0]) < 0.5 * shear[1]


def test_nodes_say_whether_they_stick(pad):
    """After a small shear the middle sticks and the rim slips; far from the ball nothing touches."""
    solver = pressed(pad, Indenter("sphere", 3 * MM), 0.4, Pose(0, 0, 0.7 * MM), Pose(0.1 * MM, 0, 0.7 * MM))
    x, y = np.meshgrid(pad[0].node_x(), pad[0].node_y())
    r = np.hypot(x, y).ravel()
    state = solver.contact_state
    assert (state[r < 0.5 * MM] == STICKS).all()
    assert (state[r > 3 * MM] == FREE).all()
    assert r[state == SLIPS].min() > r[state == STICKS].mean()
    sliding = pressed(pad, Indenter("sphere", 3 * MM), 0.4, Pose(0, 0, 0.7 * MM), Pose(2 * MM, 0, 0.7 * MM))
    assert (sliding.contact_state[sliding.hat_force[:, 2] < 0] == SLIPS).mean() > 0.95


def test_a_tilted_face_presses_on_one_side(pad):
    solver = pressed(pad, Indenter("flat", 2 * MM), 0.3, Pose(0, 0, 0.4 * MM, pitch_rad=0.1))
    wrench = wrench_of(pad[0], solver.nodal_force)
    assert wrench[4] > 0.2 * MM * abs(wrench[2])  # pitched about y, its side at +x goes deeper: My = -x Fz


def test_turning_twists(pad):
    solver = pressed(pad, Indenter("flat", 2 * MM), 0.8, Pose(0, 0, 0.6 * MM), Pose(0, 0, 0.6 * MM, 0.05))
    wrench = wrench_of(pad[0], solver.nodal_force)
    assert wrench[5] > 0.1 * MM * abs(wrench[2])
    assert np.abs(wrench[:2]).max() < 1e-2 * abs(wrench[2])


def test_lifting_frees_the_pad(pad):
    solver = pressed(pad, Indenter("sphere", 3 * MM), 0.5, *PATH, Pose(1 * MM, 0, 0.0))
    assert not solver.hat_force.any()
    assert not solver.displacement.any()


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (Pose(8 * MM, 0, 0.1 * MM), "beside the pad"),
        (Pose(0, 0, 2.1 * MM), "press less deep"),
    ],
)
def test_poses_that_cannot_be_are_refused(pad, pose, words):
    with pytest.raises(InputError, match=words):
        pressed(pad, Indenter("sphere", 3 * MM), 0.5, pose)
