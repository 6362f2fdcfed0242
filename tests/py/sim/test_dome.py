"""The rubber dome: shell against derivatives, rigid motion, Reissner; balance, friction, collapse, relaxation."""

import numpy as np
import pytest
from kept import kept
from scipy.spatial.transform import Rotation

from ruffini.boards import find_board
from ruffini.errors import InputError, RuffiniError
from ruffini.sim.bodies.dome import DomeModel, places
from ruffini.sim.bodies.dome_unit import DomeUnit
from ruffini.sim.bodies.settings import DomeSettings
from ruffini.sim.bodies.sheet import SheetState
from ruffini.sim.bodies.tool import Grip, ToolContact
from ruffini.sim.indenters import Indenter, Material
from ruffini.sim.optics.charts import Dome
from ruffini.sim.pose import Pose
from ruffini.sim.prony import Prony
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import PadError

MM = 1e-3
RADIUS, MODULUS, POISSON = 22 * MM, 5.5e6, 0.49
FRICTION = 0.5


def dome(thickness=1 * MM, n_cells=14):
    return DomeModel(RADIUS, thickness, MODULUS, POISSON, n_cells).sheet()


@pytest.fixture(scope="module")
def thin():
    return dome()


def test_the_chart_is_the_cameras():
    a, b = np.meshgrid(np.linspace(-36, 36, 9), np.linspace(-30, 30, 7))
    np.testing.assert_allclose(places(a, b, 22.0), Dome(22.0).points(a, b), atol=1e-5)


def assembled(shell, tangent, move):
    out = np.zeros_like(move)
    local = move[shell.patch.functions].reshape(-1, 48, 1)
    np.add.at(out, shell.patch.functions, (tangent @ local).reshape(-1, 16, 3))
    return out


def test_forces_and_tangent_are_derivatives_of_the_energy():
    shell = dome(n_cells=8).shell
    rng = np.random.default_rng(1)
    bent = shell.rest + rng.normal(0, 0.3 * MM, shell.rest.shape)
    move, step = rng.normal(size=bent.shape), 1e-7
    force, tangent = shell.balance(bent)
    slope = (shell.energy(bent + step * move) - shell.energy(bent - step * move)) / (2 * step)
    assert (force * move).sum() == pytest.approx(slope, rel=1e-6)
    change = (shell.balance(bent + step * move)[0] - shell.balance(bent - step * move)[0]) / (2 * step)
    np.testing.assert_allclose(assembled(shell, tangent(), move), change, atol=1e-6 * np.abs(change).max())


def test_moving_and_turning_as_a_whole_costs_nothing(thin):
    turn = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
    moved = thin.shell.rest @ turn.T + [3 * MM, 0, -5 * MM]
    scale = MODULUS * (1 * MM) ** 2  # a force
    assert np.abs(thin.shell.balance(moved)[0]).max() < 1e-9 * scale


@pytest.mark.parametrize(("thickness", "rel"), [(0.5 * MM, 0.035), (1 * MM, 0.06)])
def test_point_stiffness_is_reissners(thickness, rel):
    """k = 8 E t^2 / (R sqrt(12 (1 - nu^2))) for t << R (E. Reissner, 1946): the difference falls with t / R."""
    model = dome(thickness, 28)
    tangent = model.shell.balance(model.shell.rest)[1]()
    at_top = model.shell.patch.at_places(np.zeros(1), np.zeros(1)).toarray()[0]
    load = np.outer(at_top, [0, 0, 1.0])[model.is_free]
    stiffness = 1 / float(model.solver(tangent)(load) @ load)
    theory = 8 * MODULUS * thickness**2 / (RADIUS * np.sqrt(12 * (1 - POISSON**2)))
    assert stiffness == pytest.approx(theory, rel=rel)


def pressed(model, indenter, depths, *, rotation=None, friction=FRICTION, relaxation=None, hold_s=0.0):
    state = SheetState(model, friction, relaxation)
    skin = MODULUS / model.shell.thickness_m
    tool = ToolContact(indenter, skin, skin / 3, model.points.shape[0])
    rotation = np.eye(3) if rotation is None else rotation
    middle = np.array([0, 0, -RADIUS])
    forces = []
    for depth in depths:
        tip = middle + rotation[:, 2] * (RADIUS - depth)
        state.advance(tool, Grip(tip, rotation, indenter.reach_m), hold_s)
        forces.append(-state.wrench()[:3] @ rotation[:, 2])
    return state, tool, np.array(forces)


def test_clamps_carry_the_tools_wrench(thin):
    lean = Rotation.from_rotvec([0.2, 0.3, 0]).as_matrix()
    state, _, forces = pressed(thin, Indenter("square", 5 * MM), [0.4 * MM, 0.8 * MM], rotation=lean)
    assert forces[-1] > 0.2
    nodal, _ = thin.shell.balance(state.place)
    clamped = ~thin.is_free[:, 0]
    held, at = nodal[clamped], state.place[clamped]
    wrench = state.wrench()
    np.testing.assert_allclose(held.sum(axis=0), -wrench[:3], atol=1e-5 * forces[-1])
    np.testing.assert_allclose(np.cross(at, held).sum(axis=0), -wrench[3:], atol=1e-5 * forces[-1] * RADIUS)


def test_a_dragged_ball_sticks_then_slides_at_coulombs_limit(thin):
    indenter = Indenter("sphere", 5 * MM)
    state, tool, forces = pressed(thin, indenter, [0.25 * MM, 0.5 * MM])
    shear = []
    for way in (0.02, 0.4, 0.8):
        tip = np.array([way * MM, 0, -0.5 * MM])
        state.advance(tool, Grip(tip, np.eye(3), indenter.reach_m), 0.0)
        shear.append(state.wrench()[0] / -state.wrench()[2])
    touched = state.force.any(axis=1)
    assert 0.01 < shear[0] < 0.5 * FRICTION
    assert shear[-1] == pytest.approx(FRICTION, rel=0.1)  # the dent leans, so not to the digit
    assert state.slips[touched].all()
    assert forces[-1] > 0


