"""A wrench map as the firmware's integers, kind `wrench` of proto/CALIBRATION.md."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.container import CalibrationFile, Tensors
from ruffini.errors import InputError
from ruffini.estimators.wrench import kernel as wrench_kernel
from ruffini.estimators.wrench import rest as wrench_rest
from ruffini.estimators.wrench.fit import Fit
from ruffini.estimators.wrench.log import Features
from ruffini.estimators.wrench.model import AXES, TIMES_S, WrenchMap
from ruffini.estimators.wrench.warmth import WrenchWarmth

FINE = 16e6  # steps of 1/16 uN or 1/16 uN mm in a newton or N mm
MICRO = 1e6
MAX_ENTRY, MAX_SUM, MAX_SHIFT, MAX_SIGMA = 1 << 26, 1 << 36, 40, 1 << 25
MAX_FULL, MAX_SQUARE_SHIFT = 1 << 30, 13
PART = 1 << 20
MILLI, GAIN, MAX_GAIN, OFFSET = 1e-3, 1 << 30, 1 << 15, 1 << 10  # firmware/stages/feature_wrench/wrench_warmth.cpp

I32 = npt.NDArray[np.int32]


def tables(fit: Fit, features: Features) -> tuple[Tensors, dict[str, str]]:
    """Tensors and metadata; a term or axis that does not fit them is left out, and named in the metadata.

    Raises
    ------
    InputError
        No axis fits: the units of the log cannot be right.
    """
    found, left_out = _that_fits(fit.map)
    gain, shift = np.zeros(found.gain.shape, np.int32), np.zeros(6, np.uint8)
    for i, row in enumerate(found.gain * FINE):
        largest = max(float(np.abs(row).max()), float(np.abs(row).sum()) * MAX_ENTRY / MAX_SUM, 2.0**-14)
        shift[i] = int(np.clip(np.floor(np.log2(MAX_ENTRY / largest) - 1e-9), 1, MAX_SHIFT))
        gain[i] = np.round(row * 2.0 ** shift[i])
    square_shift = _square_shifts(found.square)
    tensors: Tensors = {
        "wrench.gain": gain,
        "wrench.shift": shift,
        "wrench.full_scale": _rounded(found.full * MICRO),
        "wrench.square": _rounded(found.square * FINE / 2.0 ** square_shift[:, None]),
        "wrench.error": _rounded(found.error * MICRO),
    }
    if square_shift.any():
        tensors["wrench.square_shift"] = square_shift.astype(np.uint8)
    if _fits(found.forward, MAX_ENTRY) and _fits(found.tolerance, MAX_ENTRY):
        tensors["wrench.forward"] = _rounded(found.forward)
        tensors["wrench.tolerance"] = np.maximum(_rounded(found.tolerance), 1).astype(np.int32)
    else:
        left_out.append("agreement of the features: beyond the table")
    if found.relax.any():
        tensors["wrench.relax_time_ms"] = np.array([round(1e3 * t) for t in TIMES_S], np.int32)
        tensors["wrench.relax_part"] = _rounded(found.relax * PART)
    if found.warmth is not None:
        celsius = (found.warmth.reference, found.warmth.coldest, found.warmth.warmest)
        tensors["wrench.warm_mc"] = np.array([round(1e3 * c) for c in celsius], np.int32)
        tensors["wrench.warm_gain"] = _rounded(found.warmth.gain * MILLI * GAIN)
        tensors["wrench.warm_offset"] = _rounded(found.warmth.offset * MILLI * FINE * OFFSET)
    if found.kernel is not None:
        tensors |= wrench_kernel.tables(found.kernel)
    if found.rest is not None:
        tensors |= wrench_rest.tables(found.rest)
    residuals = {**fit.report(), "left_out": left_out}
    return tensors, {"wrench.features": features.sort, "residuals": json.dumps(residuals)}


def _that_fits(found: WrenchMap) -> tuple[WrenchMap, list[str]]:
    """The map without the terms and axes that its tables cannot hold, and a sentence for each of those."""
    left_out = list[str]()
    limits = {"its range": (found.full * MICRO, MAX_FULL), "its gain": (_largest(found.gain * FINE), MAX_ENTRY / 2),
              "its error": (_largest((found.error * MICRO).reshape(12, 6).T), MAX_SIGMA)}  # fmt: skip
    too_large = np.zeros(6, bool)
    for what, (values, limit) in limits.items():
        beyond = (values > limit) & (found.full > 0)
        left_out += [f"{axis}: {what} is beyond the table" for axis in np.array(AXES)[beyond & ~too_large]]
        too_large |= beyond
    if too_large.all():
        raise InputError("no axis fits the tables: are forces in N, torques in N mm, shifts in pixels or mm?")
    keep = ~too_large
    square, relax, warmth = found.square * keep[:, None], found.relax * keep, found.warmth
    for i in np.flatnonzero(_largest(square * FINE) > MAX_ENTRY * 2.0**MAX_SQUARE_SHIFT):
        left_out.append(f"{AXES[i]}: its quadratic term is beyond the table")
        square = np.where(np.arange(6)[:, None] == i, 0.0, square)
    if not _fits(relax * PART, PART):
        left_out.append("relaxation: beyond the table")
        relax = np.zeros_like(relax)
    if warmth is not None and not (_fits(warmth.gain * MILLI * GAIN, MAX_GAIN)
                                   and _fits(warmth.offset * MILLI * FINE * OFFSET, MAX_ENTRY)):  # fmt: skip
        left_out.append("temperature: beyond the table")
        warmth = None
    return replace(found, gain=found.gain * keep[:, None], full=found.full * keep, square=square, relax=relax,
                   error=found.error * keep, warmth=warmth), left_out  # fmt: skip


def _square_shifts(square: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """By how many bits the entries of each axis are too large for the table."""
    return np.asarray(np.ceil(np.log2(np.maximum(_largest(square * FINE) / MAX_ENTRY, 1.0))))


def _largest(rows: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.asarray(np.abs(rows).max(axis=1))


def _fits(values: npt.NDArray[np.float64], limit: float) -> bool:
    return bool(np.abs(values).max(initial=0) <= limit)


def _rounded(values: npt.NDArray[np.float64]) -> I32:
    return np.round(values).astype(np.int32)


def map_in(file: CalibrationFile) -> WrenchMap:
    """The map that a file's tables say, in float.

    Raises
    ------
    InputError
        It has none.
    """
    if "wrench" not in file.kinds:
        raise InputError("this calibration has no wrench of features: there is nothing to judge")
    t = {name.removeprefix("wrench."): np.asarray(v, float) for name, v in file.tensors.items()}
    relax = np.zeros((len(TIMES_S), 6))
    if "relax_part" in t:
        relax = t["relax_part"] / PART
    gain = t["gain"] / (FINE * 2.0 ** t["shift"][:, None])
    warmth = None
    if "warm_mc" in t:
        about, coldest, warmest = (t["warm_mc"] * MILLI).tolist()
        gain_per_k, offset_per_k = t["warm_gain"] / (MILLI * GAIN), t["warm_offset"] / (MILLI * FINE * OFFSET)
        warmth = WrenchWarmth(about, coldest, warmest, gain_per_k, offset_per_k)
    n = gain.shape[1]
    forward, tolerance = t.get("forward", np.zeros((n, 27))), t.get("tolerance", np.ones(n))
    return WrenchMap(gain, t["full_scale"] / MICRO, _square_in(t) / FINE, relax, forward, tolerance,
                     t["error"] / MICRO, warmth, wrench_kernel.map_in(t), wrench_rest.gate_in(t))  # fmt: skip


def _square_in(t: dict[str, npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    return np.asarray(t["square"] * 2.0 ** t.get("square_shift", np.zeros(6))[:, None])
