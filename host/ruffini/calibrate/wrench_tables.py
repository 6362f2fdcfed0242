"""A wrench map as the firmware's integers, kind `wrench` of proto/CALIBRATION.md."""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.container import CalibrationFile, Tensors
from ruffini.calibrate.feature_log import Features
from ruffini.calibrate.wrench_map import Fit
from ruffini.calibrate.wrench_model import TIMES_S, WrenchMap
from ruffini.calibrate.wrench_warmth import WrenchWarmth
from ruffini.errors import InputError

FINE = 16e6  # steps of 1/16 uN or 1/16 uN mm in a newton or N mm
MICRO = 1e6
MAX_ENTRY, MAX_SUM, MAX_SHIFT, MAX_SIGMA = 1 << 26, 1 << 36, 40, 1 << 25
PART = 1 << 20
MILLI, GAIN, MAX_GAIN, OFFSET = 1e-3, 1 << 30, 1 << 15, 1 << 10  # firmware/estimators/wrench_warmth.cpp

I32 = npt.NDArray[np.int32]


def tables(fit: Fit, features: Features) -> tuple[Tensors, dict[str, str]]:
    """Tensors and metadata.

    Raises
    ------
    InputError
        A number does not fit the format: the units of the log cannot be right.
    """
    found = fit.map
    gain, shift = np.zeros(found.gain.shape, np.int32), np.zeros(6, np.uint8)
    for i, row in enumerate(found.gain * FINE):
        largest = max(float(np.abs(row).max()), float(np.abs(row).sum()) * MAX_ENTRY / MAX_SUM, 2.0**-14)
        shift[i] = int(np.clip(np.floor(np.log2(MAX_ENTRY / largest) - 1e-9), 1, MAX_SHIFT))
        gain[i] = _held(row * 2.0 ** shift[i], MAX_ENTRY, "gain")
    tensors: Tensors = {
        "wrench.gain": gain,
        "wrench.shift": shift,
        "wrench.full_scale": _held(found.full * MICRO, 1 << 30, "full scale"),
        "wrench.square": _held(found.square * FINE, MAX_ENTRY, "quadratic term"),
        "wrench.error": _held(found.error * MICRO, MAX_SIGMA, "error"),
        "wrench.forward": _held(found.forward, MAX_ENTRY, "feature"),
        "wrench.tolerance": np.maximum(_held(found.tolerance, MAX_ENTRY, "tolerance"), 1).astype(np.int32),
    }
    if found.relax.any():
        tensors["wrench.relax_time_ms"] = np.array([round(1e3 * t) for t in TIMES_S], np.int32)
        tensors["wrench.relax_part"] = _held(found.relax * PART, PART, "relaxation")
    if found.warmth is not None:
        celsius = (found.warmth.reference, found.warmth.coldest, found.warmth.warmest)
        tensors["wrench.warm_mc"] = np.array([round(1e3 * c) for c in celsius], np.int32)
        tensors["wrench.warm_gain"] = _held(found.warmth.gain * MILLI * GAIN, MAX_GAIN, "gain of temperature")
        tensors["wrench.warm_offset"] = _held(found.warmth.offset * MILLI * FINE * OFFSET, MAX_ENTRY, "offset of it")
    return tensors, {"wrench.features": features.sort, "residuals": json.dumps(fit.report())}


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
    return WrenchMap(gain, t["full_scale"] / MICRO, t["square"] / FINE, relax, forward, tolerance,
                     t["error"] / MICRO, warmth)  # fmt: skip


def _held(values: npt.NDArray[np.float64], limit: int, what: str) -> I32:
    if np.abs(values).max(initial=0) > limit:
        raise InputError(f"the {what} does not fit the table: are forces in N, torques in N mm, shifts in pixels?")
    return np.round(values).astype(np.int32)
