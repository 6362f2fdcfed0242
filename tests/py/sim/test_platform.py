"""A tray on springs in a rubber sleeve: against a model of the wire itself, closed forms, and exact balance."""

import dataclasses

import numpy as np
import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.bodies.connector import CONDITIONS, RANGES, connector
from ruffini.sim.bodies.platform import (
    STEEL_E_PA,
    STEEL_G_PA,
    Platform,
    Tray,
    about_origin,
    rigid_modes,
    sleeve_stiffness,
    spring_stiffness,
)
from ruffini.sim.bodies.platform_unit import PlatformUnit
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.pose import Pose
from ruffini.sim.programs import Load
from ruffini.sim.prony import Prony
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import WarmthSettings, load_reproduce
from ruffini.sim.reproduce.solved import _key
from ruffini.sim.reproduce.warmth import warmed
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Scripted
from ruffini.sim.settings import load_twin
from ruffini.sim.story import play

MM = 1e-3
SPRING = {"length": 15 * MM, "coil_radius": 1.75 * MM, "wire": 0.5 * MM, "n_coils": 8.0}


def wire_compliance(length, coil_radius, wire, n_coils):
    """Compliance of a helical wire's upper end, on the axis, by Castigliano's theorem on the true curve, (6, 6)."""
    angle = (np.arange(4000) + 0.5) / 4000 * 2 * np.pi * n_coils
    rise = length / (2 * np.pi * n_coils)
    place = np.column_stack([coil_radius * np.cos(angle), coil_radius * np.sin(angle), rise * angle])
    tangent = np.column_stack([-coil_radius * np.sin(angle), coil_radius * np.cos(angle), np.full_like(angle, rise)])
    speed = np.linalg.norm(tangent, axis=1)
    tangent /= speed[:, None]
    arm = np.array([0, 0, length]) - place
    moment = np.zeros((len(angle), 3, 6))  # in the wire, for unit forces and moments at the end
    for j in range(3):
        moment[:, :, j] = np.cross(arm, np.eye(3)[j])
        moment[:, j, 3 + j] = 1
    twist = np.einsum("ni,nij->nj", tangent, moment)
    inertia = np.pi * wire**4 / 64
    step = speed * 2 * np.pi * n_coils / 4000
    total = np.einsum("nij,nik,n->jk", moment, moment, step)
    twisted = np.einsum("nj,nk,n->jk", twist, twist, step)
    return (total - twisted) / (STEEL_E_PA * inertia) + twisted / (STEEL_G_PA * 2 * inertia)


def test_a_spring_is_its_wire():
    column, wire = np.linalg.inv(spring_stiffness(**SPRING)), wire_compliance(**SPRING)
    # A coil's pitch of 8 degrees, which the formulas leave out, is worth 3 %; no coil is a whole cylinder either.
    np.testing.assert_allclose(np.diag(column), np.diag(wire), rtol=0.04)
    assert column[0, 4] == pytest.approx(wire[0, 4], rel=0.04)
    assert column[1, 3] == pytest.approx(wire[1, 3], rel=0.04)


def test_a_sleeve_is_a_rubber_column():
    k = sleeve_stiffness(15 * MM, 10.5 * MM, 15.5 * MM, 69e3)
    area = np.pi * (15.5**2 - 10.5**2) * MM**2
    assert k[2, 2] == pytest.approx(69e3 * area / (15 * MM))
    assert k[5, 5] == pytest.approx(23e3 * np.pi / 2 * (15.5**4 - 10.5**4) * MM**4 / (15 * MM))


def test_moving_a_stiffness_keeps_its_energy():
    rng = np.random.default_rng(1)
    place, motion = np.array([5, -3, -7]) * MM, rng.normal(size=6)
    one = spring_stiffness(**SPRING)
    there = motion.copy()
    there[:3] = rigid_modes(place[None])[0] @ motion
    assert motion @ about_origin(one, place) @ motion == pytest.approx(there @ one @ there)


