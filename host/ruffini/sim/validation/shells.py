"""Checks of the rubber dome at small displacement: a force at its top, and pressure inside.

E. Reissner (1946), shallow sphere under a force at one point: k = 8 E t^2 / (R sqrt(12 (1 - nu^2))), for t << R.
Membrane under pressure: the radius grows by w = p R^2 (1 - nu) / (2 E t). The clamped rim bends within a few sqrt(R t),
which lifts all the rest as one: so the growth is read sideways, a little beside the top.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.sim.bodies.dome import DomeModel
from ruffini.sim.bodies.sheet import Sheet
from ruffini.sim.validation.rows import Outcome, Row

Array = npt.NDArray[np.float64]

MM = 1e-3
RADIUS_M, MODULUS_PA, POISSON = 22 * MM, 5.5e6, 0.49  # of the stereo fingertip
WALLS_M = (0.5 * MM, 0.25 * MM)  # thin ones: at 1 mm Reissner's own error is 5 %
N_CELLS = 28
PRESSURE_PA = 100.0
BESIDE_RAD = 0.35  # from the top


def _moved(sheet: Sheet, force: Array) -> Array:
    """Displacement of the control points (n, 3) under small forces on them, linear about rest."""
    tangent = sheet.shell.balance(sheet.shell.rest)[1]()
    out = np.zeros(sheet.is_free.shape)
    out[sheet.is_free] = sheet.solver(tangent)(force[sheet.is_free])
    return out


def _at(sheet: Sheet, way_m: float) -> Array:
    """Weights of the control points in the place so far from the top along x, (n,)."""
    return np.asarray(sheet.shell.patch.at_places(np.array([way_m]), np.zeros(1)).toarray()[0])


def point_force(sheet: Sheet, wall_m: float, out: Outcome) -> None:
    """Stiffness of the top under a force there."""
    theory = 8 * MODULUS_PA * wall_m**2 / (RADIUS_M * (12 * (1 - POISSON**2)) ** 0.5)
    top = _at(sheet, 0.0)
    sunk = float(top @ _moved(sheet, np.outer(top, [0.0, 0.0, 1.0]))[:, 2])
    name = f"Dome, force at its top, R/t = {RADIUS_M / wall_m:.0f}"
    out.rows.append(Row(name, "stiffness (Reissner)", theory / 1e3, 1 / sunk / 1e3, "N/mm", 0.05))


def pressure(sheet: Sheet, wall_m: float, out: Outcome) -> None:
    """Growth of the radius under pressure inside."""
    theory = PRESSURE_PA * RADIUS_M**2 * (1 - POISSON) / (2 * MODULUS_PA * wall_m)
    load = PRESSURE_PA * (sheet.touch_areas[..., None] * sheet.normals).reshape(-1, 3)
    outward = load * np.sign(load[:, 2].sum())  # up at the top
    aside = float(_at(sheet, BESIDE_RAD * RADIUS_M) @ _moved(sheet, np.asarray(sheet.points.T @ outward))[:, 0])
    name = f"Dome under pressure, R/t = {RADIUS_M / wall_m:.0f}"
    grown = aside / float(np.sin(BESIDE_RAD))
    out.rows.append(Row(name, "growth of the radius", theory / MM, grown / MM, "mm", 0.01))


def run(out: Outcome) -> None:
    """Both, on two walls."""
    sheets = [DomeModel(RADIUS_M, wall, MODULUS_PA, POISSON, N_CELLS).sheet() for wall in WALLS_M]
    for check in (point_force, pressure):
        for sheet, wall_m in zip(sheets, WALLS_M, strict=True):
            check(sheet, wall_m, out)
