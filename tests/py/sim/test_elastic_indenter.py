"""Indenters that give way: a bar, Hertz between two bodies, a rigid core, and what one solution serves."""

import numpy as np
import pytest
from kept import kept

from ruffini.errors import InputError
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.hex27 import stiffness
from ruffini.sim.indenters import Material
from ruffini.sim.indenters.body import body_of
from ruffini.sim.pad import PadModel, element_stiffness, surface_compliance
from ruffini.sim.surface import wrench_of

MM = 1e-3


@pytest.fixture(scope="module")
def rock():
    return PadModel(6 * MM, 6 * MM, 1 * MM, 1e10, 0.3, 16, 16, layers=(0.5, 0.5))


@pytest.fixture(scope="module")
def pad():
    return PadModel(14 * MM, 12 * MM, 4 * MM, 2e5, 0.48, 16, 14, layers=(0.2, 0.3, 0.5))


def solved(model, indenter, poses, friction):
    solver = ContactSolver(model, kept(surface_compliance, model), indenter, friction)
    for pose in poses:
        solver.advance(pose)
    return solver.hat_force, solver.nodal_force


def load(pad, indenter, *poses, friction=0.0):
    """Nodal force under the indenter, and its wrench."""
    hat_force, nodal_force = kept(solved, pad, indenter, poses, friction)
    return hat_force, wrench_of(pad, nodal_force)


def test_any_brick_is_the_pads_brick():
    grid = np.stack(np.meshgrid([0, 0.5, 1], [0, 0.5, 1], [0, 0.5, 1], indexing="ij"), axis=-1)[..., ::-1]
    coords = (grid * (0.7, 0.5, 0.6) * MM).reshape(1, 27, 3)
    expected = element_stiffness((0.7 * MM, 0.5 * MM, 0.6 * MM), 2e5, 0.48)
    np.testing.assert_allclose(stiffness(coords, np.array([2e5]), 0.48)[0], expected, atol=1e-9 * expected.max())


def test_sheared_elements_pass_the_patch_test():
    rng = np.random.default_rng(2)
    grid = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(27, 3)
    coords = grid @ (np.eye(3) + 0.2 * rng.normal(size=(3, 3)))
    gradient = rng.normal(size=(3, 3))
    force = (stiffness(coords[None], np.array([1.0]), 0.3)[0] @ (coords @ gradient.T).ravel()).reshape(27, 3)
    strain = (gradient + gradient.T) / 2
    stress = 0.3 / (1.3 * 0.4) * np.trace(strain) * np.eye(3) + strain / 1.3
    volume = 8 * abs(np.linalg.det(np.linalg.lstsq(grid.astype(float), coords, rcond=None)[0]))
    np.testing.assert_allclose(force.T @ coords, stress * volume, atol=1e-12)
    np.testing.assert_allclose(force[13], 0, atol=1e-12)


def test_a_soft_square_bar_on_rock_is_a_spring(rock):
    """E A / L without lateral strain; 4 x 4 mm, 4 mm long."""
    _, wrench = load(rock, Indenter("square", 2 * MM, Material(1e6, 0.0)), Pose(0, 0, 0.1 * MM))
    assert -wrench[2] == pytest.approx(1e6 * 16e-6 * 0.1 / 4, rel=0.02)


def test_a_soft_ball_on_rock_follows_hertz(rock):
    """Half a ball held at its equator: stiffer than a whole space behind the contact, the less the smaller that is."""
    ratios = []
    for depth in (0.05 * MM, 0.2 * MM):
        _, wrench = load(rock, Indenter("sphere", 6 * MM, Material(1e6, 0.4)), Pose(0, 0, depth))
        ratios.append(-wrench[2] / (4 / 3 * 1e6 / (1 - 0.16) * np.sqrt(6 * MM) * depth**1.5))
    assert 1.0 < ratios[0] < 1.1
    assert ratios[0] < ratios[1] < 1.25


def test_softer_indenters_press_less_and_wider(pad):
    results = [
        load(pad, Indenter("sphere", 3 * MM, material), Pose(0, 0, 0.5 * MM))
        for material in (None, Material.of_shore_a(90), Material.of_shore_a(30), Material(2e5))
    ]
    loads = [-wrench[2] for _, wrench in results]
    assert loads[0] > loads[1] > loads[2] > loads[3] > 0.3 * loads[0]
    assert loads[1] > 0.95 * loads[0]
    mean_pressure = [load / (f[:, 2] < 0).sum() for load, (f, _) in zip(loads, results, strict=True)]
    assert mean_pressure[3] < 0.8 * mean_pressure[0]


