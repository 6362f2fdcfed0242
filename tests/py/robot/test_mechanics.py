"""The reduced pad against the twin's full model: force over depth, shear, and where the surface goes."""

import numpy as np
import pytest
from kept import kept
from worlds import BOARD

pytest.importorskip("mujoco", reason="extra [robot]")

from ruffini.boards import find_board
from ruffini.errors import RuffiniError
from ruffini.robot import mechanics
from ruffini.robot.mechanics import PadContact, PadSolid
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.settings import MeshSettings, load_twin
from ruffini.sim.unit import TwinUnit

FRICTION = 0.7
DEPTHS_MM = (0.3, 0.5, 0.7)
SHEARS_MM = (0.1, 0.3, 0.5)
STEP_MM = 0.01
# Forces within 5 % of the board's own mesh, most within 2, in a tenth of its time.
MESH = MeshSettings(cells_x=16, cells_y=13)
# And how far off the surface is, rms, of the depth: the border of a flat lies between two nodes.
SHAPES = {"small ball": ("sphere", 6e-3, 0.06), "ball": ("sphere", 15e-3, 0.06), "flat": ("flat", 4e-3, 0.14)}


def full_press(shape, radius_m):
    """Normal force at each depth, then shear force at each way, newtons; and the surface at the end, (n_y, n_x, 3)."""
    board = find_board(BOARD)
    unit = TwinUnit.build(board, twin=load_twin(board).model_copy(update={"mesh": MESH}))
    solver = ContactSolver(unit.model, unit.response(), Indenter(shape, radius_m), FRICTION)
    normal, shear = [], []
    for depth in DEPTHS_MM:
        solver.advance(Pose(0, 0, depth * 1e-3))
        normal.append(-solver.nodal_force[:, 2].sum())
    for way in SHEARS_MM:
        solver.advance(Pose(way * 1e-3, 0, DEPTHS_MM[-1] * 1e-3))
        shear.append(solver.nodal_force[:, 0].sum())
    return np.array(normal), np.array(shear), unit.at_nodes(solver.displacement)


@pytest.fixture(scope="module")
def solid():
    return PadSolid.of_board(find_board(BOARD))


@pytest.mark.parametrize("name", SHAPES)
def test_force_shear_and_surface_are_the_twins(solid, name):
    shape, radius_m, tolerance = SHAPES[name]
    normal, shear, surface = kept(full_press, shape, radius_m)
    contact, indenter = PadContact(solid), Indenter(shape, radius_m)
    n = len(solid.place)

    def advance(way_mm, depth_mm, step_mm):
        depth = depth_mm * 1e-3 - indenter.height(solid.place[:, 0] - way_mm * 1e-3, solid.place[:, 1])
        motion = np.tile([step_mm * 1e-3, 0.0], (n, 1))
        contact.advance(depth, motion, np.full(n, FRICTION), np.zeros((n, 3)))

    found = []
    for depth in np.arange(STEP_MM, DEPTHS_MM[-1] + STEP_MM / 2, STEP_MM):
        advance(0.0, depth, 0.0)
        found.append(-contact.force[:, 2].sum())
    found = [found[round(depth / STEP_MM) - 1] for depth in DEPTHS_MM]
    np.testing.assert_allclose(found, normal, rtol=0.1, atol=0.05)
    found = []
    for way in np.arange(STEP_MM, SHEARS_MM[-1] + STEP_MM / 2, STEP_MM):
        advance(way, DEPTHS_MM[-1], STEP_MM)
        found.append(contact.force[:, 0].sum())
    found = [found[round(way / STEP_MM) - 1] for way in SHEARS_MM]
    np.testing.assert_allclose(found, shear, rtol=0.1, atol=0.02)
    moved = contact.board_displacement().reshape(surface.shape)
    assert np.sqrt(np.mean((moved - surface) ** 2)) < tolerance * DEPTHS_MM[-1] * 1e-3


def test_pressure_is_found_where_the_active_set_does_not_settle(solid, monkeypatch):
    """One round never does for a ball that touches as a whole at first."""
    n = len(solid.place)
    depth = 0.5e-3 - Indenter("sphere", 6e-3).height(solid.place[:, 0], solid.place[:, 1])
    found = []
    for rounds in (30, 1):
        monkeypatch.setattr("ruffini.robot.mechanics.MAX_ROUNDS", rounds)
        contact = PadContact(solid)
        contact.advance(depth, np.zeros((n, 2)), np.full(n, FRICTION), np.zeros((n, 3)))
        found.append(contact.force)
    assert (found[0][depth > 0, 2] == 0).any()
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)


def test_pressure_pushes_and_friction_is_within_its_cone(solid):
    rng = np.random.default_rng(3)
    contact, n = PadContact(solid), len(solid.place)
    for _ in range(40):
        bumps = sum(
            np.exp(-((solid.place - rng.uniform(-6e-3, 6e-3, 2)) ** 2).sum(axis=1) / (2 * 2e-3**2)) for _ in range(4)
        )
        depth = 0.4e-3 * bumps - 0.15e-3
        contact.advance(depth, rng.normal(0, 2e-5, (n, 2)), np.full(n, 0.5), np.zeros((n, 3)))
        shear = np.hypot(contact.force[:, 0], contact.force[:, 1])
        assert (contact.force[:, 2] <= 0).all()
        assert (contact.force[depth <= 0] == 0).all()
        assert (shear <= -0.5 * contact.force[:, 2] * (1 + 1e-9)).all()
        presses = contact.force[:, 2] < 0
        given = -solid.mean[2] @ contact.force[:, 2] * -1
        np.testing.assert_allclose(-given[presses], depth[presses], atol=1e-12)
        assert (-given[depth > 0] >= depth[depth > 0] - 2e-9).all()
    contact.advance(np.full(n, -1e-6), np.zeros((n, 2)), np.full(n, 0.5), np.zeros((n, 3)))
    assert not contact.force.any()


def test_a_compliance_that_is_not_definite_gives_no_forces():
    nodes = mechanics._NodeSet(np.stack(3 * [np.array([[1.0, 2.0], [2.0, 1.0]])]), np.arange(2))
    with pytest.raises(RuffiniError, match="its mesh is too fine"):
        nodes.solve(2, np.ones(2))
    with pytest.raises(RuffiniError, match="its mesh is too fine"):
        mechanics._sliding(nodes, np.ones((2, 2)), np.full(2, 9.0), np.zeros((2, 2)), np.zeros(2, bool))
