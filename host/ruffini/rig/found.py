"""Estimates from a whole log: the clock offsets and the mounting of the reference.

Both are estimated when the log is finished and stored in its `found`, which its readers use.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.rig.clock import fit_clock, fit_curved
from ruffini.rig.frame_fit import FrameFit, fit_frame
from ruffini.rig.log_file import ACTIVITY, MOTION, Log, TouchRecord
from ruffini.rig.program import SCALE
from ruffini.rig.touch_clock import MIN_TOUCHES, Pressed, fit_touches

Array = npt.NDArray[np.float64]

SETTLED_PART = 0.5  # of the hold, its end: the pad has stopped creeping fast
SCALARS = ("force_rmse_n", "torque_rmse_nm")  # of FrameFit
REST_S = 0.15  # of a touch's first and last readings: nothing touches then


def is_held(times: Array, facts: dict[str, Any], *, part: float = 1.0) -> npt.NDArray[np.bool_]:
    """Mask of the host times in the last `part` of a touch's hold."""
    start = facts["lifted_host_s"] - part * (facts["lifted_host_s"] - facts["held_host_s"])
    return np.asarray((times > start) & (times < facts["lifted_host_s"]))


def is_settled(times: Array, facts: dict[str, Any]) -> npt.NDArray[np.bool_]:
    """Mask of the host times at the end of a touch's hold; of the whole hold if there are none, as on a slow line."""
    late = is_held(times, facts, part=SETTLED_PART)
    return late if late.any() else is_held(times, facts)


def estimate(touches: list[TouchRecord], reference: dict[str, Any]) -> dict[str, Any]:
    """`clocks`, `frame` and, if the log has them, `contacts`; `why_not` gives the reason for a missing estimate.

    Parameters
    ----------
    reference : dict
        `found["reference"]`: its stated uncertainty is used.
    """
    sessions = sorted({str(t.facts.get("session", "")) for t in touches})
    clocks = [{"session": s, **_clock([t for t in touches if str(t.facts.get("session", "")) == s])} for s in sessions]
    found = {"clocks": clocks, "frame": _frame(touches, np.array(reference["sigma"], dtype=float))}
    return found if not any("contact_s" in t.arrays for t in touches) else {**found, "contacts": _contacts(touches)}


def _clock(touches: list[TouchRecord]) -> dict[str, Any]:
    if any(t.facts.get("kind") == SCALE for t in touches):
        return {"why_not": "a person typed the reference: its readings do not follow the press in time"}
    touches = sorted(touches, key=lambda t: float(t.arrays["stream_s"][0]))
    stream_s, host_s, reference_s = (
        np.concatenate([t.arrays[name] for t in touches]) for name in ("stream_s", "stream_host_s", "reference_s")
    )
    wrench = np.concatenate([t.arrays["reference_wrench"] for t in touches])
    seen = np.concatenate([t.arrays["stream_wrench"][:, 2] for t in touches])
    rough_s = float(np.median(host_s - stream_s))
    signals = [s for t in touches if (s := _signals(t)) is not None]
    try:
        if len(signals) == len(touches) >= MIN_TOUCHES:
            fit = fit_touches([
                Pressed(t.arrays["stream_s"] + rough_s, s, t.arrays["reference_s"], t.arrays["reference_wrench"])
                for t, s in zip(touches, signals, strict=True)
            ])  # fmt: skip
        elif not np.isnan(seen).any():
            fit = fit_clock(stream_s + rough_s, seen, reference_s, wrench[:, 2])
        elif all(ACTIVITY in t.arrays for t in touches):
            activity = np.concatenate([t.arrays[ACTIVITY] for t in touches])
            felt = np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1)
            fit = fit_curved(stream_s + rough_s, activity, reference_s, felt)
        else:
            return {"why_not": "the stream measures neither forces nor markers: nothing to compare with"}
    except InputError as error:
        return {"why_not": str(error)}
    return {
        "offset_s": rough_s + fit.offset_s, "sigma_s": fit.offset_sigma_s, "drift": fit.drift,
        "drift_sigma": fit.drift_sigma, "middle_s": fit.middle_s - rough_s, "correlation": fit.correlation,
        "late_s": fit.offset_s,
    }  # fmt: skip


def _signals(touch: TouchRecord) -> Array | None:
    """Signals of the stream that follow the load, (t, k): its wrench, or the markers' motion."""
    a = touch.arrays
    measured = np.isfinite(a["stream_wrench"]).all(axis=0)
    if measured.any():
        return np.asarray(a["stream_wrench"][:, measured])
    return np.column_stack([a[MOTION], a[ACTIVITY]]) if MOTION in a and ACTIVITY in a else None


