"""The bench: stage or person, reference, sensor stream, and the guards that stop a touch."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import InputError, RefusedError
from ruffini.rig.guarded_stage import GuardedStage
from ruffini.rig.guide import MAX_DRIFT, Guide
from ruffini.rig.holder import UPRIGHT, Holder, Tilt, told
from ruffini.rig.placed_weight import PlacedWeight
from ruffini.rig.program import HOLD_S, Tool
from ruffini.rig.reference import Reading
from ruffini.rig.stage import Guard, Place, no_guard
from ruffini.rig.stream_watch import StreamWatch
from ruffini.rig.touch import LONGEST_GAP_S, MIN_FRAMES, MIN_READINGS, least_delay_s
from ruffini.rig.watch import Watch

Array = npt.NDArray[np.float64]

REST_S = 0.3
MAX_HOLD_S = 10.0  # for a slow reference, a slow camera, a slow line that brings a picture
TARE_S = 0.15


class Person(Protocol):
    """The person at the bench, who follows instructions."""

    def say(self, text: str) -> None:
        """Show an instruction."""

    def confirm(self, text: str) -> None:
        """Show an instruction and wait until the person confirms that it is done.

        Raises
        ------
        RefusedError
            The person declined, or nobody answers.
        """

    def number(self, text: str) -> str:
        """Show an instruction and wait until the person has typed what it asks for; returns that, unchecked.

        Raises
        ------
        RefusedError
            The person declined, or nobody answers.
        """


@dataclass
class Bench:
    """A bench: connected, homed and at rest."""

    reference: Watch
    stream: StreamWatch
    bad_flags: dict[int, str]  # flag bits that make a frame unusable, and their names
    person: Person
    max_force_n: float
    stage: GuardedStage | None = None
    guard: Guard = no_guard  # the stop key and the limit on the sensor's own force
    weight: PlacedWeight | None = None  # the reference, if it is a weight
    session: str = ""
    longest_gap_s: float = LONGEST_GAP_S
    max_hold_s: float = MAX_HOLD_S
    mount: Callable[[Tool], None] | None = None  # mounts an indenter; None: the person is asked
    mounted: tuple[Tool, Tilt] | None = None  # so far
    holder: Holder | None = None  # turns what is pressed
    pictures_on_way: bool = False  # an indenter stands at each of its steps until there is a picture
    drift: Array = field(default_factory=lambda: np.zeros(6))  # of the reference, since it was first tared
    guide: Guide = field(default_factory=Guide)  # its current step, for the page

    def put_on(self, tool: Tool, tilt_deg: Tilt = UPRIGHT) -> bool:
        """Have an indenter mounted and the holder turned with the tip up; False if all was so.

        Where the tip touches, the next approach finds.

        Raises
        ------
        RefusedError
            The person declined, or nobody answers; the reference is not steady afterwards.
        """
        before, _ = self.mounted or (None, None)
        asked = [] if tool == before else [f"mount indenter {tool.told()}"]
        turns = {} if self.holder is None else self.holder.degrees(tilt_deg)
        is_turned = self.holder is not None and (self.mounted is None or tilt_deg != self.mounted[1])
        if is_turned and not turns:
            asked.append(f"turn the holder to {told(tilt_deg)}")
        if not asked and not is_turned:
            return False
        stage = self.need_stage()
        if self.mounted is None:
            self.reference.tare()  # untared it could stop the way up
        stage.go_above(0.0, 0.0)
        if self.mount is not None:
            self.mount(tool)
        elif asked:
            self.person.confirm(f"{', '.join(asked)}, and take your hands off")
        if is_turned and turns:
            stage.turn(turns)
        self.guide.said = "hands off: the machine presses"
        self.reference.tare_change(TARE_S)  # it may hang on the reference
        stage.change_tip(Place(0.0, 0.0, 0.0) if self.holder is None else self.holder.aside(tilt_deg))
        self.mounted = (tool, tilt_deg)
        return True

    def need_stage(self) -> GuardedStage:
        """The stage; raises InputError if the bench has none."""
        if self.stage is None:
            raise InputError("this program needs a stage: add [stage] to the bench's file, or use weights or free")
        return self.stage

    @contextlib.contextmanager
    def safely(self) -> Iterator[None]:
        """A context in which any exception lifts the tip."""
        with self.stage.safely() if self.stage else contextlib.nullcontext():
            yield

    def hold(self, started_s: float, least_s: float = HOLD_S) -> float:
        """Wait at least `least_s` until enough frames and readings have come since `started_s`; returns the end time.

        Raises
        ------
        NoDeviceError, RefusedError
            Sensor or reference was lost or is saturated, or a guard stopped it.
        """
        deadline = started_s + max(self.max_hold_s, least_s + self.max_hold_s / 2)
        self.guide.hold = (started_s, least_s)
        while host_clock.now() < deadline:
            self.guard()
            self.reference.latest()
            self.stream.latest()
            seen = self.stream.since(started_s)
            has_image = bool(seen.images) or not self.stream.has_images
            has_all = len(seen.frames) > MIN_FRAMES and len(self.reference.since(started_s)) > MIN_READINGS
            if has_all and has_image and host_clock.now() - started_s > least_s:
                break
            host_clock.sleep(0.02)
        self.guide.hold = None
        return host_clock.now()

    def catch_up(self, until_s: float) -> None:
        """Wait until the stream has reached a host time, however long its frames are queued; raises as `hold`."""
        while True:
            newest = self.stream.latest()
            if newest.stream_s + least_delay_s(self.stream.since(until_s - self.max_hold_s).frames) > until_s:
                return
            host_clock.sleep(0.02)

    def wait_for_picture(self) -> None:
        """Wait for a picture of the pad as it is now; raises as `hold`."""
        start = host_clock.now()
        while True:
            self.guard()
            self.reference.latest()
            self.stream.latest()
            seen = self.stream.since(start - self.max_hold_s)
            delay_s = least_delay_s(seen.frames)
            if any(image.stream_s + delay_s > start for image in seen.images):
                return
            host_clock.sleep(0.02)

    def rest(self) -> list[Reading]:
        """Readings of the reference over a short time without contact."""
        self.reference.fresh()
        return self.reference.collect(REST_S)

    def tare_again(self) -> Array:
        """Tare the reference again; returns its total drift since the first tare, (6,).

        Raises
        ------
        RefusedError
            It is not steady although nothing touches it, or its drift is implausibly large.
        """
        self.drift = self.drift + self.reference.tare_change(TARE_S)
        facts = self.reference.facts
        part = np.nan_to_num(abs(self.drift) / facts.full_scale)
        if part.max() > MAX_DRIFT:
            raise RefusedError(f"{facts.name} drifted by {100 * part.max():.1f} % of its range since it was tared: "
                               "let it warm up, check that nothing rests on it, then start again")  # fmt: skip
        return self.drift
