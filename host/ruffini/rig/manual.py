"""Pressing by hand: instructs where and how hard, and detects the right force."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import RefusedError
from ruffini.rig.stage import Guard, no_guard

Array = npt.NDArray[np.float64]
Say = Callable[[str], None]
Holds = Callable[[float | None, float], None]  # since when the force is right (None: it is not), and how long it has to

POLL_S = 0.02
FREE_PART = 0.25  # of the smallest target: nothing presses


@dataclass(frozen=True)
class Target:
    """A press that is wanted: place on the pad, force, and how near is near enough."""

    x_m: float
    y_m: float
    force_n: float
    tolerance_n: float
    hold_s: float = 0.5


class HandPress:
    """Guides a person through one press after the other; forces are the reference's, ON the pad."""

    def __init__(
        self, force_of: Callable[[], Array], max_force_n: float, say: Say, holds: Holds = lambda _since, _for: None
    ) -> None:
        self._force_of, self._max_force_n, self._say, self._holds = force_of, max_force_n, say, holds
        self._said = ""

    def press(self, target: Target, *, timeout_s: float = 60.0, guard: Guard = no_guard) -> tuple[float, float]:
        """Wait for the press; start and end (host_clock.now()) of the time in which the force was right.

        Raises
        ------
        RefusedError
            Pressed too hard, or not in time.
        """
        place = f"x {1e3 * target.x_m:+.1f}, y {1e3 * target.y_m:+.1f} mm"
        deadline, since = host_clock.now() + timeout_s, None
        while (now := host_clock.now()) < deadline:
            guard()
            pressed_n = self._pressed_n()
            short_n = target.force_n - pressed_n
            if pressed_n < FREE_PART * target.force_n:
                since = None
                self._told(f"press at {place} with {target.force_n:.2f} N")
            elif abs(short_n) > target.tolerance_n:
                since = None
                self._told("harder" if short_n > 0 else "softer")
            elif since is None:
                since = now
                self._told("hold still")
            elif now - since >= target.hold_s:
                self._told("good")
                return since, now
            self._holds(since, target.hold_s)
            host_clock.sleep(POLL_S)
        raise RefusedError(f"no steady press of {target.force_n:.2f} +- {target.tolerance_n:.2f} N at {place} within "
                           f"{timeout_s:g} s: press with something heavier, or allow more")  # fmt: skip

    def release(self, free_n: float, *, timeout_s: float = 60.0, guard: Guard = no_guard) -> None:
        """Wait until nothing presses."""
        deadline = host_clock.now() + timeout_s
        while self._pressed_n() > free_n:
            guard()
            self._told("let go")
            if host_clock.now() > deadline:
                raise RefusedError(f"{self._pressed_n():.2f} N still press: take everything off the pad, and tare")
            host_clock.sleep(POLL_S)

    def _pressed_n(self) -> float:
        pressed_n = max(0.0, -float(self._force_of()[2]))
        if pressed_n > self._max_force_n:
            self._told(f"STOP: {pressed_n:.2f} N")
            raise RefusedError(f"pressed with {pressed_n:.2f} N, more than the {self._max_force_n:g} N allowed: let go")
        return pressed_n

    def _told(self, text: str) -> None:
        """Say it once, not at every reading."""
        if text != self._said:
            self._say(text)
        self._said = text
