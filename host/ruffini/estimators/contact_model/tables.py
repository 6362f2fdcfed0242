"""A contact model judged on what was left out, and as the firmware's integers: kinds `contact_model` and `wrench`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import Tensors
from ruffini.errors import InputError
from ruffini.estimators.contact_model.depth import JudgedMap, depth_tables, fit_contact_depth
from ruffini.estimators.contact_model.fit import (
    INPUT_STEP,
    Log,
    Model,
    Told,
    errors,
    fit_fails,
    fit_model,
    seen_of,
    tell,
)
from ruffini.estimators.contact_model.log import LEAST_SHORE, PX, Press
from ruffini.estimators.contact_model.perceptron import Perceptron, run_tables, tanh_table
from ruffini.estimators.contact_model.wrench import RIDGE_PX2, moment_per_flow
from ruffini.estimators.wrench.fit import Fit
from ruffini.estimators.wrench.log import Features
from ruffini.estimators.wrench.model import AXES, PAIRS, TIMES_S, WrenchMap, ranges_of
from ruffini.estimators.wrench.tables import tables as wrench_tables

Array = npt.NDArray[np.float64]
Progress = Any

QUANTITIES = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")  # of a board's not_measured
MOST_FOLDS = 7  # of sizes
MAP_FOLDS = 3  # of those, for the depth map: each takes as long as all the others
LOW, HIGH = 20.0, 80.0  # of Shore A, where hardness is judged
N_BANDS, BAND = 10, 10.0
LEAST_SIGMA = 1.0  # Shore A
STRANGE_ROOM = 1.5  # times the strangest press that was left out
FAILING_RANGE = 0.3, 0.9  # of the limit of `fails`, which is 0 of ordinary presses and 1 of others
FAILS_FOLDS, REFUSED_WRONGLY = 4, 0.01
WEIGHT_DECAY = 0.05  # of the kind's log odds, each sign over its spread
TOUCH_FALL, TOUCH_N = 0.004, 0.09  # least fall of the density (four times its noise at rest), the paper's touch (IV-A)
LEAST_ERROR = 5e-3  # of a load: no reference is better
LEAST_FULL = 1e-9  # N, N mm: of an axis that nothing ever loads
LIGHT = 0.15  # of the largest load: below, errors do not grow with it
SHIFT_WHITE, Z_ONE = 20, 8
SIZE_STEP = np.array([2.0**-12, 2.0**-12, 1e-3, 1e-3])
SHORE_STEP, KIND_STEP = np.array([1 / 16]), np.array([2.0**-12])


@dataclass(frozen=True)
class LeftOut:
    """Every press as a model tells it that was fitted without its size, or without its shape."""

    presses: list[Press]
    told: list[Told]
    wrench: list[Array]
    sizes: list[Array]

    def report(self, weights: Array) -> dict[str, Any]:
        """RMSE by shape and on the whole, kind by these weights of its signs; N, N m, mm and Shore A."""
        rows: dict[str, Any] = {}
        is_flat = [bool(weights[0] + t.signs @ weights[1:] > 0) for t in self.told]
        for shape in [*dict.fromkeys(p.shape for p in self.presses), "all"]:
            at = [i for i, p in enumerate(self.presses) if shape in (p.shape, "all")]
            wrench, sizes = (np.concatenate([part[i] for i in at]) for part in (self.wrench, self.sizes))
            down = [i for i in at if self.presses[i].goes_down and self.told[i].is_told]
            rows[shape] = {
                "normal_n": _rms(wrench[:, 2]), "tangential_n": _rms(np.hypot(wrench[:, 0], wrench[:, 1])),
                "moment_nm": 1e-3 * _rms(wrench[:, 5]), "gel_depth_mm": _rms(sizes[:, 0]),
                "press_depth_mm": _rms(sizes[:, 1]),
                "shore_a": _rms(np.array([self.told[i].shore[0 if is_flat[i] else 1] - self.presses[i].shore_a
                                          for i in down if LOW <= self.presses[i].shore_a <= HIGH])),
                "kind_right": float(np.mean([is_flat[i] != self.presses[i].is_hertzian for i in down])),
            }  # fmt: skip
        return rows


@dataclass(frozen=True)
class ContactFit:
    """A model of all presses, and what it errs by on sizes and on shapes that were not fitted."""

    model: Model
    by_size: LeftOut
    by_shape: LeftOut
    weights: Array  # of the kind's signs
    most_failing: float  # of `fails` over a press: above, no model holds
    depth_map: JudgedMap | None  # where the log knows the gel's surface
    refused: dict[str, dict[str, float]]  # part of the presses for which none holds, of sizes or shapes not in the fit

    @property
    def most_strange(self) -> float:
        """Of a press that is not refused: room above what was left out."""
        return STRANGE_ROOM * float(np.nanmax([t.strange for t in self.by_size.told]))

    def report(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "left_out_sizes": self.by_size.report(self.weights),
            "left_out_shapes": self.by_shape.report(self.weights),
            "reference_crosstalk": {"x": self.model.wrench.crosstalk[0], "y": self.model.wrench.crosstalk[1]},
            "refused": self.refused,
            "depth_map": self.depth_map.report() if self.depth_map else None,
            "most_failing": self.most_failing, "n_presses": len(self.by_size.presses), **self._normal_errors(),
        }  # fmt: skip

    def _normal_errors(self) -> dict[str, float]:
        """RMS errors of the normal force on sizes or on shapes left out, whichever errs more, as a skin reports them.

        N of light frames, whose error does not grow with the load; of the others per cent of the load.
        """
        rows = []
        for left in (self.by_size, self.by_shape):
            off = np.concatenate(left.wrench)[:, 2]
            load = np.abs(np.concatenate([p.force[p.is_good, 2] for p in left.presses]))
            is_light = load < LIGHT * load.max()
            rows.append((_rms(off[is_light]), 100 * _rms(off[~is_light] / load[~is_light])))
        light_n, percent = np.nanmax(rows, axis=0)
        return {"light_force_rms_n": float(light_n), "force_rms_percent": float(percent)}


def fit_contact(board: Board, presses: list[Press], progress: Progress) -> ContactFit:
    """Fit and judge."""
    log = Log.of(board, presses)
    sizes = sorted({p.radius_mm for p in [*log.presses, *log.failing]})
    parts = [(part[0], part[-1]) for part in np.array_split(sizes, min(MOST_FOLDS, len(sizes)))]
    shapes = list(dict.fromkeys(p.shape for p in log.presses if not p.is_hertzian))
    n = len(parts) + len(shapes) + 3
    model = fit_model(board, log)
    progress(1 / n)
    by_size = _left_out(board, log, [partial(_is_of_size, *part) for part in parts],
                        lambda done: progress((1 + done) / n))  # fmt: skip
    by_shape = _left_out(board, log, [partial(_is_of_shape, shape) for shape in shapes],
                         lambda done: progress((1 + len(parts) + done) / n))  # fmt: skip
    limit, refused = _judge_fails(log, model, sizes)
    folds = [partial(_is_of_size, *part) for part in parts[:: max(1, len(parts) // MAP_FOLDS)]]
    depth_map = fit_contact_depth(board, log.presses, folds, lambda done: progress((n - 1 + done) / n))
    return ContactFit(model, by_size, by_shape, kind_weights(by_size), limit, depth_map, refused)


def _is_of_size(least_mm: float, most_mm: float, press: Press) -> bool:
    return least_mm <= press.radius_mm <= most_mm


def _is_of_shape(shape: str, press: Press) -> bool:
    return press.shape == shape and press.has_model


def _left_out(board: Board, log: Log, folds: list[Callable[[Press], bool]], progress: Progress) -> LeftOut:
    out = LeftOut([], [], [], [])
    for done, is_left in enumerate(folds, 1):
        model = fit_model(board, log.without(is_left), n_seeds=1)
        for press in filter(is_left, log.presses):
            wrench, sizes = errors(press, model)
            out.presses.append(press)
            out.told.append(tell(press, model))
            out.wrench.append(wrench)
            out.sizes.append(sizes)
        progress(done)
    return out


def _judge_fails(log: Log, model: Model, sizes: list[float]) -> tuple[float, dict[str, dict[str, float]]]:
    """Limit of `fails` that one ordinary press of a hundred passes, of sizes not in the fit; and who is refused."""
    ordinary: list[float] = []
    failing: dict[str, list[float]] = {}
    for part in (frozenset(sizes[k::FAILS_FOLDS]) for k in range(FAILS_FOLDS)):
        is_left = partial(_is_among, part)
        left = replace(model, fails=fit_fails(log.without(is_left), n_seeds=1))
        ordinary += [tell(p, left).fails for p in log.presses if is_left(p)]
        for p in filter(is_left, log.failing):
            failing.setdefault(_failing_name(p), []).append(tell(p, left).fails)
    limit = float(np.clip(np.nanquantile(ordinary, 1 - REFUSED_WRONGLY), *FAILING_RANGE))
    out = {name: {"sizes": float(np.mean(np.array(values) > limit))} for name, values in failing.items()}
    for name in dict.fromkeys(_failing_name(p) for p in log.failing):
        rest = log.without(partial(_fails_as, name))
        if rest.failing:
            left = replace(model, fails=fit_fails(rest, n_seeds=1))
            told = [tell(p, left).fails for p in log.failing if _failing_name(p) == name]
            out.setdefault(name, {})["shapes"] = float(np.mean(np.array(told) > limit))
    return limit, out


def _is_among(sizes_mm: frozenset[float], press: Press) -> bool:
    return press.radius_mm in sizes_mm


def _fails_as(name: str, press: Press) -> bool:
    return not press.has_model and _failing_name(press) == name


def _failing_name(press: Press) -> str:
    return "too soft" if press.shore_a < LEAST_SHORE else press.shape


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def tables(board: Board, fit: ContactFit, features: Features) -> tuple[Tensors, dict[str, str]]:
    """Tensors and metadata of both kinds; the report says by how much the tables differ from the fit."""
    model, left = fit.model, fit.by_size
    nets = {"size": (model.size, SIZE_STEP), "kind": (model.kind, KIND_STEP),
            "fails": (model.fails, KIND_STEP),
            "planar": (model.hardness[0], SHORE_STEP), "hertzian": (model.hardness[1], SHORE_STEP)}  # fmt: skip
    tensors: Tensors = {"contact_model.tanh": tanh_table()}
    for name, (net, step) in nets.items():
        tensors |= net.tables(f"contact_model.{name}", INPUT_STEP, step)
    tensors["contact_model.mean"] = np.round(model.mean * 2**14).astype(np.int16)
    tensors["contact_model.whitening"] = np.round(model.whitening * 2.0 ** (SHIFT_WHITE + Z_ONE - 14)).astype(np.int32)
    tensors["contact_model.odds"] = np.round(fit.weights * 2**12).astype(np.int32)
    tensors["contact_model.sigma"] = np.round(_sigma(left) * 16).astype(np.int32)
    found, said = wrench_tables(_wrench_fit(board, fit), features)
    del found["wrench.forward"], found["wrench.tolerance"]
    depth = np.concatenate([s[:, 0] for s in left.sizes])
    mapped: tuple[Tensors, dict[str, str]] = ({}, {})
    if fit.depth_map is not None:
        mapped = depth_tables(board, fit.depth_map, left.presses)
    report = fit.report() | {"wrench": json.loads(said["residuals"]), "tables_err": _table_errors(tensors, nets, fit)}
    return tensors | found | mapped[0], {
        **said, **mapped[1], "residuals": json.dumps(report),
        "contact_model.most_strange_q8": str(round(fit.most_strange * 256)),
        "contact_model.most_failing_q12": str(round(fit.most_failing * 2**12)),
        "contact_model.least_fall_q16": str(round(TOUCH_FALL * 65536)),
        "contact_model.least_force_un": str(round(TOUCH_N * 1e6)),
        "contact_model.moment_per_flow": str(max(1, round(1e6 * moment_per_flow(board, left.presses, model.wrench)))),
        "contact_model.depth_sigma_um": str(max(1, round(_rms(depth) * 1e3))),
    }  # fmt: skip


def kind_weights(left: LeftOut) -> Array:
    """Log odds of planar contact (4,): offset and weights of the signs, by logistic regression on what was left out."""
    from scipy.optimize import minimize

    told = [
        (t.signs, -1.0 if p.is_hertzian else 1.0)
        for p, t in zip(left.presses, left.told, strict=True)
        if t.is_told and p.goes_down
    ]
    if {s for _, s in told} != {-1.0, 1.0}:
        raise InputError("the log has no planar press, or none of a ball, that goes straight down from 0.4 to 1.8 mm: "
                         "kind and hardness need both")  # fmt: skip
    signs, side = np.array([t for t, _ in told]), np.array([s for _, s in told])
    mean, spread = signs.mean(axis=0), signs.std(axis=0) + 1e-9
    z = np.column_stack([np.ones(len(side)), (signs - mean) / spread])
    found = minimize(
        lambda w: np.logaddexp(0, -side * (z @ w)).sum() + WEIGHT_DECAY * (w[1:] ** 2).sum(), np.zeros(4)
    ).x
    return np.concatenate([[found[0] - (found[1:] / spread) @ mean], found[1:] / spread])


def _sigma(left: LeftOut) -> Array:
    """Standard deviation of Shore A, (2, bands): errors of the presses left out about each band."""
    out = np.zeros((2, N_BANDS))
    for kind in (0, 1):
        rows = [(t.shore[kind], t.shore[kind] - p.shore_a) for p, t in zip(left.presses, left.told, strict=True)
                if p.is_hertzian == bool(kind) and t.is_told and p.goes_down]  # fmt: skip
        said, error = np.array(rows).T
        for band in range(N_BANDS):
            near = np.argsort(np.abs(said - (band + 0.5) * BAND))[: max(8, len(said) // 4)]
            out[kind, band] = max(LEAST_SIGMA, _rms(error[near]))
    return out


def _table_errors(tensors: Tensors, nets: dict[str, tuple[Perceptron, Array]], fit: ContactFit) -> dict[str, float]:
    """Largest difference of the tables from the fit on the log, in steps of each output."""
    seen = [seen_of(p, -fit.model.wrench(p.flow)[:, 2]) for p in fit.by_size.presses]
    x = np.concatenate([s.x for s in seen])
    raw = np.round(x / INPUT_STEP).astype(np.int64)
    out = {}
    for name, (net, step) in nets.items():
        off = run_tables(tensors, f"contact_model.{name}", raw) - net(raw * INPUT_STEP) / step
        out[name] = float(np.abs(off).max())
    return out


def _wrench_fit(board: Board, fit: ContactFit) -> Fit:
    """K with its covariance; axes that the board does not measure, or the log's reference, are not told."""
    left = fit.by_size
    error = np.concatenate(left.wrench)
    presses = left.presses
    wrench = _wrenches(fit.model, presses)
    full = np.maximum(ranges_of(np.abs(wrench).max(axis=0)), LEAST_FULL)
    spread = np.maximum(wrench.std(axis=0), 1e-12)
    rows = np.stack([_vectors(part) for part in _covariances(fit, full)])
    gain = fit.model.wrench.gain / PX
    n = gain.shape[1]
    told = np.array([name not in board.board.not_measured for name in QUANTITIES])
    told &= np.any([p.force.any(axis=0) for p in presses], axis=0)
    condition = float(np.linalg.cond((gain / full[:, None])[told]))
    rows *= told
    found = WrenchMap(gain, full * told, np.zeros((6, len(PAIRS[0]))), np.zeros((len(TIMES_S), 6)), np.zeros((n, 27)),
                      np.ones(n), rows)  # fmt: skip
    rmse = np.sqrt((error**2).mean(axis=0))
    return Fit(found, 0.0, dict.fromkeys(AXES, RIDGE_PX2), {}, rmse, 1 - (rmse / spread) ** 2, rmse, condition,
               len(error), len(presses), "size")  # fmt: skip


def _wrenches(model: Model, presses: list[Press]) -> Array:
    return np.concatenate([model.wrench(p.flow[p.is_good]) for p in presses])


def _covariances(fit: ContactFit, full: Array) -> tuple[Array, Array]:
    """Of a touch of no load, and what the square of the load over the board's largest adds.

    The first is of light frames of sizes that were left out; the second of the others, of sizes or of shapes left out,
    whichever errs more: what an object's shape is, the board does not know.
    """
    light, heavy = [], []
    for left in (fit.by_size, fit.by_shape):
        error = np.concatenate(left.wrench)
        size = np.sqrt(((_wrenches(fit.model, left.presses) / full) ** 2).sum(axis=1))
        is_light = size < LIGHT
        light.append(_second_moment(error[is_light]))
        heavy.append(_second_moment(error[~is_light] / size[~is_light, None]))
    least = np.diag((LEAST_ERROR * full) ** 2)
    return light[0], max(heavy, key=lambda c: float(c[2, 2])) + least


def _second_moment(error: Array) -> Array:
    return np.asarray(error.T @ error / max(len(error), 1))


def _vectors(covariance: Array) -> Array:
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray((axes * np.sqrt(values.clip(0))).T)
