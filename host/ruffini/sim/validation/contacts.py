"""Checks of contact at small strain: Hertz, Cattaneo and Mindlin, a thin layer, balance.

The ball is small against the pad, the pad's bed is in the theory (`validation.layer`), its free sides are not: they
are 6 to 7 contact radii away. Radii are the second moments of what presses, not counts of nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.surface import hat_areas
from ruffini.sim.validation.layer import BondedLayer
from ruffini.sim.validation.rows import Curve, Outcome, Row

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

MM = 1e-3
SIDE_M, MODULUS_PA, POISSON = 20 * MM, 2e5, 0.45
CELLS = 20
THICK, LAYERS_THICK = 0.35, (0.08, 0.16, 0.28, 0.48)  # of the side; for Hertz
FLAT, LAYERS_FLAT = 0.25, (0.1, 0.2, 0.3, 0.4)  # for shear, which free sides disturb more
CONTACT_NODES = 3.0  # contact radius over the distance of nodes
SLENDERNESS = 10.0  # ball radius over contact radius
FRICTION = 0.3


@dataclass(frozen=True)
class Pad:
    """A square pad on a rigid bed and its compliance."""

    model: PadModel
    compliance: Array

    @classmethod
    @lru_cache(maxsize=2)  # seconds to make
    def of(cls, thickness: float, layers: tuple[float, ...]) -> Pad:
        """`thickness` of the side."""
        model = PadModel(SIDE_M, SIDE_M, thickness * SIDE_M, MODULUS_PA, POISSON, CELLS, CELLS, layers=layers)
        return cls(model, surface_compliance(model))

    @property
    def layer(self) -> BondedLayer:
        return BondedLayer(self.model.thickness_m, MODULUS_PA, POISSON)

    @property
    def step_m(self) -> float:
        return SIDE_M / (self.model.shape[0] - 1)

    def radius_of(self, press: Array) -> float:
        """Radius of a Hertzian pressure with the second moment of forces (n,) spread as hats: <r^2> = 2/5 a^2."""
        x, y = np.meshgrid(self.model.node_x(), self.model.node_y())
        squares = (x**2 + y**2).ravel() + self.step_m**2 / 3  # a hat's own second moment
        return float(np.sqrt(2.5 * (press @ squares) / press.sum()))

    def ball(self) -> tuple[Indenter, float]:
        """A ball and the depth at which theory has CONTACT_NODES in the contact's radius."""
        a = CONTACT_NODES * self.step_m
        radius = SLENDERNESS * a
        depth = brentq(lambda d: self.layer.hertz(radius, d)[1] - a, 0.3 * a**2 / radius, 1.5 * a**2 / radius)
        return Indenter("sphere", radius), float(depth)


def hertz(pad: Pad, out: Outcome) -> None:
    """A ball without friction: load and radius at a depth, depth at that load."""
    ball, depth = pad.ball()
    solver, measured = ContactSolver(pad.model, pad.compliance, ball, 0.0), []
    for part in np.linspace(0.25, 1, 7):
        solver.advance(Pose(0, 0, part * depth))
        measured.append((part * depth, -solver.nodal_force[:, 2].sum()))
    load, a = pad.layer.hertz(ball.radius_m, depth)
    twin_n = measured[-1][1]
    at_load = brentq(lambda d: pad.layer.hertz(ball.radius_m, d)[0] - twin_n, 0.5 * depth, 2 * depth)
    name = "Hertz on a bonded layer"
    out.rows += [
        Row(name, "load at a depth", load, twin_n, "N", 0.03),
        Row(name, "depth at a load", at_load / MM, depth / MM, "mm", 0.03),
        Row(name, "contact radius", a / MM, pad.radius_of(-solver.hat_force[:, 2]) / MM, "mm", 0.03),
    ]
    depths = np.linspace(0.1, 1, 30) * depth
    loads = np.array([pad.layer.hertz(ball.radius_m, float(d))[0] for d in depths])
    points = np.array(measured).T
    out.curves.append(Curve(name, "depth / mm", "load / N", (depths / MM, loads), (points[0] / MM, points[1])))


def mindlin(pad: Pad, out: Outcome) -> None:
    """The ball pressed, then moved sideways: way over force, and the stick circle."""
    ball, depth = pad.ball()
    solver = ContactSolver(pad.model, pad.compliance, ball, FRICTION)
    solver.advance(Pose(0, 0, depth))
    start_n = -solver.nodal_force[:, 2].sum()
    a = pad.radius_of(-solver.hat_force[:, 2])
    end = pad.layer.mindlin_shift(start_n, a, FRICTION, 0.75 * FRICTION * start_n)
    name, measured = "Cattaneo-Mindlin partial slip", []
    for part in np.linspace(0.125, 1, 8):
        solver.advance(Pose(part * end, 0, depth))
        fx, _, fz = solver.nodal_force.sum(axis=0)
        measured.append((part * end, fx))
        if part not in (0.5, 1.0):
            continue
        slips = float(fx / (-FRICTION * fz))
        theory = pad.layer.mindlin_shift(-fz, a, FRICTION, fx)
        held_back = -FRICTION * solver.hat_force[:, 2] - solver.hat_force[:, 0]
        stick = pad.radius_of(held_back)
        out.rows += [
            Row(name, f"way at {slips:.2f} of sliding", theory / MM, part * end / MM, "mm", 0.05),
            Row(name, "stick radius there", a * (1 - slips) ** (1 / 3) / MM, stick / MM, "mm", 0.05),
        ]
    forces = np.linspace(0, 0.8, 40) * FRICTION * start_n
    ways = np.array([pad.layer.mindlin_shift(start_n, a, FRICTION, float(q)) for q in forces])
    points = np.array(measured).T
    out.curves.append(Curve(name, "way / mm", "shear / N", (ways / MM, forces), (points[0] / MM, points[1])))


def thin_layer(out: Outcome) -> None:
    """A layer far thinner than the contact is a bed of springs of its confined modulus: P = pi M R d^2 / h."""
    a, thickness, poisson = 6 * MM, 0.4 * MM, 0.3
    depth = 0.05 * thickness
    model = PadModel(SIDE_M, SIDE_M, thickness, MODULUS_PA, poisson, 16, 16, layers=(0.5, 0.5))
    ball = Indenter("sphere", a**2 / (2 * depth))
    solver = ContactSolver(model, surface_compliance(model), ball, 0.0)
    solver.advance(Pose(0, 0, depth))
    confined = BondedLayer(thickness, MODULUS_PA, poisson).confined_pa
    middle = solver.hat_force.shape[0] // 2
    pressure = -solver.hat_force[middle, 2] / hat_areas(model)[middle]
    name = "Layer 1/15 as thick as the contact"
    load = np.pi * confined * ball.radius_m * depth**2 / thickness
    out.rows += [
        Row(name, "load", load, -solver.nodal_force[:, 2].sum(), "N", 0.03),
        Row(name, "pressure in the middle", confined * depth / thickness / 1e3, pressure / 1e3, "kPa", 0.03),
    ]


def run(out: Outcome, *, quick: bool, progress: Progress = lambda _: None) -> None:
    """All of them; quick ones share the flatter pad."""
    flat = Pad.of(FLAT, LAYERS_FLAT)
    progress(0.4)
    hertz(flat if quick else Pad.of(THICK, LAYERS_THICK), out)
    progress(0.8)
    mindlin(flat, out)
    thin_layer(out)
    progress(1.0)
