"""What a touch needs: stage or person, reference, stream, and who may stop it all."""

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
from ruffini.rig.placed_weight import PlacedWeight
from ruffini.rig.program import HOLD_S, Tool
from ruffini.rig.reference import Reading
from ruffini.rig.stage import Guard, nobody
from ruffini.rig.stream_watch import StreamWatch
from ruffini.rig.touch import LONGEST_GAP_S, MIN_FRAMES, MIN_READINGS, least_delay_s
from ruffini.rig.watch import Watch

Array = npt.NDArray[np.float64]

REST_S = 0.3
MAX_HOLD_S = 10.0  # for a slow reference, a slow camera, a slow line that brings a picture
TARE_S = 0.15


class Person(Protocol):
    """Somebody who does what is said."""

    def say(self, text: str) -> None:
        """A line for them."""

    def confirm(self, text: str) -> None:
        """Ask, and wait until they have done it.

        Raises
        ------
        RefusedError
            They said no, or nobody is there.
        """


@dataclass
class Bench:
    """A bench that is connected, homed and at rest."""

    reference: Watch
    stream: StreamWatch
    bad_flags: dict[int, str]  # bits that spoil a frame, and what they are called
    person: Person
    max_force_n: float
    stage: GuardedStage | None = None
    guard: Guard = nobody  # the stop key, and the force that the sensor measures
    weight: PlacedWeight | None = None  # the reference, where that is a weight
    session: str = ""
    longest_gap_s: float = LONGEST_GAP_S
    max_hold_s: float = MAX_HOLD_S
    mount: Callable[[Tool], None] | None = None  # puts an indenter there; None: the person is asked
    drift: Array = field(default_factory=lambda: np.zeros(6))  # of the reference, since it was first tared
    guide: Guide = field(default_factory=Guide)  # what it is at, for whoever looks on

    def put_on(self, tool: Tool) -> None:
        """Another indenter hangs on the stage; raises RefusedError where nobody puts it there."""
        if self.mount is not None:
            self.mount(tool)
        else:
            self.person.confirm(f"put on: {tool.told()}")

    def need_stage(self) -> GuardedStage:
        """The stage; raises InputError where there is none."""
        if self.stage is None:
            raise InputError("this program needs a stage: add [stage] to the bench's file, or use weights or free")
        return self.stage

    @contextlib.contextmanager
    def safely(self) -> Iterator[None]:
        """Whatever goes wrong inside lifts the tip."""
        with self.stage.safely() if self.stage else contextlib.nullcontext():
            yield

    def hold(self, started_s: float, least_s: float = HOLD_S) -> float:
        """Wait until enough was seen since `started_s`, `least_s` at least; the time at which it ends.

        Raises
        ------
        NoDeviceError, RefusedError
            Sensor or reference went away or is saturated, or a guard says stop.
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
        """Wait until the stream shows a time of the host, however long its frames queue; raises as `hold`."""
        while True:
            newest = self.stream.latest()
            if newest.stream_s + least_delay_s(self.stream.since(until_s - self.max_hold_s).frames) > until_s:
                return
            host_clock.sleep(0.02)

    def rest(self) -> list[Reading]:
        """Readings of a moment in which nothing touches."""
        self.reference.fresh()
        return self.reference.collect(REST_S)

    def tare_again(self) -> Array:
        """Take off what the reference drifted by since the last touch; all of it since the first tare, (6,).

        Raises
        ------
        RefusedError
            It moves while nothing should touch it, or drifted further than can be believed.
        """
        self.drift = self.drift + self.reference.tare_change(TARE_S)
        facts = self.reference.facts
        part = np.nan_to_num(abs(self.drift) / facts.full_scale)
        if part.max() > MAX_DRIFT:
            raise RefusedError(f"{facts.name} drifted by {100 * part.max():.1f} % of its range since it was tared: "
                               "let it warm up, look what hangs on it, then start again")  # fmt: skip
        return self.drift
