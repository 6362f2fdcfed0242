"""Touches that a person makes: weights, presses, loads through a connector. Each returns when it was held."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ruffini import host_clock
from ruffini.errors import InputError, RefusedError
from ruffini.rig.bench import Bench
from ruffini.rig.checks import check_axes, check_unit
from ruffini.rig.guide import TOLERANCE
from ruffini.rig.manual import HandPress, Target
from ruffini.rig.placed_weight import grams_of
from ruffini.rig.program import Condition, HandTouch, ScalePress, Weight
from ruffini.rig.stage import Place
from ruffini.rig.touch import FREE_N
from ruffini.rig.units import GRAVITY_M_S2

Path = list[tuple[float, Place]]

PATIENCE_S = 120.0
BEGUN, ENDED = 0.15, 0.05  # of the load that is asked for: where a load begins and ends
QUIET_S = 0.3  # of nothing, after a load
NEAR_PART = 0.5  # of the weight that is asked for, and its inverse: beyond that it is a typing error
POLL_S = 0.02


def weight(bench: Bench, item: Weight, _: Path) -> dict[str, Any]:
    """A person places a weight, waits, and takes it away; if a reference also measures it, the two are compared."""
    bench.person.confirm(f"put {item.told()}")
    if bench.weight is not None:
        bench.weight.place(item.grams)
        bench.reference.fresh()
    held = host_clock.now()
    lifted = bench.hold(held)
    if bench.weight is not None:
        bench.weight.place(0.0)
    else:
        seen = np.mean([r.wrench for r in bench.reference.since(held) if r.host_s < lifted], axis=0)
        check_axes(bench.reference.facts, seen)
        check_unit(bench.reference.facts, -float(seen[2]), 1e-3 * item.grams * GRAVITY_M_S2)
    bench.person.confirm("take it away")
    bench.rest()
    return {"touched_host_s": held, "held_host_s": held, "lifted_host_s": lifted}


def scale(bench: Bench, item: ScalePress, _: Path) -> dict[str, Any]:
    """A person presses, types what the scale under the sensor shows, holds still, and lets go."""
    if bench.weight is None:
        raise InputError("program 'scale' is for a scale that a person reads: give --rig scale, or kind = 'weight'")
    begun = _untouched(bench)
    grams = _typed(bench, item)
    if (force_n := 1e-3 * grams * GRAVITY_M_S2) > bench.max_force_n:
        raise RefusedError(f"pressed with {force_n:.2f} N, more than the {bench.max_force_n:g} N allowed: let go")
    bench.weight.place(grams)
    bench.reference.fresh()
    held = host_clock.now()
    bench.person.say("hold still")
    lifted = bench.hold(held)
    bench.weight.place(0.0)
    bench.person.confirm("let go")
    bench.rest()
    return {"typed_g": grams, "touched_host_s": begun, "held_host_s": held, "lifted_host_s": lifted}


def _untouched(bench: Bench) -> float:
    """Wait for a picture of the untouched pad, which a ball's colours are differences from; returns its end."""
    bench.person.say("wait: a picture of the untouched pad is taken")
    return bench.hold(host_clock.now(), 0.0)


def _typed(bench: Bench, item: ScalePress) -> float:
    """What the person types, in grams; asked again until it is a number near what was asked for."""
    question, wrong = f"{item.told()}, keep pressing, and type what it shows, in grams", ""
    while True:
        text = bench.person.number(f"{wrong}{question}")
        try:
            grams = grams_of(text)
        except InputError as error:
            wrong = f"{error} - "
            continue
        if NEAR_PART * item.grams <= grams <= item.grams / NEAR_PART:
            return grams
        wrong = f"{grams:g} g is far from {item.grams:g} g: press again - "


def touch(bench: Bench, item: HandTouch, _: Path) -> dict[str, Any]:
    """A person presses with the requested force, and lets go."""
    begun = _untouched(bench)

    def holds(since_s: float | None, for_s: float) -> None:
        bench.guide.hold = None if since_s is None else (since_s, for_s)

    hand = HandPress(lambda: bench.reference.latest().wrench, bench.max_force_n, bench.person.say, holds)
    held, _right = hand.press(Target(item.x_m, item.y_m, item.force_n, TOLERANCE * item.force_n), guard=bench.guard)
    lifted = bench.hold(held)
    hand.release(FREE_N, guard=bench.guard)
    bench.rest()
    return {"touched_host_s": begun, "held_host_s": held, "lifted_host_s": lifted}


def condition(bench: Bench, item: Condition, _: Path) -> dict[str, Any]:
    """A person loads the connector and lets go; the hold lasts from the beginning to the end of the load."""
    bench.person.say(item.told())
    begun = _wait(bench, item, lambda part: part > BEGUN, 0.0, "no load came")
    ended = _wait(bench, item, lambda part: part < ENDED, QUIET_S, "the load stayed")
    bench.person.say("good")
    bench.rest()
    return {"touched_host_s": begun, "held_host_s": begun, "lifted_host_s": ended}


def _wait(bench: Bench, item: Condition, is_so: Callable[[float], bool], for_s: float, told: str) -> float:
    """Wait until `is_so` holds for `for_s` for the largest component of the load; returns when that began."""
    deadline, since = host_clock.now() + PATIENCE_S, None
    while (now := host_clock.now()) < deadline:
        bench.guard()
        bench.stream.latest()
        wrench = bench.reference.latest().wrench
        force_n = float(np.linalg.norm(np.nan_to_num(wrench[:3])))
        if force_n > bench.max_force_n:
            raise RefusedError(f"loaded with {force_n:.2f} N, more than the {bench.max_force_n:g} N allowed: let go")
        since = (since or now) if is_so(float(abs(item.part(wrench)).max())) else None
        if since is not None and now - since >= for_s:
            return since
        host_clock.sleep(POLL_S)
    raise RefusedError(f"{told} within {PATIENCE_S:g} s: {item.told()}")
