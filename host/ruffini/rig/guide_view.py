"""The page's view of a collection and its bench: the guide, and the quality of the present touch."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ruffini import host_clock
from ruffini.device.results import NOT_MEASURED, VALID
from ruffini.rig.bench import Bench, Person
from ruffini.rig.guarded_stage import CONTACT_N
from ruffini.rig.guide import MAX_DRIFT, TOLERANCE, WEIGHT_TOLERANCE, Guide
from ruffini.rig.program import MIN_PART, Condition, HandTouch, Item, Weight
from ruffini.rig.reference import Reading
from ruffini.rig.stream_watch import StreamSample
from ruffini.rig.units import GRAVITY_M_S2

LOOK_BACK_S = 1.0  # time regarded as live
STILL_S, STILL_PART = 0.5, 0.1  # a hold is steady if its force changes by less than this part within this time
MIN_STILL = 3  # values needed to judge that
GOOD_PART = 0.95  # least part of good frames
FZ = 2
T = TypeVar("T", StreamSample, Reading)
Quality = dict[str, Any]  # name, ok (None: neither good nor bad), text


class HeardPerson:
    """A person, whose page shows what they are told.

    forget : lets go of what the page has pressed so far; raises RefusedError where that was a stop.
    """

    def __init__(self, person: Person, guide: Guide, forget: Callable[[], None]) -> None:
        self._person, self._guide, self._forget = person, guide, forget

    def say(self, text: str) -> None:
        self._guide.said = text
        self._person.say(text)

    def confirm(self, text: str) -> None:
        with self._asking(text, wants_number=False):
            self._person.confirm(text)

    def number(self, text: str) -> str:
        with self._asking(text, wants_number=True):
            return self._person.number(text)

    @contextlib.contextmanager
    def _asking(self, text: str, *, wants_number: bool) -> Iterator[None]:
        guide = self._guide
        self._forget()  # pressed as the terminal answered the question before: it is no answer to this one
        guide.n_asked += 1
        guide.wants_number, guide.is_asked = wants_number, True
        guide.said = text  # last: who sees the question may answer it
        try:
            yield
        finally:
            guide.is_asked = False


def told(guide: Guide, bench: Bench | None) -> dict[str, Any]:
    """A guide and its bench as JSON takes it; millimetres, newtons, forces counted positive where they press."""
    number = guide.number  # once: it may become None at any time
    item = None if number is None else guide.items[number]
    live = None if bench is None else Live.of(bench)
    places = [(one, i) for i, one in enumerate(guide.items) if hasattr(one, "x_m")]
    return {
        "said": guide.said, "asked": guide.n_asked if guide.is_asked else 0,
        "wants_number": guide.is_asked and guide.wants_number, "n_redone": guide.n_redone,
        "n_done": len(guide.done), "n_total": len(guide.items), "set_aside": list(guide.set_aside),
        "touches": [[*_place_mm(one), int(i in guide.done)] for one, i in places],
        "target": _place_mm(item) if hasattr(item, "x_m") else None,
        "load": None if item is None else _load(item, live), "held": _held(guide.hold),
        "quality": quality(bench, live) if bench and live else [],
    }  # fmt: skip


class Live(NamedTuple):
    """What came just now."""

    frames: list[StreamSample]
    readings: list[Reading]

    @classmethod
    def of(cls, bench: Bench) -> Live:
        """Of the last second; of a slow camera or reference the last two."""
        frames = bench.stream.recent(bench.stream.stall_s)
        readings = bench.reference.recent(max(bench.reference.silence_s, LOOK_BACK_S))
        since = host_clock.now() - LOOK_BACK_S
        return cls(_young(frames, since), _young(readings, since))

    @property
    def pressed_n(self) -> float:
        """How hard the reference is pressed; NaN where it says nothing."""
        return -float(self.readings[-1].wrench[FZ]) if self.readings else math.nan

    @property
    def sensor_n(self) -> float:
        """What the sensor says to that; NaN where it does not measure it."""
        is_measured = bool(self.frames) and self.frames[-1].validity[FZ] != NOT_MEASURED
        return -float(self.frames[-1].wrench[FZ]) if is_measured else math.nan

    @property
    def is_valid(self) -> bool:
        """May that be believed?"""
        return bool(self.frames) and self.frames[-1].validity[FZ] == VALID


def _young(samples: list[T], since_s: float) -> list[T]:
    young = [s for s in samples if s.host_s > since_s]
    return young if len(young) > 1 else samples[-2:]


def quality(bench: Bench, live: Live) -> list[Quality]:
    """How good it is: reference, frames, flags, stillness, forces beside each other, drift."""
    drift = float(np.nan_to_num(abs(bench.drift) / bench.reference.facts.full_scale).max())
    return [
        _reference(live), _frames(live, bench.bad_flags), _flags(live, bench.bad_flags),
        _still(live, by_sensor=bench.weight is not None), _beside(live),
        _quality("drift of the reference", drift < MAX_DRIFT, f"{100 * drift:.1f} % of its range since it was tared"),
    ]  # fmt: skip


def _quality(name: str, ok: bool | None, text: str) -> Quality:
    return {"name": name, "ok": None if ok is None else bool(ok), "text": text}


def _per_s(samples: Sequence[StreamSample] | Sequence[Reading]) -> str:
    took_s = samples[-1].host_s - samples[0].host_s
    return f"{(len(samples) - 1) / took_s:.0f}/s" if took_s > 0 else "one"


def _reference(live: Live) -> Quality:
    if not live.readings:
        return _quality("reference", False, "silent: is it plugged in?")
    is_saturated = live.readings[-1].is_saturated
    said = "saturated: press less" if is_saturated else f"{live.pressed_n:.3f} N, readings {_per_s(live.readings)}"
    return _quality("reference", not is_saturated, said)


def _frames(live: Live, bad_flags: dict[int, str]) -> Quality:
    if not live.frames:
        return _quality("frames", False, "none: the camera stands still")
    good = float(np.mean([not any(f.flags & bit for bit in bad_flags) for f in live.frames]))
    return _quality("frames", good >= GOOD_PART, f"{_per_s(live.frames)}, {100 * good:.0f} % good")


def _flags(live: Live, bad_flags: dict[int, str]) -> Quality:
    flags = live.frames[-1].flags if live.frames else 0
    names = [name.replace("_", " ") for bit, name in bad_flags.items() if flags & bit]
    return _quality("flags", not names, ", ".join(names) or "none")


def _still(live: Live, *, by_sensor: bool) -> Quality:
    """How much the force moves, by the reference, or by the sensor where that is slow or a placed weight."""
    since = host_clock.now() - STILL_S
    of_reference = [r.wrench[FZ] for r in live.readings if r.host_s > since]
    of_sensor = [f.wrench[FZ] for f in live.frames if f.host_s > since]
    forces = [
        f for f in (of_sensor if by_sensor or len(of_reference) < MIN_STILL else of_reference) if math.isfinite(f)
    ]
    if len(forces) < MIN_STILL:
        return _quality("stillness", None, "not known")
    spread, mean = (max(forces) - min(forces)) / 2, abs(float(np.mean(forces)))
    ok = None if mean < CONTACT_N else spread < STILL_PART * mean
    return _quality("stillness", ok, f"± {spread:.3f} N in {STILL_S:g} s")


def _beside(live: Live) -> Quality:
    name = "the sensor's force"
    if not math.isfinite(live.sensor_n):
        return _quality(name, None, "not measured yet")
    said = f"{live.sensor_n:.3f} N" + ("" if live.is_valid else ", not calibrated or not valid")
    if live.pressed_n > CONTACT_N:
        said += f", {100 * (live.sensor_n / live.pressed_n - 1):+.0f} % off the reference"
    return _quality(name, None, said)


def _load(item: Item, live: Live | None) -> dict[str, Any] | None:
    """What is wanted, from low to high, and what is there now: by the reference, and by the sensor."""
    if isinstance(item, Condition):
        readings = live.readings if live else []
        part = 100 * float(abs(item.part(readings[-1].wrench)).max()) if readings else math.nan
        return {"unit": "%", "low": 100 * MIN_PART, "high": 100.0, "now": _finite(part), "sensor": None}
    if isinstance(item, HandTouch):
        wanted_n, tolerance = item.force_n, TOLERANCE
    elif isinstance(item, Weight):
        wanted_n, tolerance = 1e-3 * item.grams * GRAVITY_M_S2, WEIGHT_TOLERANCE
    else:
        return None
    now = live.pressed_n if live else math.nan
    sensor = live.sensor_n if live and live.is_valid else math.nan
    return {"unit": "N", "low": (1 - tolerance) * wanted_n, "high": (1 + tolerance) * wanted_n, "now": _finite(now),
            "sensor": _finite(sensor)}  # fmt: skip


def _held(hold: tuple[float, float] | None) -> float | None:
    """Part of the hold that is over, 0 to 1."""
    return None if hold is None else min(max((host_clock.now() - hold[0]) / max(hold[1], 1e-3), 0.0), 1.0)


def _place_mm(item: Any) -> list[float]:
    return [round(1e3 * item.x_m, 3), round(1e3 * item.y_m, 3)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
