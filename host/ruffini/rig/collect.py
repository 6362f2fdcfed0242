"""Collecting: touch after touch, each looked at before the next, each kept at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.errors import RefusedError
from ruffini.rig.guarded_stage import CONTACT_N, DryStage, GuardedStage, Limits
from ruffini.rig.log_file import LogWriter, TouchRecord
from ruffini.rig.program import Touch
from ruffini.rig.stage import Place
from ruffini.rig.stream_watch import FieldSample, StreamSample, StreamWatch
from ruffini.rig.watch import Watch

Array = npt.NDArray[np.float64]

MAX_TRIES = 3
HOLD_S, REST_S = 0.5, 0.3
LONGEST_GAP_S = 0.3  # without a frame
MIN_FRAMES, MIN_READINGS = 5, 3  # while it is held
FREE_N = CONTACT_N / 2  # of the reference after the tip was lifted
FIELDS_KEPT = 4  # of a hold: they are all alike


class Progress(NamedTuple):
    """How far it is."""

    n_done: int
    n_total: int
    n_redone: int
    remaining_s: float
    text: str


@dataclass
class Bench:
    """What a touch needs."""

    stage: GuardedStage
    reference: Watch
    stream: StreamWatch
    bad_flags: dict[int, str]  # bits that spoil a frame, and what they are called


def collect(
    bench: Bench, plan: Sequence[Touch], log: LogWriter, *, tell: Callable[[Progress], None] = lambda _: None
) -> int:
    """Every touch of the plan that the log does not have yet; how many had to be done again.

    Raises
    ------
    RefusedError
        A touch is bad again and again, a force limit, a stop key; the tip is lifted, what was collected is kept.
    NoDeviceError
        Stage, sensor or reference went away; likewise.
    """
    done = log.done()
    open_touches = [(i, t) for i, t in enumerate(plan) if i not in done]
    n_redone, start = 0, time.monotonic()
    with bench.stage.safely():
        for n, (i, touch) in enumerate(open_touches):
            n_done = len(plan) - len(open_touches) + n

            def again(text: str, n_done: int = n_done, n_redone: int = n_redone) -> None:
                tell(Progress(n_done, len(plan), n_redone + 1, float("nan"), f"once more: {text}"))

            record, tries = _good_touch(bench, touch, again)
            log.write(i, record)
            n_redone += tries - 1
            each_s = (time.monotonic() - start) / (n + 1)
            left_s = each_s * (len(open_touches) - n - 1)
            tell(Progress(n_done + 1, len(plan), n_redone, left_s, f"{_line(record)}; {left_s:.0f} s to go"))
        bench.stage.lift()
    log.finish()
    return n_redone


def rehearse(plan: Sequence[Touch], limits: Limits) -> float:
    """Every move of a plan on a stage and a pad that are not there; seconds that it takes at least.

    Raises
    ------
    RefusedError
        A touch leads out of the soft limits.
    """
    dry = DryStage(Place(0.0, 0.0, limits.top_m))

    def force() -> Array:
        return np.array([0, 0, -2 * CONTACT_N * (dry.position().z_m < 0)])

    stage = GuardedStage(dry, Place(0.0, 0.0, 0.0), limits, force)
    for touch in plan:
        _press(stage, touch, lambda place: None)
        stage.lift()
    return dry.duration_s + len(plan) * (HOLD_S + REST_S)


def _press(stage: GuardedStage, touch: Touch, note: Callable[[Place], None]) -> float:
    """Approach, press and shear; `note` is told every place where it stands. Returns the height of the contact."""
    contact_m = stage.approach(touch.x_m, touch.y_m)
    note(Place(touch.x_m, touch.y_m, contact_m))
    for depth_m in stage.press(touch.x_m, touch.y_m, contact_m, touch.depth_m):
        note(Place(touch.x_m, touch.y_m, contact_m - depth_m))
    if touch.shear_x_m or touch.shear_y_m:
        end = Place(touch.x_m + touch.shear_x_m, touch.y_m + touch.shear_y_m, contact_m - touch.depth_m)
        for place in stage.slide_to(end):
            note(place)
    return contact_m


def _good_touch(bench: Bench, touch: Touch, again: Callable[[str], None]) -> tuple[TouchRecord, int]:
    faults: list[str] = []
    for tries in range(1, MAX_TRIES + 1):
        record, faults = touch_once(bench, touch)
        if not faults:
            record.facts["tries"] = tries
            return record, tries
        again("; ".join(faults))
    raise RefusedError(f"the touch at x {1e3 * touch.x_m:.1f}, y {1e3 * touch.y_m:.1f} mm was bad {MAX_TRIES} times: "
                       f"{'; '.join(faults)}")  # fmt: skip


def touch_once(bench: Bench, touch: Touch) -> tuple[TouchRecord, list[str]]:
    """One touch, and what is wrong with it."""
    stage = bench.stage
    start = time.monotonic()
    bench.stream.forget(start)
    path: list[tuple[float, Place]] = []

    def note(place: Place) -> None:
        path.append((time.monotonic(), place))

    contact_m = _press(stage, touch, note)
    held = time.monotonic()
    bench.reference.collect(HOLD_S)
    note(path[-1][1])
    lifted = time.monotonic()
    stage.lift()
    bench.reference.collect(REST_S)
    samples, fields = bench.stream.since(start)
    readings = bench.reference.since(start)
    facts = {**touch._asdict(), "contact_z_m": contact_m, "held_host_s": held, "lifted_host_s": lifted}
    arrays = {
        **_stream_arrays(samples), **_field_arrays(fields, samples, held, lifted),
        "reference_s": np.array([r.host_s for r in readings]),
        "reference_wrench": np.array([r.wrench for r in readings]).reshape(-1, 6),
        "stage_s": np.array([t for t, _ in path]), "stage_place": np.array([p for _, p in path]).reshape(-1, 3),
    }  # fmt: skip
    return TouchRecord(facts, _rising(arrays)), faults_of(arrays, facts, bench.bad_flags)


def faults_of(arrays: dict[str, Any], facts: dict[str, Any], bad_flags: dict[int, str]) -> list[str]:
    """What is wrong with a touch, in words; nothing where it is good."""
    host_s, flags = arrays["stream_host_s"], arrays["stream_flags"]
    is_held = (host_s > facts["held_host_s"]) & (host_s < facts["lifted_host_s"])
    found = []
    if is_held.sum() < MIN_FRAMES:
        found.append(f"{is_held.sum()} frames while it was held, {MIN_FRAMES} are needed")
    if len(host_s) > 1 and np.diff(host_s).max() > LONGEST_GAP_S:
        found.append(f"no frame for {np.diff(host_s).max():.2f} s")
    found += [name for bit, name in bad_flags.items() if (flags[is_held] & bit).any()]
    reference_s, wrench = arrays["reference_s"], arrays["reference_wrench"]
    is_seen = (reference_s > facts["held_host_s"]) & (reference_s < facts["lifted_host_s"])
    if is_seen.sum() < MIN_READINGS:
        return [*found, f"{is_seen.sum()} readings of the reference while it was held, {MIN_READINGS} are needed"]
    pressed_n = 0.0 - wrench[is_seen, 2].mean()
    if pressed_n < CONTACT_N:
        found.append(f"the reference saw only {pressed_n:.3f} N")
    if abs(wrench[-1, 2]) > FREE_N:
        found.append(
            f"{-wrench[-1, 2]:.3f} N stayed after the tip was lifted: the reference drifted, or the tip sticks"
        )
    return found


def _stream_arrays(samples: list[StreamSample]) -> dict[str, npt.NDArray[Any]]:
    return {
        "stream_s": np.array([s.stream_s for s in samples]), "stream_host_s": np.array([s.host_s for s in samples]),
        "stream_frame": np.array([s.frame for s in samples], np.int64),
        "stream_flags": np.array([s.flags for s in samples], np.int64),
        "stream_wrench": np.array([s.wrench for s in samples]).reshape(-1, 6),
        "stream_validity": np.array([s.validity for s in samples], np.int64).reshape(-1, 6),
    }  # fmt: skip


def _field_arrays(
    fields: list[FieldSample], samples: list[StreamSample], held_s: float, lifted_s: float
) -> dict[str, npt.NDArray[Any]]:
    """The displacement while it was held, a few frames of it."""
    frames = {s.stream_s for s in samples if held_s < s.host_s < lifted_s}
    kept = [f for f in fields if f.stream_s in frames][-FIELDS_KEPT:]
    if not kept:
        return {}
    return {
        "field_s": np.array([f.stream_s for f in kept]),
        "field_displacement": np.array([f.displacement for f in kept], np.float32),
    }


def _rising(arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Readings that came in one batch carry one host time: the last of each batch stays."""
    time_s = arrays["reference_s"]
    keep = np.append(np.diff(time_s) > 0, True) if len(time_s) else np.zeros(0, bool)
    return {k: v[keep] if k.startswith("reference_") else v for k, v in arrays.items()}


def _line(record: TouchRecord) -> str:
    f = record.facts
    force_n = float(np.nanmin(record.arrays["reference_wrench"][:, 2]))
    return f"x {1e3 * f['x_m']:+.1f} y {1e3 * f['y_m']:+.1f} mm, {1e3 * f['depth_m']:.2f} mm deep: {-force_n:.2f} N"
