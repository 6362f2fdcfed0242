"""Is the reference what it is said to be? Looked at before the first touch: rate, rest, axes, unit."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import InputError, RefusedError
from ruffini.rig.bench import Bench
from ruffini.rig.reference import Facts
from ruffini.rig.units import GRAVITY_M_S2, MISTAKE_TOLERANCE, likely_mistake

Array = npt.NDArray[np.float64]

AXIS_DOMINATES = 0.8  # part of the force that a straight press puts on z
RATE_S = 0.6  # over which the rate is counted
PROBE_N = 0.4  # of the press that is looked at
SENSOR_TOLERANCE = 0.6  # a sensor that is yet to be calibrated may be off by as much
SENSOR_MISTAKE = 0.35  # of the ratio of two units, against such a sensor
Result = dict[str, Any]


def preflight(bench: Bench, known_grams: float | None = None) -> Result:
    """Every check that this bench allows; the tip is lifted after it.

    Raises
    ------
    InputError
        Wrong unit, axes swapped or upside down; the text names what to change.
    RefusedError
        Too slow, restless, saturated, or off for no known reason.
    """
    facts = bench.reference.facts
    found: Result = {"rate": _rate(bench)}
    change = bench.reference.tare()
    bench.drift = np.zeros(6)
    found["tare"] = _passed(f"at rest; {np.nan_to_num(np.linalg.norm(change[:3])):.3f} N were taken off")
    if known_grams is not None:
        found["unit"] = _weigh(bench, known_grams)
    if bench.stage is None:
        found["axes"] = _open("no stage presses straight")
    else:
        pressed, seen_n = _probe(bench)
        check_axes(facts, pressed)
        told = ", ".join(f"{n} {v:.2f}" for n, v in zip("xyz", pressed, strict=False) if np.isfinite(v))
        found["axes"] = _passed(f"a straight press is {told} N")
        found.setdefault("unit", _compare(facts, -float(pressed[2]), seen_n))
    found.setdefault("unit", _open("nothing of known force was tried: give --known-grams"))
    return found


def _rate(bench: Bench) -> Result:
    readings = bench.reference.collect(max(RATE_S, 3 / bench.reference.facts.rate_hz))
    rate_hz = bench.reference.check_rate(readings)
    return {**_passed(f"{rate_hz:.1f} readings a second"), "rate_hz": rate_hz}


def _weigh(bench: Bench, grams: float) -> Result:
    """A known weight, put there by a person."""
    expected_n = 1e-3 * grams * GRAVITY_M_S2
    bench.person.confirm(f"put {grams:g} g on the middle of the pad")
    pressed = np.mean([r.wrench for r in bench.rest()], axis=0)
    bench.person.confirm("take the weight away")
    bench.rest()
    check_unit(bench.reference.facts, float(np.linalg.norm(np.nan_to_num(pressed[:3]))), expected_n)
    return _passed(f"{grams:g} g read {np.linalg.norm(np.nan_to_num(pressed[:3])) / expected_n:.3f} of their weight")


def _probe(bench: Bench) -> tuple[Array, float]:
    """A light press on the middle: change of the reference (6,), and how hard the sensor says it was, N."""
    stage = bench.need_stage()
    with stage.safely():
        contact_m = stage.approach(0.0, 0.0)
        for _ in stage.press(0.0, 0.0, contact_m, stage.limits.deepest_m):
            if np.linalg.norm(np.nan_to_num(bench.reference.fresh().wrench[:3])) >= PROBE_N:
                break
        start = host_clock.now()
        end = bench.hold(start)
        pressed = np.mean([r.wrench for r in bench.reference.since(start) if r.host_s < end], axis=0)
        seen = np.mean([s.wrench for s in bench.stream.since(start).frames], axis=0)
        stage.lift()
    bench.rest()
    return np.asarray(pressed), -float(seen[2])


def _compare(facts: Facts, measured_n: float, seen_n: float) -> Result:
    """The reference against a sensor whose calibration may be off."""
    if not seen_n > 0:
        return _open("the sensor does not measure this force yet: give --known-grams")
    unit = likely_mistake(measured_n, seen_n, facts.unit, SENSOR_MISTAKE)
    text = f"{measured_n:.2f} N where the sensor says {seen_n:.2f} N"
    if abs(measured_n / seen_n - 1) <= SENSOR_TOLERANCE:
        return _passed(text)
    if unit is not None:
        raise InputError(
            f"{facts.name} reads {text}: it seems to count in {unit}, not in {facts.unit}: give unit in [reference], "
            "or --known-grams with a weight if it is the sensor that is wrong"
        )
    return {"ok": False, "text": f"{text}: no other unit explains it: try --known-grams"}


def _passed(text: str) -> Result:
    return {"ok": True, "text": text}


def _open(text: str) -> Result:
    return {"ok": None, "text": text}


def check_unit(
    facts: Facts, measured_n: float, expected_n: float, tolerance: float = 0.1, mistake: float = MISTAKE_TOLERANCE
) -> None:
    """A known weight or a known press must read what it is; `mistake`: how near a ratio of units tells one.

    Raises
    ------
    InputError
        It reads what it would in another unit; the text names that unit.
    RefusedError
        It is off by more than `tolerance` for another reason.
    """
    if abs(measured_n - expected_n) <= tolerance * expected_n:
        return
    ratio = measured_n / expected_n
    unit = likely_mistake(measured_n, expected_n, facts.unit, mistake)
    if unit is not None:
        raise InputError(f"{facts.name} reads {measured_n:.3g} N for {expected_n:.3g} N: "
                         f"it counts in {unit}, not in {facts.unit}: give unit = '{unit}' in [reference]")  # fmt: skip
    raise RefusedError(
        f"{facts.name} reads {ratio:.2f} times the known {expected_n:.3g} N: "
        "no other unit explains it: check its scale factor and its mounting"
    )


def check_axes(facts: Facts, change: Array) -> None:
    """A straight press must be -z: force ON the pad, which pressing pushes in.

    Raises
    ------
    InputError
        Another axis carries it, or z with the wrong sign; the text says which.
    """
    force = np.nan_to_num(change[:3])
    axis = int(abs(force).argmax())
    length = float(np.linalg.norm(force))
    if abs(force[axis]) < AXIS_DOMINATES * length:
        raise InputError(f"{facts.name} sees a straight press as {force.round(3).tolist()} N: it is mounted askew, "
                         "or the press is not straight: align it")  # fmt: skip
    name = "xyz"[axis]
    if axis != 2:
        raise InputError(f"{facts.name} sees a straight press on {'-+'[int(force[axis] > 0)]}{name} instead of -z: "
                         "axes are swapped: turn it, or give axes in [reference]")  # fmt: skip
    if force[2] > 0:
        raise InputError(f"{facts.name} sees a press as +z: it measures the force on itself, or is upside down: "
                         "give is_inverted = true, or axes, in [reference]")  # fmt: skip
