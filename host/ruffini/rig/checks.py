"""Checks of the reference before the first touch: rate, rest, axes and unit."""

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
RATE_S = 0.6  # time over which the rate is measured
PROBE_N = 0.4  # force of the test press
SENSOR_TOLERANCE = 0.6  # relative error allowed for a sensor that is not calibrated yet
SENSOR_MISTAKE = 0.35  # relative distance from the ratio of two units, against such a sensor
Result = dict[str, Any]


def preflight(bench: Bench, known_grams: float | None = None) -> Result:
    """Run every check that this bench allows, then lift the tip.

    Raises
    ------
    InputError
        Wrong unit, axes swapped or inverted; the message names what to change.
    RefusedError
        The reference is too slow, unsteady or saturated, or wrong for an unknown reason.
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
    if bench.reference.facts.is_typed:
        return _passed("none: a person tells what it reads")
    before = bench.reference.n_lost or 0
    readings = bench.reference.collect(max(RATE_S, 3 / bench.reference.facts.rate_hz))
    n_lost = (bench.reference.n_lost or 0) - before
    rate_hz = bench.reference.check_rate(readings, n_lost)
    told = f"; packets lost or damaged: {n_lost}: check the network or the line" if n_lost else ""
    return {**_passed(f"{rate_hz:.1f} readings a second{told}"), "rate_hz": rate_hz}


def _weigh(bench: Bench, grams: float) -> Result:
    """Check the reference with a known weight placed by a person."""
    expected_n = 1e-3 * grams * GRAVITY_M_S2
    bench.person.confirm(f"put {grams:g} g on the middle of the pad")
    pressed = np.mean([r.wrench for r in bench.rest()], axis=0)
    bench.person.confirm("take the weight away")
    bench.rest()
    check_unit(bench.reference.facts, float(np.linalg.norm(np.nan_to_num(pressed[:3]))), expected_n)
    return _passed(f"{grams:g} g read {np.linalg.norm(np.nan_to_num(pressed[:3])) / expected_n:.3f} of their weight")


def _probe(bench: Bench) -> tuple[Array, float]:
    """A light press on the centre: change of the reference (6,), and the force that the sensor measures, N."""
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
    """Compare the reference with a sensor whose calibration may be inaccurate."""
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
    """A known weight or press must be measured correctly.

    mistake : relative distance from the ratio of two units within which a wrong unit is reported.

    Raises
    ------
    InputError
        The reading fits another unit, which the message names.
    RefusedError
        The reading is wrong by more than `tolerance` for another reason.
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
    """A straight press must read as -z, the force ON the pad.

    Raises
    ------
    InputError
        Another axis carries it, or z has the wrong sign; the message names the axis.
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
                         "turn it over, or give is_inverted = true or axes, if its kind has one")  # fmt: skip