def test_the_tray_carries_what_the_paper_says():
    settings = load_twin(find_board("ftouch")).platform
    platform = Platform.of(settings)
    whole = platform.springs + platform.sleeve
    assert np.linalg.eigvalsh(whole).min() > 0
    axial = 6 * STEEL_G_PA * 0.5**4 * MM / (8 * 3.5**3 * 8)  # G d^4 / (8 D^3 n) of six springs
    assert platform.springs[2, 2] == pytest.approx(axial)
    moved = np.abs(np.linalg.solve(whole, np.diag(RANGES)))
    assert 0.3 * MM < moved[2, 2] < 2 * MM  # 8 N
    assert moved[3:, 3:].max() < 0.05  # 20 N mm: small turns


@pytest.fixture(scope="module")
def unit():
    board = find_board("ftouch")
    pad = board.pad
    model = PadModel(
        pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6, pad.modulus_pa,
        pad.poisson_1e4 * 1e-4, n_cells_x=12, n_cells_y=10, layers=(0.3, 0.7),
    )  # fmt: skip
    twin = load_twin(board)
    return PlatformUnit(board, twin, model, kept(surface_compliance, model), platform=Platform.of(twin.platform))


def test_load_through_the_gel_is_the_load_of_the_tray(unit):
    stiff = dataclasses.replace(unit.platform, relaxation=Prony())
    rig = dataclasses.replace(unit, platform=stiff).rig()
    rig.take(Indenter("sphere", 4 * MM))
    for i in range(4):
        rig.advance(Pose(3 * MM + i * 0.1 * MM, MM, (i + 1) * 0.3 * MM))
    force = rig.wrench()
    assert force[2] < -1
    np.testing.assert_allclose((stiff.springs + stiff.sleeve) @ rig.tray.row(), force, rtol=1e-9, atol=1e-12)
    _x, y = np.meshgrid(*(np.linspace(-s / 2, s / 2, n) for s, n in ((20 * MM, 31), (18 * MM, 28))))
    nodal = rig.nodal_force()
    np.testing.assert_allclose(nodal.sum(axis=(0, 1)), force[:3], rtol=1e-9, atol=1e-12)
    assert (y * nodal[..., 2]).sum() == pytest.approx(force[3], rel=1e-6)
    # Tilt towards the load, and the bottom of the dent is where the ball is, over all.
    assert rig.tray.turn_rad[1] > 0
    deepest = (rig.displacement + rig._response.carried(rig.tray.row()))[:, 2].min()
    assert deepest == pytest.approx(-1.2 * MM, abs=0.15 * MM)


def test_a_softer_tray_takes_load_off_the_gel(unit):
    loads = []
    for factor in (1e6, 1.0, 0.5):
        soft = dataclasses.replace(unit.platform, springs=unit.platform.springs * factor)
        rig = dataclasses.replace(unit, platform=soft).rig()
        rig.take(Indenter("sphere", 4 * MM))
        rig.advance(Pose(0, 0, MM))
        loads.append(-rig.wrench()[2])
    assert loads[0] > 1.05 * loads[1] > 1.1 * loads[2]


def test_the_sleeve_relaxes_and_remembers(unit):
    platform = unit.platform
    tray = Tray(platform)
    load = np.array([0, 0, -8.0, 0, 0, 0])
    sunk = []
    for step_s in (1e-6, 0.1, 0.1, 1e4):
        tray.begin(step_s)
        tray.load(load)
        tray.commit()
        sunk.append(tray.shift[2])
    scale = platform.relaxation.scale  # the sleeve's modulus is the one after a second
    at_once = -8 / (platform.springs[2, 2] + scale * platform.sleeve[2, 2])
    for_ever = -8 / (platform.springs[2, 2] + 0.72 * scale * platform.sleeve[2, 2])
    assert sunk[0] == pytest.approx(at_once, rel=1e-5)
    assert at_once > sunk[1] > sunk[2] > sunk[3]
    assert sunk[3] == pytest.approx(for_ever, rel=1e-3)
    tray.begin(0.01)
    tray.load(np.zeros(6))
    tray.commit()
    assert tray.shift[2] < -1e-6  # it creeps back


