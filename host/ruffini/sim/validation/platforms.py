"""Checks of the tray on springs in a sleeve: closed forms of its stiffness, and a ball on the gel that it carries.

Springs: handbook forms (Wahl, Mechanical Springs; Timoshenko) of axial, bending and shear rigidity. Columns clamped to
tray and base are beams with shear (Przemieniecki), phi = 12 B / (S L^2):
    k_shift = 12 B / (L^3 (1 + phi)),  k_both = 6 B / (L^2 (1 + phi)),  k_turn = (4 + phi) B / (L (1 + phi)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.bodies.platform import SHEAR_FACTOR, STEEL_E_PA, STEEL_G_PA, Platform, Tray, rigid_modes
from ruffini.sim.bodies.platform_unit import MAX_SINK_M, PlatformResponse
from ruffini.sim.bodies.settings import PlatformSettings
from ruffini.sim.contact import ContactSolver, Pose
from ruffini.sim.response import LinearResponse
from ruffini.sim.validation.contacts import FLAT, LAYERS_FLAT, Pad
from ruffini.sim.validation.rows import Outcome, Row

Array = npt.NDArray[np.float64]

MM = 1e-3
TRAY = PlatformSettings(  # a published tray, without relaxation
    n_springs=6, ring_um=13000, top_um=-7000, length_um=15000, coil_um=3500, wire_um=500, coils_1e3=8000,
    sleeve_inner_um=10500, sleeve_outer_um=15500, sleeve_modulus_pa=69000,
)  # fmt: skip
LENGTH_M, RING_M, COIL_M, WIRE_M, N_COILS = 15 * MM, 13 * MM, 3.5 * MM, 0.5 * MM, 8.0
INNER_M, OUTER_M, RUBBER_PA = 10.5 * MM, 15.5 * MM, 69e3
LOAD_N, LOAD_NM = 1.0, 20e-3
STEPS = 6  # of the ball's way


@dataclass(frozen=True)
class _Column:
    """Stiffness of a clamped column's end: along it, twist, and the three of its bending."""

    axial: float
    twist: float
    shift: float
    both: float
    turn: float


def _column(axial: float, twist: float, bending: float, shear: float) -> _Column:
    phi = 12 * bending / (shear * LENGTH_M**2)
    part = bending / (1 + phi)
    return _Column(axial, twist, 12 * part / LENGTH_M**3, 6 * part / LENGTH_M**2, (4 + phi) * part / LENGTH_M)


def _spring() -> _Column:
    axial = STEEL_G_PA * WIRE_M**4 / (8 * COIL_M**3 * N_COILS)
    twist = STEEL_E_PA * WIRE_M**4 / (64 * COIL_M * N_COILS)
    per_coil = STEEL_E_PA * STEEL_G_PA * WIRE_M**4 / (16 * COIL_M * (STEEL_E_PA + 2 * STEEL_G_PA))
    shear = STEEL_E_PA * WIRE_M**4 * LENGTH_M / (8 * COIL_M**3 * N_COILS)
    return _column(axial, twist, per_coil * LENGTH_M / N_COILS, shear)


def _sleeve() -> _Column:
    area, inertia = np.pi * (OUTER_M**2 - INNER_M**2), np.pi / 4 * (OUTER_M**4 - INNER_M**4)
    shear = SHEAR_FACTOR * RUBBER_PA / 3 * area
    return _column(RUBBER_PA * area / LENGTH_M, RUBBER_PA / 3 * 2 * inertia / LENGTH_M, RUBBER_PA * inertia, shear)


def _moved(wrench: Array) -> Array:
    """Shift and turn of the tray at the springs' upper ends, (6,), under a wrench there."""
    arm = TRAY.top_um * 1e-6
    about_origin = wrench + np.array([0, 0, 0, -arm * wrench[1], arm * wrench[0], 0])
    tray = Tray(Platform.of(TRAY))
    tray.load(about_origin)
    shift = tray.shift
    return np.asarray(shift + np.array([arm * shift[4], -arm * shift[3], 0, 0, 0, 0]))


def tray(out: Outcome) -> None:
    """Down, sideways, tilted and turned."""
    spring, sleeve, n = _spring(), _sleeve(), TRAY.n_springs
    down = n * spring.axial + sleeve.axial
    about = n * (spring.shift * RING_M**2 + spring.twist) + sleeve.twist
    shift, both = n * spring.shift + sleeve.shift, n * spring.both + sleeve.both
    turn = n * (spring.turn + spring.axial * RING_M**2 / 2) + sleeve.turn
    det = shift * turn - both**2
    unit = np.eye(6)
    name = "Tray on six springs and a sleeve"
    out.rows += [
        Row(name, "down by 1 N", LOAD_N / down / MM, _moved(LOAD_N * unit[2])[2] / MM, "mm", 1e-3),
        Row(name, "sideways by 1 N", LOAD_N * turn / det / MM, _moved(LOAD_N * unit[0])[0] / MM, "mm", 1e-3),
        Row(name, "tilt by 20 N mm", LOAD_NM * shift / det / MM, _moved(LOAD_NM * unit[3])[3] / MM, "mrad", 1e-3),
        Row(name, "turn by 20 N mm", LOAD_NM / about / MM, _moved(LOAD_NM * unit[5])[5] / MM, "mrad", 1e-3),
    ]


def ball_on_gel(pad: Pad, out: Outcome) -> None:
    """Gel and tray give way one after the other: the ball's way is Hertz's depth and the tray's."""
    ball, depth = pad.ball()
    load, _ = pad.layer.hertz(ball.radius_m, depth)
    down = TRAY.n_springs * _spring().axial + _sleeve().axial
    x, y = np.meshgrid(pad.model.node_x(), pad.model.node_y())
    modes = rigid_modes(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])).reshape(-1, 6)
    response = PlatformResponse(LinearResponse(pad.compliance), modes, Platform.of(TRAY))
    solver = ContactSolver(pad.model, response, ball, 0.0, give_m=MAX_SINK_M)
    way = depth + load / down
    for part in np.linspace(1 / STEPS, 1, STEPS):
        solver.advance(Pose(0, 0, part * way))
    name = "Ball on the gel of the tray"
    out.rows += [
        Row(name, "load", load, -float(solver.nodal_force[:, 2].sum()), "N", 0.03),
        Row(name, "the tray's way", load / down / MM, -float(response.tray.shift[2]) / MM, "mm", 0.03),
    ]


def run(out: Outcome) -> None:
    """Both."""
    tray(out)
    ball_on_gel(Pad.of(FLAT, LAYERS_FLAT), out)
