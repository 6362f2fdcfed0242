"""Checks of the skin: a pyramid's law, a panel on an elastic bed, and the shell itself on a published roof.

Pyramid: far from its base a tapered neo-Hookean bar of square sections (b z / h)^2 gives way by c sqrt(q) with
q = F h^2 / (mu b^2) and c = integral of (1 / s^2 - s)^(-1/2) over s from 0 to 1 = B(2/3, 1/2) / 3; what the bar lacks
beyond its base is q / (3 h) - q^2 / (27 h^3) + ... of that.
Panel: w = P / (8 sqrt(k D)) under a point load on an endless plate on springs (H. Hertz, 1884).
Roof of Scordelis and Lo on diaphragms under its weight: 0.3024 at the middle of a free edge (MacNeal and Harder, 1985).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import beta

from ruffini.sim.bodies.pyramid import PyramidLaw
from ruffini.sim.bodies.sheet import Sheet
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.bodies.skin import around
from ruffini.sim.bodies.splines import Line, Patch
from ruffini.sim.validation.rows import Curve, Outcome, Row

MM = 1e-3
BASE_M, HEIGHT_M, RUBBER_PA = 6 * MM, 3 * MM, 70e3  # of a published skin
PANEL_M, PANEL_PA, PANEL_POISSON = 0.31 * MM, 2.5e9, 0.38
BED_PA_M = 2e7
PLATE_M, N_CELLS = 80 * MM, 40  # eighteen times the plate's own length (D / k)^(1/4)
LARGEST_SHORT = 0.15  # of the height, where the series above still holds to 0.1 %
ROOF_DOWN = 0.3024


def pyramid_force(short_m: float) -> float:
    """Of the closed form, N."""
    c = float(beta(2 / 3, 0.5)) / 3

    def lack(q: float) -> float:
        return float(c * q**0.5 - q / (3 * HEIGHT_M) + q**2 / (27 * HEIGHT_M**3) - short_m)

    q = float(brentq(lack, 0, HEIGHT_M**2))
    return q * RUBBER_PA / 3 * (BASE_M / HEIGHT_M) ** 2


def pyramid(out: Outcome) -> None:
    """Force of one pyramid."""
    curve, name = PyramidLaw(BASE_M, HEIGHT_M, RUBBER_PA).curve(), "Rubber pyramid of 6 x 6 x 3 mm"
    for short_m in (0.1 * MM, LARGEST_SHORT * HEIGHT_M):
        out.rows.append(
            Row(name, f"force at {short_m / MM:.2g} mm", pyramid_force(short_m), float(curve(short_m)), "N", 0.005)
        )
    short = np.linspace(0, LARGEST_SHORT * HEIGHT_M, 30)
    theory = np.array([pyramid_force(float(s)) for s in short])
    out.curves.append(Curve(name, "shortening / mm", "force / N", (short / MM, theory),
                            (short[::5] / MM, curve(short[::5]))))  # fmt: skip


def panel(out: Outcome) -> None:
    """A panel on springs under a force at one point."""
    line = Line(np.linspace(-PLATE_M / 2, PLATE_M / 2, N_CELLS + 1))
    patch = Patch.of(line, line)
    a, b = np.meshgrid(line.greville(), line.greville())
    shell = Shell(patch, patch.interpolated(np.stack([a, b, 0 * a], axis=-1)), PANEL_M, PANEL_PA, PANEL_POISSON)
    sheet = Sheet(shell, np.ones_like(shell.rest, dtype=bool))
    tangent = shell.balance(shell.rest)[1]()
    bed = sheet.spread(np.broadcast_to(BED_PA_M * np.eye(3), (sheet.points.shape[0], 3, 3)))
    middle = np.asarray(patch.at_places(np.zeros(1), np.zeros(1)).toarray()[0])
    moved = sheet.solver(tangent + bed)(np.outer(middle, [0, 0, 1.0]).ravel()).reshape(-1, 3)
    bending = PANEL_PA * PANEL_M**3 / (12 * (1 - PANEL_POISSON**2))
    theory = 1 / (8 * (BED_PA_M * bending) ** 0.5)
    out.rows.append(
        Row("Panel on an elastic bed", "way under 1 N", theory / MM, float(middle @ moved[:, 2]) / MM, "mm", 0.02)
    )


def roof(out: Outcome) -> None:
    """A curved shell under its weight; numbers without units, as published."""
    angle, length = np.deg2rad(40), 50.0
    line_a, line_b = Line(np.linspace(-angle, angle, 13)), Line(np.linspace(-length / 2, length / 2, 13))
    patch = Patch.of(line_a, line_b)
    rest = patch.interpolated(around(*np.meshgrid(line_a.greville(), line_b.greville()), 25.0))
    shell = Shell(patch, rest, 0.25, 4.32e8, 0.0)
    is_free = np.ones_like(rest, dtype=bool)
    ends = np.isclose(np.abs(rest[:, 2]), length / 2)
    is_free[ends, :2] = False
    is_free[np.flatnonzero(ends)[0], 2] = False
    sheet = Sheet(shell, is_free)
    tangent = shell.balance(rest)[1]()
    weight = sheet.points.T @ np.outer(sheet.touch_areas.ravel(), [-90.0, 0, 0])
    moved = np.zeros_like(rest)
    moved[is_free] = sheet.solver(tangent)(weight[is_free])
    edge = patch.at_places(np.array([angle]), np.zeros(1)) @ moved
    out.rows.append(Row("Roof of Scordelis and Lo", "edge goes down", ROOF_DOWN, -float(edge[0, 0]), "", 0.01))


def run(out: Outcome) -> None:
    """All of them."""
    pyramid(out)
    panel(out)
    roof(out)
