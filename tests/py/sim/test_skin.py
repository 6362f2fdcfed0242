"""The skin round a tube: shell against a published roof and a plate on springs, pyramids, loops, truth."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.bodies import skin_unit
from ruffini.sim.bodies.pyramid import PyramidLaw, bar_shortening, slice_stretch
from ruffini.sim.bodies.sheet import Sheet, SheetState
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.bodies.skin import around, bonded_modulus
from ruffini.sim.bodies.skin_unit import IDLE_PART, SkinUnit
from ruffini.sim.bodies.splines import Line, Patch
from ruffini.sim.bodies.tool import Grip, ToolContact
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.lights.electroluminescent import Openings
from ruffini.sim.pose import Pose
from ruffini.sim.prony import Prony
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import PadError

MM = 1e-3


def shell_of(line_a, line_b, points, thickness, modulus, poisson):
    patch = Patch.of(line_a, line_b)
    rest = patch.interpolated(points(*np.meshgrid(line_a.greville(), line_b.greville())))
    return Shell(patch, rest, thickness, modulus, poisson)


def test_the_roof_of_scordelis_and_lo():
    """Roof on diaphragms under its weight: 0.3024 down at the middle of a free edge (MacNeal and Harder, 1985)."""
    angle, length = np.deg2rad(40), 50.0
    line_a, line_b = Line(np.linspace(-angle, angle, 13)), Line(np.linspace(-length / 2, length / 2, 13))
    shell = shell_of(line_a, line_b, lambda a, b: around(a, b, 25.0), 0.25, 4.32e8, 0.0)
    is_free = np.ones_like(shell.rest, dtype=bool)
    ends = np.isclose(np.abs(shell.rest[:, 2]), length / 2)
    is_free[ends, :2] = False  # diaphragms: they let the roof go along its axis
    is_free[np.flatnonzero(ends)[0], 2] = False
    sheet = Sheet(shell, is_free)
    tangent = shell.balance(shell.rest)[1]()
    weight = sheet.points.T @ np.outer(sheet.touch_areas.ravel(), [-90.0, 0, 0])
    moved = np.zeros_like(shell.rest)
    moved[is_free] = sheet.solver(tangent)(weight[is_free])
    edge = shell.patch.at_places(np.array([angle]), np.zeros(1)) @ moved
    assert edge[0, 0] == pytest.approx(-0.3024, rel=0.01)


class Springs:
    """A foundation with one stiffness per area."""

    def __init__(self, sheet, stiffness):
        self._areas, self._k = sheet.touch_areas.reshape(-1, 1), stiffness
        self._tangent = sheet.spread(np.broadcast_to(stiffness * np.eye(3), (len(self._areas), 3, 3)))

    def begin(self, duration_s):
        pass

    def hold(self, moved):
        return -self._k * self._areas * moved, lambda: self._tangent

    def commit(self):
        pass


def test_a_plate_on_springs_gives_way_as_hertz_says():
    """w = P / (8 sqrt(k D)) under a point load on an endless plate (H. Hertz, 1884)."""
    thickness, modulus, poisson, k = 0.3 * MM, 2e9, 0.3, 2e7
    line = Line(np.linspace(-40, 40, 27) * MM)
    shell = shell_of(line, line, lambda a, b: np.stack([a, b, 0 * a], axis=-1), thickness, modulus, poisson)
    sheet = Sheet(shell, np.ones_like(shell.rest, dtype=bool))
    state = SheetState(sheet, 0.0, foundation=Springs(sheet, k))
    tool = ToolContact(Indenter("sphere", 1 * MM), 1e12, 1e12, sheet.points.shape[0])
    state.advance(tool, Grip(np.array([0, 0, -0.01 * MM]), np.eye(3), 1 * MM), 0.0)
    down = -float((sheet.points @ (state.place - shell.rest))[:, 2].min())
    bending = modulus * thickness**3 / (12 * (1 - poisson**2))
    assert -state.wrench()[2] == pytest.approx(8 * np.sqrt(k * bending) * down, rel=0.03)


def test_a_slice_is_neo_hookean_rubber():
    s = slice_stretch(np.array([0.0, 1e-4, 0.5, 10.0, 1e6]))
    np.testing.assert_allclose(1 / s**2 - s, [0, 1e-4, 0.5, 10, 1e6], atol=1e-9, rtol=1e-9)
    even = bar_shortening(np.array([0.01]), np.full(50, 1e-4), np.linspace(0, 3 * MM, 50), 23e3)
    assert even[0] == pytest.approx(0.01 / (1e-4 * 3 * 23e3) * 3 * MM, rel=0.01)  # F h / (A E), small


def test_a_pyramids_force_goes_with_the_square_and_is_near_a_cones():
    law = PyramidLaw(6 * MM, 3 * MM, 70e3)
    curve = law.curve()
    short = np.array([0.02, 0.04, 0.08]) * MM
    force = curve(short)
    np.testing.assert_allclose(force[1:] / force[:-1], 4, rtol=0.02)
    # Sneddon's rigid cone on a half-space, F = 2 E* d^2 tan(alpha) / pi, alpha = 45 degrees as here; a square is 4 / pi
    # of its inscribed circle. Not the same body: flat sections make the bar 1.7 times as stiff.
    cone = 4 / np.pi * 2 / np.pi * 70e3 / 0.75 * short**2
    np.testing.assert_allclose(force / cone, 1.68, rtol=0.02)
    assert curve(2.4 * MM) / curve(1.2 * MM) > 6  # the base takes part


def test_gents_bonded_layer():
    assert bonded_modulus(70e3, 6 * MM, 1.5 * MM) == pytest.approx(3 * 70e3)


def coarse_unit():
    board = find_board("eltac")
    twin = load_twin(board)
    coarse = twin.skin.model_copy(update={"cells_x": 6, "cells_y": 12})
    return SkinUnit.build(board, PadError(), twin.model_copy(update={"skin": coarse}))


@pytest.fixture(scope="module")
def unit():
    return coarse_unit()


def pyramid_near(unit, x_mm, y_mm):
    a, b = unit.lattice.places()
    i = int(np.hypot(a - x_mm, b - y_mm).argmin())
    return float(a[i]) * MM, float(b[i]) * MM


class Pressed(NamedTuple):
    """What a press did: wrench, displacement of the surface, its forces, and the load of each panel it reached."""

    wrench: np.ndarray
    displacement: np.ndarray
    nodal_force: np.ndarray
    panel_loads: list


def press(rig, x, y, *depths):
    rig.take(Indenter("sphere", 5 * MM))
    for depth in depths:
        rig.advance(Pose(x, y, depth), 0.25)
    loads = [np.linalg.norm(panel.state.force.sum(axis=0)) for panel in rig._panels.values()]
    return Pressed(rig.wrench(), rig.displacement, rig.nodal_force(), loads)


def pressed(x, y, depth, n=4):
    """On a fresh skin, in n steps."""
    return kept(press_in_steps, x, y, depth, n)


def press_in_steps(x, y, depth, n):
    return press(coarse_unit().rig(), x, y, *(depth * (i + 1) / n for i in range(n)))


def test_a_press_on_a_pyramid_brightens_that_one_most(unit):
    x, y = pyramid_near(unit, 30, 5)
    found = pressed(x, y, 3 * MM)
    force = found.wrench
    inward = -np.array([np.cos(x / 40e-3), np.sin(x / 40e-3), 0])
    assert 2 < np.linalg.norm(force[:3]) < 9
    np.testing.assert_allclose(force[:3] / np.linalg.norm(force[:3]), inward, atol=0.05)
    # Moment: the force at the panel's radius and at height y, about the middle of the tube.
    np.testing.assert_allclose(force[3:], np.cross([0, 0, y], force[:3]), atol=0.05 * np.linalg.norm(force[:3]) * 43e-3)
    np.testing.assert_allclose(found.nodal_force.sum(axis=(0, 1)), force[:3], atol=1e-12)
    renderer = unit.renderer()
    rng = np.random.default_rng
    change = renderer.image(found.displacement, rng(1)).astype(float) - renderer.image(unit.at_rest(), rng(1))
    v, u = np.unravel_index(change[:, :, :2].sum(axis=2).argmax(), change.shape[:2])
    place = np.array([[40 * np.cos(x / 40e-3), 40 * np.sin(x / 40e-3), y / MM]])
    expected, _ = renderer.views[0].view.project(place)
    assert np.hypot(u - expected[0, 0], v - expected[0, 1]) < 25  # its opening is 50 px wide


def test_between_pyramids_it_is_softer(unit):
    x, y = pyramid_near(unit, 30, 5)
    on = np.linalg.norm(pressed(x, y, 1.5 * MM, 3).wrench[:3])
    between = np.linalg.norm(pressed(x + 5.2 * MM, y, 1.5 * MM, 3).wrench[:3])
    assert 0.5 * on < between < 0.99 * on


def test_a_seam_is_pressed_on_both_panels_and_the_tube_closes():
    for x in (np.pi / 2 * 40e-3, np.pi * 40e-3):
        found = pressed(x, 0.0, 1.5 * MM, 2)
        assert len(found.panel_loads) == 2
        assert min(found.panel_loads) > 0.2 * np.linalg.norm(found.wrench[:3])


def press_twice(x, other, y):
    rig = coarse_unit().rig()
    press(rig, x, y, 0.5 * MM, 1 * MM)
    rig.rest()
    return press(rig, other, y, 0.5 * MM, 1 * MM)


def test_a_second_touch_elsewhere_is_as_on_a_fresh_skin(unit):
    (x, y), (other, _) = pyramid_near(unit, 30, 5), pyramid_near(unit, -30, 5)
    second, fresh = kept(press_twice, x, other, y), pressed(other, y, 1 * MM, 2)
    np.testing.assert_allclose(second.wrench, fresh.wrench, rtol=1e-6, atol=1e-9)
    assert len(second.panel_loads) == 2  # the first one is slow to come back


def test_a_panel_that_was_let_go_is_computed_ever_more_rarely(monkeypatch):
    left, counts = [], []
    for part in (0.0, IDLE_PART):
        monkeypatch.setattr(skin_unit, "IDLE_PART", part)
        rig = coarse_unit().rig()
        press(rig, 0.02, 0.005, 1.5 * MM, 3 * MM, 3 * MM)
        (panel,) = rig._panels.values()
        balances, free = [], panel.state.free
        monkeypatch.setattr(panel.state, "free", lambda s, free=free, balances=balances: (balances.append(s), free(s)))
        rig.frame_s = 0.25
        for _ in range(40):
            rig.rest()
        left.append(rig.displacement)
        counts.append(len(balances))
    assert counts[0] == 40
    assert 10 < counts[1] < 25
    assert np.abs(left[0]).max() > 3e-6
    np.testing.assert_allclose(left[1], left[0], atol=1e-6)


def loop(unit, speed_m_s, deepest=4 * MM, step=0.5 * MM):
    """Part of the work that a press and back does not give again."""
    rig = unit.rig()
    rig.take(Indenter("sphere", 5 * MM))
    x, y = pyramid_near(unit, 30, 5)
    n = round(deepest / step)
    depths = np.concatenate([np.arange(1, n + 1), np.arange(n - 1, -1, -1)]) * step
    forces = []
    for depth in depths:
        rig.advance(Pose(x, y, depth), step / speed_m_s)
        forces.append(np.linalg.norm(rig.wrench()[:3]))
    forces, depths = np.array([0, *forces]), np.array([0, *depths])
    return 1 + np.trapezoid(forces[n:], depths[n:]) / np.trapezoid(forces[: n + 1], depths[: n + 1]), rig


def lost_at(speed_m_s):
    """What a loop loses, whether the skin is slow to come back from it, and its wrench after rest."""
    loss, rig = loop(coarse_unit(), speed_m_s)
    is_slow = bool(rig._panels[2].moved.any())
    rig.rest()
    return loss, is_slow, rig.wrench()


@pytest.mark.parametrize(("speed_mm_s", "published"), [(0.1, 0.2827), (4.0, 0.2384)])
def test_loops_lose_what_the_papers_lose(speed_mm_s, published):
    """Table II; 21.6 to 28.3 % between 0.1 and 4 mm/s, pressed at a pyramid with the tip of 10 mm. A coarse skin."""
    loss, is_slow, wrench_after_rest = kept(lost_at, speed_mm_s * MM)
    assert loss == pytest.approx(published, rel=0.2)
    assert is_slow
    assert (wrench_after_rest == 0).all()


def test_without_relaxation_nothing_is_lost(unit):
    dry = unit.twin.skin.model_copy(update={"relax_1e3": [], "relax_ms": []})
    twin = unit.twin.model_copy(update={"skin": dry, "unit": unit.twin.unit.model_copy(update={"friction_1e3": 0})})
    assert dry.relaxation() == Prony()
    loss, _ = loop(SkinUnit.build(unit.board, PadError(), twin), 1 * MM, 1 * MM)
    assert abs(loss) < 1e-4


@pytest.mark.parametrize(
    ("pose", "sentence"),
    [
        (Pose(0, 61 * MM, MM), "beside the skin"),
        (Pose(0, 0, 5 * MM), "goes through the skin"),
        (Pose(0, 0, MM, 0, 0.6), "tilted by at most"),
    ],
)
def test_poses_that_cannot_be(unit, pose, sentence):
    rig = unit.rig()
    rig.take(Indenter("sphere", 5 * MM))
    with pytest.raises(InputError, match=sentence):
        rig.advance(pose)


def test_skins_that_cannot_be(unit):
    with pytest.raises(InputError, match="without"):
        SkinUnit.build(unit.board, PadError(), unit.twin.model_copy(update={"skin": None}))
    with pytest.raises(InputError, match="incompressible"):
        SkinUnit.build(unit.board, PadError(poisson=1.01), unit.twin)


def test_an_opening_sums_the_light_over_its_base(unit):
    """Two of the five rows of a base pressed by 1.5 mm, of an attenuation of 1.5 mm: (2 e + 3) / 5 of what it was."""
    light = unit.twin.light
    lattice = unit.lattice
    a, b = lattice.places()
    one = int(np.hypot(a - 30, b - 5).argmin())
    rest = SimpleNamespace(a=a[None], b=b[None], is_inside=np.ones((1, len(a)), dtype=bool))
    openings = Openings(light, lattice, rest)

    def look(grid, at_a, at_b):
        da, db = at_a - a[one], at_b - b[one]
        pressed = (np.abs(da) < 3) & (db > -3) & (db < -0.1 * 6)
        size = np.where(pressed, light.attenuation_um * 1e-3, 0.0) if grid == "displacement" else np.ones_like(at_a)
        return np.stack([size, 0 * size, 0 * size], axis=-1)

    surface = SimpleNamespace(inward="inward", displacement="displacement", look=look)
    lit = openings.shade(surface, np.ones(1, dtype=np.float32))[0, :, 0]
    assert lit[one] / np.median(lit) == pytest.approx((2 * np.e + 3) / 5, rel=1e-5)
    assert np.delete(lit, one) == pytest.approx(np.median(lit))