def test_a_rigid_core_carries_the_load(pad):
    x, y = np.meshgrid(pad.node_x(), pad.node_y())
    inner = (np.hypot(x, y) < 1 * MM).ravel()
    shares, loads = [], []
    for material in (Material(1e5), Material(1e5, core_part=0.5), Material(1e5, core_part=0.5, skin_part=0.3)):
        hat_force, wrench = load(pad, Indenter("flat", 2.5 * MM, material), Pose(0, 0, 0.4 * MM))
        loads.append(-wrench[2])
        shares.append(hat_force[inner, 2].sum() / hat_force[:, 2].sum())
    assert shares[1] > 1.5 * shares[0]
    assert loads[0] < loads[2] < loads[1]


def test_soft_indenters_shear_less_and_turn_with_their_face(pad):
    def sheared(material, turn, dx, dy):
        """Shear force that a small way sideways adds."""
        start, end = Pose(0, 0, 0.4 * MM, turn), Pose(dx, dy, 0.4 * MM, turn)
        return (load(pad, Indenter("t", 2.5 * MM, material), start, end, friction=0.9)[1]
                - load(pad, Indenter("t", 2.5 * MM, material), start, friction=0.9)[1])[:2]  # fmt: skip

    soft, way = Material(2e6), 0.03 * MM
    hard = sheared(None, np.pi / 2, way, 0)[0]
    along_bar = sheared(soft, np.pi / 2, way, 0)[0]
    assert 0.2 * hard < along_bar < 0.8 * hard
    # The same way in the indenter's own axes, all turned by a quarter (pad and mesh are not quite square).
    hard_turned, turned = (-sheared(material, 0.0, 0, -way)[1] for material in (None, soft))
    assert turned / hard_turned == pytest.approx(along_bar / hard, rel=0.03)
    assert sheared(soft, 0.0, way, 0)[0] / sheared(None, 0.0, way, 0)[0] < 0.9 * along_bar / hard


def test_one_solution_serves_every_size_and_hardness():
    small, large = (body_of(Indenter("flat", r, Material(e))) for r, e in ((2 * MM, 1e6), (4 * MM, 3e6)))
    np.testing.assert_allclose(small.compliance, 6 * large.compliance)


def test_rigid_indenters_have_no_body():
    with pytest.raises(InputError, match="material"):
        body_of(Indenter("sphere", 3 * MM))
    with pytest.raises(InputError, match="two indenters"):
        Indenter("two", 1 * MM, Material(1e6), Indenter.two(*[Indenter("sphere", MM)] * 2, MM).form)


def inner_over_outer(model, force):
    """Mean tangential force of the nodes within half of the contact's radius over that of the others."""
    x, y = (a.ravel() for a in np.meshgrid(model.node_x(), model.node_y()))
    pressure = np.maximum(-force[:, 2], 0)
    away = np.hypot(x - (pressure @ x) / pressure.sum(), y - (pressure @ y) / pressure.sum())
    touched = pressure > 0.02 * pressure.max()
    inner = touched & (away < 0.5 * away[touched].max())
    shear = np.hypot(force[:, 0], force[:, 1])
    return shear[inner].mean() / shear[touched & ~inner].mean()


def test_a_ball_that_sticks_is_sheared_at_the_rim_and_one_that_slides_in_the_middle(pad):
    ball = Indenter("sphere", 6 * MM, Material.of_shore_a(10, core_part=0.3, skin_part=0.05))
    soft = Indenter("sphere", 6 * MM, Material.of_shore_a(10))
    down = Pose(0, 0, 0.9 * MM)
    held, slid, soft_held = (
        inner_over_outer(pad, kept(solved, pad, indenter, (down, Pose(way, 0, 0.9 * MM)), 0.5)[1])
        for indenter, way in ((ball, 0.2 * MM), (ball, 1.8 * MM), (soft, 0.2 * MM))
    )
    # After Mindlin a contact that sticks bears its shear at the rim; one that slides bears it as its pressure.
    assert held < 1 < slid
    assert soft_held < held  # a core draws shear to itself