def test_every_condition_of_the_paper_is_loaded(unit):
    story = connector(3, 10, np.random.default_rng(1))
    loads = [step for step in story if isinstance(step, Load)]
    assert len(loads) == 18  # the 17th both ways
    for signs, load in zip(CONDITIONS, loads, strict=False):
        peak = load.wrenches[np.abs(load.wrenches / RANGES).sum(axis=1).argmax()]
        assert (np.sign(peak) == signs).all()
        assert (np.abs(load.wrenches) <= 1.3 * RANGES).all()
    moments = [(m.wrench(), m.tray.row()) for m in play(unit, story)]
    wrenches, trays = (np.array(rows) for rows in zip(*moments, strict=True))
    assert (wrenches[:3] == 0).all()
    # One linear law explains the tray's motion but for the sleeve's memory.
    law, *_ = np.linalg.lstsq(trays, wrenches, rcond=None)
    lack = np.sqrt(((trays @ law - wrenches) ** 2).mean(axis=0)) / RANGES
    assert 1e-4 < lack.max() < 0.05


def test_what_cannot_be_loaded_is_refused(unit, coarse_unit):
    with pytest.raises(InputError, match="has no platform"):
        next(play(coarse_unit, [Load(np.zeros((1, 6)), [True])]))
    with pytest.raises(InputError, match="of way"):
        unit.rig().load(np.array([0, 0, -100.0, 0, 0, 0]))
    rig = unit.rig()
    rig.take(Indenter("sphere", 8 * MM))
    with pytest.raises(InputError, match="press less deep"):
        rig.advance(Pose(0, 0, 4 * MM))


def test_targets_move_with_the_tray(unit):
    renderer = unit.renderer()
    rig = unit.rig()
    rest = renderer.image(rig.displacement, np.random.default_rng(1), tray=rig.tray)
    assert rig.tray == TrayPose()
    rig.load(np.array([1.0, 0, 0, 0, 0, 0]))
    moved = renderer.image(rig.displacement, np.random.default_rng(1), tray=rig.tray)
    left, right = (np.argwhere(picture[:, :, 1] < 30)[:, 1].mean() for picture in (rest, moved))
    assert right > left + 5


def test_the_live_twin_shows_the_tray(unit):
    frames = Scripted(unit, Scenario(program="connector", n=3))
    trays = [frames.states(i)[2] for i in range(len(frames))]
    assert trays[0] == TrayPose()
    assert min(tray.shift_m[2] for tray in trays) < -0.2 * MM
    pictures = [unit.renderer().image(*frames.states(i)[:1], np.random.default_rng(1), tray=trays[i]) for i in (0, 12)]
    assert (pictures[0] != pictures[1]).any()


def test_a_warm_tray_gives_way_as_its_parts_do(unit):
    """Steel softer, rubber stiffer; its mechanics is kept under another name than the cold one's."""

    def sunk(**per_k):
        rig = warmed(unit, WarmthSettings(**per_k), 20.0).rig()
        rig.load(np.array([0, 0, -5.0, 0, 0, 0]))
        return rig.tray.shift_m[2]

    cold = sunk()
    assert sunk(springs_1e6=2500, sleeve_1e6=2500) == pytest.approx(cold / 1.05, rel=1e-9)
    assert sunk(springs_1e6=-270) < cold < sunk(sleeve_1e6=3400) < 0
    run = runs_of(load_reproduce(unit.board, "warm.toml"))[0]
    assert _key(unit, run) != _key(warmed(unit, WarmthSettings(sleeve_1e6=3400), 20.0), run)
    assert warmed(unit, WarmthSettings(sleeve_1e6=3400), 0.0) is unit
