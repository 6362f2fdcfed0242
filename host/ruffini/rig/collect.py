"""Collection of touches: each is checked before the next and stored at once."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.calibrate.log.warmth import CELSIUS
from ruffini.errors import RefusedError
from ruffini.files import write_whole
from ruffini.rig import by_hand
from ruffini.rig.bench import REST_S, TARE_S, Bench
from ruffini.rig.checks import preflight
from ruffini.rig.contact_surface import ContactSurface, PadMovedError
from ruffini.rig.found import estimate
from ruffini.rig.guarded_stage import CONTACT_N, DryStage, GuardedStage, Limits
from ruffini.rig.holder import Tilt
from ruffini.rig.log_file import LogWriter, TouchRecord
from ruffini.rig.program import HOLD_S, Condition, HandTouch, Indent, Item, ScalePress, Tool, Touch, Weight
from ruffini.rig.stage import Place
from ruffini.rig.touch import faults_of, record_of

Array = npt.NDArray[np.float64]
Note = Callable[[Place], None]

MAX_TRIES = 3
CONTROL_EVERY = 5  # touches between control touches, which repeat the first touch at the centre of the pad
CHECKS = "checks.json"


class Progress(NamedTuple):
    """Progress of the collection."""

    n_done: int
    n_total: int
    n_redone: int
    remaining_s: float
    text: str


Tell = Callable[[Progress], None]


def collect(
    bench: Bench, plan: Sequence[Item], log: LogWriter, *, known_grams: float | None = None,
    tell: Tell = lambda _: None,
) -> int:  # fmt: skip
    """Perform every touch of the plan that the log lacks; returns the number of repeated touches.

    The reference is checked before the first of them; clocks and the place of the reference are estimated after the
    last.

    Raises
    ------
    RefusedError
        A check of the reference failed, a touch failed repeatedly, a force limit or the stop key was hit. The tip is
        lifted and the collected touches are kept.
    NoDeviceError
        Stage, sensor or reference was lost; likewise.
    InputError
        The reference uses another unit, or its axes are swapped; another program collects into the same log.
    """
    n_redone = 0
    with log.locked():
        kept = log.touches()
        open_items = [(i, item) for i, item in enumerate(plan) if i not in kept]
        bench.guide.begin(plan, list(kept))
        with bench.safely():
            if open_items:
                _recall(bench, kept)
                _mount(bench, open_items[0][1])  # the checks press with it
                checks = preflight(bench, known_grams)
                write_whole(log.side_file(CHECKS), json.dumps(checks).encode())
                n_redone = _each(bench, open_items, len(plan), log, tell)
        finish(log, bench)
    return n_redone


def _recall(bench: Bench, kept: dict[int, TouchRecord]) -> None:
    """Set the known contact heights to those of the kept touches: the pad must still be there.

    Those of an indenter count from where it touched when it was mounted.
    """
    if bench.stage:
        bench.stage.surface = ContactSurface()
    for record in kept.values():
        if bench.stage and "contact_z_m" in record.facts and "tool" not in record.facts:
            bench.stage.surface.know(*(record.facts[name] for name in ("x_m", "y_m", "contact_z_m")))


def _each(bench: Bench, open_items: list[tuple[int, Item]], n_total: int, log: LogWriter, tell: Tell) -> int:
    n_redone, start, uncontrolled = 0, time.monotonic(), list[int]()
    for n, (i, item) in enumerate(open_items):
        n_done = n_total - len(open_items) + n

        def again(text: str, n_done: int = n_done, n_redone: int = n_redone) -> None:
            tell(Progress(n_done, n_total, n_redone + 1, float("nan"), f"once more: {text}"))

        if _mount(bench, item):  # where its tip ends; the control touches find it there again
            assert bench.stage is not None
            bench.stage.approach(0.0, 0.0)
            bench.stage.lift()
            bench.rest()
        record, tries = _good_touch(bench, i, item, again)
        log.write(i, record)
        bench.guide.good(i)
        uncontrolled.append(i)
        following = open_items[n + 1][1] if n + 1 < len(open_items) else None
        if len(uncontrolled) == CONTROL_EVERY or following is None or _setup(following) != _setup(item):
            _control(bench, log, uncontrolled)
            uncontrolled = []
        n_redone += tries - 1
        left_s = (time.monotonic() - start) / (n + 1) * (len(open_items) - n - 1)
        tell(Progress(n_done + 1, n_total, n_redone, left_s, f"{_line(record)}; {left_s:.0f} s to go"))
    return n_redone


def _setup(item: Item) -> tuple[Tool, Tilt] | None:
    return (item.tool, item.tilt_deg) if isinstance(item, Indent) else None


def _mount(bench: Bench, item: Item) -> bool:
    """True if a person had to mount or to turn something for it."""
    return isinstance(item, Indent) and bench.put_on(item.tool, item.tilt_deg)


def _control(bench: Bench, log: LogWriter, numbers: list[int]) -> None:
    """Check that the pad has not moved during these touches; otherwise they are rejected and repeated."""
    if bench.stage is None:
        return
    bench.reference.tare_change(TARE_S)
    try:
        bench.stage.approach(0.0, 0.0)
    except PadMovedError as error:
        log.doubt(numbers)
        bench.guide.doubt(numbers)
        error.add_note(f"touches {', '.join(map(str, numbers))} came after the pad was last where it was: "
                       "they are set aside and will be done again")  # fmt: skip
        raise
    bench.stage.lift()
    bench.rest()


def finish(log: LogWriter, bench: Bench) -> None:
    """Write the log, with the estimates from all of its touches."""
    facts, checks_file, touches = bench.reference.facts, log.side_file(CHECKS), list(log.touches().values())
    lost = [touch.facts.get("lost_packets", 0) for touch in touches]
    checks: dict[str, Any] = json.loads(checks_file.read_text()) if checks_file.exists() else {}
    reference = {
        "name": facts.name, "unit": facts.unit, "axes": facts.axes, "rate_hz": facts.rate_hz,
        "measured_rate_hz": checks.get("rate", {}).get("rate_hz"),
        "lost_packets": None if bench.reference.n_lost is None else sum(lost),  # while the kept touches were made
        "full_scale": np.where(np.isnan(facts.full_scale), 0, facts.full_scale).tolist(),
        "sigma": np.where(np.isnan(facts.sigma), 0, facts.sigma).tolist(),
    }  # fmt: skip
    log.finish({"reference": reference, "checks": checks, **estimate(touches, reference)})


def _good_touch(bench: Bench, i: int, item: Item, again: Callable[[str], None]) -> tuple[TouchRecord, int]:
    faults: list[str] = []
    for tries in range(1, MAX_TRIES + 1):
        bench.guide.touch(i)
        record, faults = perform(bench, item)
        if not faults:
            record.facts["tries"] = tries
            return record, tries
        bench.guide.bad(i, "; ".join(faults))
        again("; ".join(faults))
    hint = " (deeper than half of the pad, or more than the calibration in force was fitted to: press less, or undo it)"
    told = "; ".join(faults)
    raise RefusedError(f"{item.told()} was bad {MAX_TRIES} times: {told}{hint if 'over_range' in told else ''}")


def perform(bench: Bench, item: Item) -> tuple[TouchRecord, list[str]]:
    """Perform one touch; returns its record and its faults."""
    start, lost_before = host_clock.now(), bench.reference.n_lost
    bench.stream.forget(start)
    drift = bench.tare_again()
    path: list[tuple[float, Place]] = []
    how: dict[type, Callable[[Bench, Any, by_hand.Path], dict[str, Any]]] = {
        Touch: _by_stage, Indent: _by_indenter, Weight: by_hand.weight, ScalePress: by_hand.scale,
        HandTouch: by_hand.touch, Condition: by_hand.condition,
    }  # fmt: skip
    facts = {"kind": item.kind, "told": item.told(), **item._asdict(), **how[type(item)](bench, item, path),
             "session": bench.session, "tare": drift.tolist()}  # fmt: skip
    if warmth := bench.stream.temperatures():
        facts[CELSIUS] = warmth
    bench.catch_up(facts["lifted_host_s"])
    lost_after = bench.reference.n_lost
    if lost_after is not None and lost_before is not None:
        facts["lost_packets"] = lost_after - lost_before
    readings = bench.reference.since(start)
    held = [r for r in readings if facts["held_host_s"] < r.host_s < facts["lifted_host_s"]]
    facts["is_saturated"] = any(r.is_saturated for r in held)
    record = record_of(bench.stream.since(start), readings, path, facts)
    faults = faults_of(record.arrays, facts, bench.bad_flags, longest_gap_s=bench.longest_gap_s)
    return record, [*faults, *item.faults(record)]


def _by_stage(
    bench: Bench, touch: Touch, path: list[tuple[float, Place]], *, is_pictured: bool = False
) -> dict[str, Any]:
    """Press, hold and lift with the stage; returns the times."""
    stage = bench.need_stage()

    def note(place: Place) -> None:
        path.append((host_clock.now(), place))
        if is_pictured:
            bench.wait_for_picture()
            path.append((host_clock.now(), place))

    contact_m = press(stage, touch, note)
    held = host_clock.now()
    lifted = bench.hold(held, touch.hold_s)
    note(path[-1][1])
    stage.lift()
    bench.rest()
    return {
        "contact_z_m": contact_m, "touched_host_s": stage.free_until_s, "held_host_s": held, "lifted_host_s": lifted
    }  # fmt: skip


def _by_indenter(bench: Bench, item: Indent, path: list[tuple[float, Place]]) -> dict[str, Any]:
    """Press with the indenter that is mounted, and lift; the hold starts at the contact."""
    facts = _by_stage(bench, item.press, path, is_pictured=bench.pictures_on_way)
    return {**facts, "tool": item.tool._asdict(), "held_host_s": facts["touched_host_s"],
            "is_pictured": bench.pictures_on_way, "way_down": bench.need_stage().way_down}  # fmt: skip


def press(stage: GuardedStage, touch: Touch, note: Note) -> float:
    """Approach, press and shear; calls `note` at every stop. Returns the height of the contact."""
    contact_m = stage.approach(touch.x_m, touch.y_m)
    note(Place(touch.x_m, touch.y_m, contact_m))
    for depth_m in stage.press(touch.x_m, touch.y_m, contact_m, touch.depth_m):
        note(Place(touch.x_m, touch.y_m, contact_m - depth_m))
    if touch.shear_x_m or touch.shear_y_m:
        end = Place(touch.x_m + touch.shear_x_m, touch.y_m + touch.shear_y_m, contact_m - touch.depth_m)
        for place in stage.slide_to(end):
            note(place)
    return contact_m


class Rehearsal(NamedTuple):
    """A dry run of a plan: its steps as text, positions (k, 3) of the tip, and the least duration in seconds."""

    lines: list[str]
    places: Array
    least_s: float


def rehearse(plan: Sequence[Item], limits: Limits | None) -> Rehearsal:
    """Every move of a plan, without hardware; without limits there is no stage, and the instructions are returned.

    Raises
    ------
    RefusedError
        A touch leads out of the soft limits.
    """
    lines = [f"{number}: {item.told()}" for number, item in enumerate(plan)]
    held_s = sum(item.hold_s if isinstance(item, Touch | Indent) else HOLD_S for item in plan) + len(plan) * REST_S
    if limits is None:
        return Rehearsal(lines, np.zeros((0, 3)), held_s)
    dry, out = DryStage(Place(0.0, 0.0, limits.top_m)), list[str]()

    def force() -> Array:
        return np.array([0, 0, -2 * CONTACT_N * (dry.position().z_m < 0)])

    stage = GuardedStage(dry, Place(0.0, 0.0, 0.0), limits, force)
    setup = None
    for line, item in zip(lines, plan, strict=True):
        n_before = len(dry.moves)
        if _setup(item) != setup:
            setup = _setup(item)
            stage.go_above(0.0, 0.0)
            stage.change_tip(Place(0.0, 0.0, 0.0))
            stage.approach(0.0, 0.0)
        if isinstance(item, Touch | Indent):
            press(stage, item.press if isinstance(item, Indent) else item, lambda place: None)
            stage.lift()
        out += [line, *(f"   {place}" for place in dry.moves[n_before:])]
    return Rehearsal(out, np.array(dry.moves).reshape(-1, 3), dry.duration_s + held_s)


def _line(record: TouchRecord) -> str:
    force_n = np.linalg.norm(np.nan_to_num(record.arrays["reference_wrench"][:, :3]), axis=1).max()
    n_lost = record.facts.get("lost_packets", 0)
    lost = f"; packets of the reference lost or damaged: {n_lost}" if n_lost else ""
    return f"{record.facts['told']}: {force_n:.2f} N{lost}"
