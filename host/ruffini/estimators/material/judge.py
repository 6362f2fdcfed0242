"""Whether a pad's numbers are good enough: errors of touches left out of the fit, and gates."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.gates import MAX_ERROR, Gate, near, part
from ruffini.estimators.material.fit import MIN_TOUCHES, MaterialFit
from ruffini.estimators.operator.fit import Material, board_slab

Array = npt.NDArray[np.float64]

MAX_GAIN_ERROR = 0.03
MAX_INTERVAL = 0.10  # of E, 95 %, half width
MAX_MODULUS = 2.0  # times the board's: batches of a gel differ by less, units of force by more
UNITS = {"lbf": 4.448, "kgf": 9.807, "mN": 1e-3}  # newtons
SAME_UNIT = 0.25  # a modulus that a wrong unit explains so well


def left_out_figures(fit: MaterialFit) -> dict[str, float]:
    """Error of the force of each touch by a fit to the others."""
    return touch_figures(fit, fit.left_out)


def touch_figures(fit: MaterialFit, wrench: Array) -> dict[str, float]:
    """Error of a fit's wrenches (t, 6), force, N: over touches, each the mean of its frames."""
    seen = np.isfinite(fit.reference[:, :3]).all(axis=0)
    touches = [fit.touch == t for t in np.unique(fit.touch)]
    error = np.array([(wrench - fit.reference)[used][:, :3][:, seen].mean(axis=0) for used in touches])
    size = np.array([fit.reference[used][:, :3][:, seen].mean(axis=0) for used in touches])
    length, largest = np.linalg.norm(error, axis=1), float(np.linalg.norm(size, axis=1).max())
    return {
        "force_rmse_n": float(np.sqrt(np.mean(length**2))), "force_p95_n": float(np.percentile(length, 95)),
        "largest_force_n": largest,
        "gain": float((size * (size + error)).sum() / (size**2).sum()),
    }  # fmt: skip


def report_of_fit(fit: MaterialFit) -> dict[str, Any]:
    """Its numbers and its errors on touches left out, as `gates_of_material` judges them."""
    return {**fit.report(), "left_out": left_out_figures(fit)}


def gates_of_material(report: dict[str, Any], board: Board) -> list[Gate]:
    """How well the numbers of a fit are known, its errors on touches left out, its E."""
    material = Material(*(report[name] for name in Material._fields))
    return _of_material(report) + gates_of_modulus(material, board)


def _of_material(report: dict[str, Any]) -> list[Gate]:
    interval = report["interval_95"]["modulus_pa"] / report["modulus_pa"]
    gates = [part("interval of E", interval, MAX_INTERVAL, "of E, 95 %")]
    if report["touches"] < MIN_TOUCHES:
        return gates  # nothing to leave out: the prior's word counts
    figures = report["left_out"]
    off = figures["force_p95_n"] / figures["largest_force_n"]
    return [
        *gates,
        part("error", off, MAX_ERROR, "of the largest force: 95th percentile of touches left out"),
        part("gain", abs(figures["gain"] - 1), MAX_GAIN_ERROR, "off in the size of forces left out"),
    ]


def gates_of_modulus(material: Material, board: Board) -> list[Gate]:
    """The pad's E against the board's: a reference in another unit, or another pad."""
    modulus_pa = board_slab(board).modulus_pa
    ratio = material.modulus_pa / modulus_pa
    unit = next((name for name, n in UNITS.items() if abs(ratio * n - 1) < SAME_UNIT), "")
    hint = f"; is the reference in {unit}?" if unit else "; is its unit N, and is it this board's pad?"
    gate = near("modulus", ratio, MAX_MODULUS, f"of the board's {modulus_pa / 1e3:.0f} kPa")
    return [gate if gate.ok else gate._replace(text=gate.text + hint)]
