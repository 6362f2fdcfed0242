"""`ruffini cal check`: does a unit still meet its calibration report? A weight checks forces, a ball checks depth."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from ruffini import host_clock
from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import MAX_ERROR, MAX_REST_N
from ruffini.errors import InputError
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import board_slab
from ruffini.estimators.table import ESTIMATORS
from ruffini.rig.bench import Bench
from ruffini.rig.program import Weight
from ruffini.rig.units import GRAVITY_M_S2

Array = npt.NDArray[np.float64]

SETTLED_PART = 0.5  # of a hold, its end
MAX_RADIUS_ERROR = 0.15  # relative, with nodes 0.67 mm apart; the radius is inversely proportional to the depth
DEEP_PART = 0.6  # of the largest depth: a ball's contact ends at half of it (Hertz)
LEAST_NODES = 6  # under the ball
LEAST_DENT_M = 1e-4
BALL_GRAMS = 100.0
FIELDS = 3  # the last of a hold


class Checked(NamedTuple):
    """Expected value, measured value and tolerance, all in `unit`."""

    what: str
    wanted: float
    said: float
    allowed: float
    unit: str

    @property
    def ok(self) -> bool:
        """True if the unit still meets its report."""
        return abs(self.said - self.wanted) <= self.allowed


def allowed_n(file: CalibrationFile | None, force_n: float) -> float:
    """Tolerance of a force, N: from the report of the calibration in force, otherwise from the gates."""
    floor = MAX_ERROR * force_n + MAX_REST_N
    if file is None:
        return floor
    try:
        stages: Any = json.loads(file.metadata.get("residuals", "{}"))["stages"]
        stated = [estimator.allowed_n(stages.get(estimator.name, {}), force_n) for estimator in ESTIMATORS]
    except (ValueError, KeyError, TypeError, AttributeError):
        return floor
    return max((value for value in stated if value is not None), default=floor)


def check_weight(bench: Bench, grams: float, file: CalibrationFile | None) -> Checked:
    """Check the normal force with a weight that a person places on the level pad."""
    bench.person.confirm(f"put {Weight(0.0, 0.0, grams).told()}")
    if bench.weight is not None:
        bench.weight.place(grams)
    begun = host_clock.now()
    ended = bench.hold(begun)
    frames = bench.stream.since(begun + (1 - SETTLED_PART) * (ended - begun)).frames
    if bench.weight is not None:
        bench.weight.place(0.0)
    bench.person.confirm("take it away")
    said = np.array([f.wrench[:3] for f in frames])
    if not np.isfinite(said[:, 2]).all():
        raise InputError("the sensor does not measure the normal force: flash a calibration first")
    wanted = 1e-3 * grams * GRAVITY_M_S2
    return Checked(f"a weight of {grams:g} g", wanted, float(-said[:, 2].mean()), allowed_n(file, wanted), "N")


def check_ball(bench: Bench, board: Board, ball_mm: float) -> Checked:
    """Check the depth with a ball that a person loads with a weight or presses by hand."""
    put = Weight(0.0, 0.0, BALL_GRAMS).told()
    bench.person.confirm(f"put {put}, onto the {ball_mm:g} mm ball (or press it as hard and hold still)")
    begun = host_clock.now()
    bench.hold(begun)
    fields = bench.stream.since(begun).fields[-FIELDS:]
    bench.person.confirm("take it away")
    if not fields:
        raise InputError("the sensor sends no displacement: it cannot be checked with a ball")
    radius_m = ball_radius_m(board, np.mean([f.displacement for f in fields], axis=0), ball_mm / 2e3)
    allowed_mm = MAX_RADIUS_ERROR * ball_mm
    return Checked(f"the diameter of a {ball_mm:g} mm ball", ball_mm, 2e3 * radius_m, allowed_mm, "mm")


def ball_radius_m(board: Board, displacement: Array, start_m: float) -> float:
    """Radius of the ball whose cap the nodes under it lie on; displacement (n_y, n_x, 3) m at the observed nodes.

    Raises
    ------
    InputError
        Too shallow, or too few nodes under it.
    """
    places = node_places(board_slab(board), board.observed)
    x, y = np.meshgrid(places.x_m, places.y_m)
    u = np.asarray(displacement, dtype=np.float64)
    deepest = float(u[..., 2].min())
    under = u[..., 2] < DEEP_PART * deepest
    if deepest > -LEAST_DENT_M or under.sum() < LEAST_NODES:
        raise InputError(
            f"the dent is {-1e3 * deepest:.2f} mm deep and {under.sum()} nodes lie under the ball: press deeper, "
            "or take a larger ball"
        )
    x, y, z = (x + u[..., 0])[under], (y + u[..., 1])[under], u[..., 2][under]

    def residual(p: Array) -> Array:
        radius, center_x, center_y, bottom = p
        sag = (x - center_x) ** 2 + (y - center_y) ** 2
        return np.asarray(bottom + radius - np.sqrt(np.maximum(radius**2 - sag, 0.0)) - z)

    start = [start_m, float(x.mean()), float(y.mean()), deepest]
    return float(least_squares(residual, start, x_scale=[1e-3, 1e-4, 1e-4, 1e-5]).x[0])