def _frame(touches: list[TouchRecord], sigma: Array) -> dict[str, Any]:
    rows = [_settled(t) for t in touches if len(t.arrays["stage_place"])]
    if not rows:
        return {"why_not": "no stage pressed: the places of the contacts are not known well enough"}
    rest = np.vstack([_rest(t) for t in touches])
    reading, place, direction = (np.array(column) for column in zip(*rows, strict=True))
    if np.isnan(direction).any():
        return {"why_not": "the stream does not measure all of the force: its direction is not known"}
    try:
        fit = fit_frame(rest, reading, place, direction, sigma)
    except InputError as error:
        return {"why_not": str(error)}
    return {name: np.asarray(value).tolist() for name, value in fit._asdict().items()}


def _contacts(touches: list[TouchRecord]) -> dict[str, Any]:
    """A skin's contacts at the end of each hold: distance to the tip, and force relative to the reference."""
    rows = [row for t in touches if len(t.arrays["stage_place"]) and (row := _contact_at_tip(t)) is not None]
    if not rows:
        return {"why_not": "no contact was seen while a stage held the tip: is the sensor calibrated?"}
    off_m, gain = np.array([off for off, _ in rows]), np.array([g for _, g in rows])
    middle = np.median(off_m, axis=0)
    return {
        "touches": len(rows), "unseen": len(touches) - len(rows), "offset_m": middle.tolist(),
        "spread_m": float(np.median(np.linalg.norm(off_m - middle, axis=1))), "gain": float(np.median(gain)),
        "gain_spread": float(np.median(np.abs(gain - np.median(gain)))),
    }  # fmt: skip


def _contact_at_tip(touch: TouchRecord) -> tuple[Array, float] | None:
    """Offset (2,) m of the contact nearest to the tip, and its force relative to the reference."""
    a, f = touch.arrays, touch.facts
    held_s = a["stream_s"][is_settled(a["stream_host_s"], f)]
    if "contact_s" not in a or not np.isin(a["contact_s"], held_s).any():
        return None
    kept = np.isin(a["contact_s"], held_s)
    off_m = a["contact_place"][kept] - a["stage_place"][-1, :2]
    number = a["contact_number"][kept]
    nearest = number == number[np.linalg.norm(off_m, axis=1).argmin()]
    felt_n = float(a["reference_wrench"][is_settled(a["reference_s"], f), 2].mean())
    return off_m[nearest].mean(axis=0), float(a["contact_force"][kept][nearest].mean() / felt_n)


def _settled(touch: TouchRecord) -> tuple[Array, Array, Array]:
    """Reading of the reference, position of the tip and the sensor's force at the end of the hold."""
    a, f = touch.arrays, touch.facts
    reading = a["reference_wrench"][is_settled(a["reference_s"], f)].mean(axis=0)
    direction = a["stream_wrench"][is_settled(a["stream_host_s"], f), :3].mean(axis=0)
    return reading, a["stage_place"][-1], direction


def _rest(touch: TouchRecord) -> Array:
    """Readings before the touch."""
    t = touch.arrays["reference_s"]
    return np.asarray(touch.arrays["reference_wrench"][t < t[0] + REST_S])


def reference_in_pad(log: Log, touch: TouchRecord) -> Array:
    """The reference's wrench ON the pad about its centre, (m, 6), in the mounting that the log estimated, if any."""
    frame, wrench = log.found.get("frame", {}), touch.arrays["reference_wrench"]
    if "rotation" not in frame:
        return np.asarray(wrench)
    values: dict[str, Any] = {n: v if n in SCALARS else np.array(v) for n, v in frame.items()}
    fit = FrameFit(**values)
    return fit.to_pad(wrench)


def on_reference_clock(log: Log, touch: TouchRecord) -> Array:
    """Capture times of the frames, (n,), on the reference's clock; their arrival times if the clocks are unknown."""
    session = str(touch.facts.get("session", ""))
    clock = next((c for c in log.found.get("clocks", []) if c["session"] == session and "offset_s" in c), None)
    stream_s = touch.arrays["stream_s"]
    if clock is None:
        return np.asarray(touch.arrays["stream_host_s"])
    return np.asarray(stream_s + clock["offset_s"] + clock["drift"] * (stream_s - clock["middle_s"]))