def loads_of_a_flat_end(thickness_m, n_cells, depths_m):
    return pressed(dome(thickness_m, n_cells), Indenter("flat", 5 * MM), depths_m)[2]


def test_walls_collapse_where_the_paper_says():
    """Fig. 6 of the stereo paper at Shore 70: 1.0 mm gives 4 mm at 1 N, 2.0 mm collapses at 7 N, 2.5 mm stands 10 N."""
    depths = np.arange(0.5, 5.1, 0.5) * MM
    at_4mm = 7  # further in, a thin wall is slow to compute
    asked = ((1.0, 12, at_4mm + 1), (2.0, 10, len(depths)), (2.5, 10, at_4mm))
    loads = {t: kept(loads_of_a_flat_end, t * MM, cells, depths[:n]) for t, cells, n in asked}
    assert loads[1.0][at_4mm] == pytest.approx(1.0, rel=0.15)
    assert loads[1.0].max() == pytest.approx(1.05, rel=0.15)  # all that it stands until then
    assert 5.5 < loads[2.0].max() < 7.5
    assert loads[2.0][-1] - loads[2.0][-3] < 0.1 * loads[2.0][1]  # no stiffness is left
    assert loads[2.5].max() > 10


def test_a_held_dome_relaxes_and_a_released_one_recovers(thin):
    relaxation = Prony(((0.2, 0.5),))
    state, tool, forces = pressed(thin, Indenter("sphere", 5 * MM), [0.5 * MM], relaxation=relaxation)
    state.advance(tool, tool.grip, 50.0)
    assert -state.wrench()[2] == pytest.approx(0.8 * forces[0], rel=0.02)
    state.free(1e-3)
    left = np.abs(state.place - thin.shell.rest).max()
    assert left > 1e-6
    state.free(100.0)
    assert np.abs(state.place - thin.shell.rest).max() < 0.01 * left


@pytest.fixture(scope="module")
def unit():
    board = find_board("stereo-fingertip")
    twin = load_twin(board).model_copy(update={"dome": DomeSettings(cells=12)})
    return DomeUnit.build(board, PadError(), twin)


def test_truth_at_the_boards_nodes(unit):
    rig = unit.rig()
    rig.take(Indenter("flat", 5 * MM))
    rig.advance(Pose(4 * MM, -2 * MM, 1 * MM))
    wrench, nodal = rig.wrench(), rig.nodal_force()
    assert wrench[2] < -0.1
    np.testing.assert_allclose(nodal.sum(axis=(0, 1)), wrench[:3], atol=1e-12)
    row, column = np.unravel_index(nodal[..., 2].argmin(), nodal.shape[:2])
    assert np.hypot((column - 9) * 44 / 18 - 4, (row - 9) * 44 / 18 + 2) < 5  # under the tool
    moved = rig.nodal_displacement()
    assert moved[row, column, 2] < -0.3 * MM
    assert (moved[0] == 0).all()
    assert set(np.unique(rig.nodal_state())) <= {0, 1, 2}
    assert rig.nodal_state()[row, column]
    rig.rest()
    assert (rig.wrench() == 0).all()


def test_the_sensor_turned_under_a_tool_is_pressed_along_its_radius(unit):
    rig = unit.rig()
    rig.take(Indenter("sphere", 5 * MM))
    rig.advance(Pose(0, 0, 0.5 * MM, 0, 0, np.pi / 4))
    force = rig.wrench()[:3]
    np.testing.assert_allclose(
        force / np.linalg.norm(force), [-(0.5**0.5), 0, -(0.5**0.5)], atol=0.05
    )  # the rim is near


def test_pins_show_the_dent(unit):
    renderer, rig = unit.renderer(), unit.rig()
    rest = renderer.image(rig.displacement, np.random.default_rng(1)).astype(float)
    rig.take(Indenter("flat", 5 * MM))
    rig.advance(Pose(0, 0, 1.5 * MM))
    change = np.abs(renderer.image(rig.displacement, np.random.default_rng(1)) - rest)
    assert change[100:140, 150:220].max() > 60
    assert change[:20].max() < 50


@pytest.mark.parametrize(
    ("pose", "sentence"),
    [
        (Pose(21 * MM, 0, MM), "beside the dome"),
        (Pose(0, 0, 12 * MM), "press less deep"),
        (Pose(0, 0, MM, 0, 1.3, 0), "cannot be turned"),
    ],
)
def test_poses_that_cannot_be(unit, pose, sentence):
    rig = unit.rig()
    rig.take(Indenter("sphere", 5 * MM))
    with pytest.raises(InputError, match=sentence):
        rig.advance(pose)


def test_what_the_model_does_not_have_is_refused(unit):
    with pytest.raises(InputError, match="only rigid tools"):
        unit.rig().take(Indenter("sphere", 5 * MM, Material(1e6)))
    with pytest.raises(InputError, match="no platform"):
        unit.rig().load(np.zeros(6))
    with pytest.raises(InputError, match="is no shell"):
        DomeUnit.build(unit.board, PadError(thickness=9.0), unit.twin)


def test_a_shell_without_stiffness_is_told(thin):
    n = len(thin.shell.patch.functions)
    with pytest.raises(RuffiniError, match="lost its stiffness"):
        thin.solver(np.zeros((n, 48, 48)))
