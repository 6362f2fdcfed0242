"""A reference under watch: a thread reads it, tares it, and stops believing it where it must not be believed."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import NoDeviceError, RefusedError, RuffiniError
from ruffini.rig.reference import AXES, Facts, Reading, Reference, lost_packets
from ruffini.wake_event import WakeEvent

Array = npt.NDArray[np.float64]

SILENCE_PERIODS = 10  # of the stated rate, and never less than
MIN_SILENCE_S = 0.5
MIN_TARE_READINGS = 5
RESTLESS_SIGMAS = 6  # spread of an untouched reference, over its stated uncertainty
SLOW = 0.5  # of the stated rate is too slow
FRESH_READINGS = 2  # the first may have been under way


class Watch:
    """Reads a reference until `close`; `latest`, `since` and `tare` may be called from any thread."""

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self.facts: Facts = reference.facts
        self.silence_s = max(MIN_SILENCE_S, SILENCE_PERIODS / self.facts.rate_hz)
        self._readings: list[Reading] = []
        self._zero = np.zeros(6)
        self._error: RuffiniError | None = None
        self._lock, self._changed, self._is_over = threading.Lock(), WakeEvent(), False
        self._thread = threading.Thread(target=self._run, name="reference", daemon=True)
        self._thread.start()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop reading and give the device back."""
        self._is_over = True
        self._thread.join()
        self._reference.close()

    def _run(self) -> None:
        while not self._is_over:
            try:
                new = self._reference.read(self.silence_s)
            except RuffiniError as error:
                self._error = error
                self._changed.set()
                return
            with self._lock:
                self._readings += new
            self._changed.set()
            host_clock.has_heard(new[-1].host_s)

    def latest(self) -> Reading:
        """The newest reading, tare taken off.

        Raises
        ------
        NoDeviceError, InputError
            The reference failed, or fell silent.
        RefusedError
            It is saturated.
        """
        deadline = host_clock.now() + self.silence_s + 5.0  # a board that resets when it is opened takes seconds
        while not self._changed.wait_for(lambda: self._readings or self._error, 0.1) and host_clock.now() < deadline:
            pass
        if self._error is not None:
            raise self._error
        with self._lock:
            newest = self._readings[-1] if self._readings else None
        if newest is None:
            raise NoDeviceError(f"{self.facts.name} sends nothing: is it plugged in?")
        age_s = host_clock.now() - newest.host_s
        if age_s > self.silence_s and not self.facts.is_typed:
            raise NoDeviceError(f"{self.facts.name} fell silent {age_s:.1f} s ago: is it plugged in?")
        if newest.is_saturated:
            raise RefusedError(
                f"{self.facts.name} is saturated (range {self._range()}): press less, or take a larger one"
            )
        return self._tared(newest)

    def fresh(self, n: int = FRESH_READINGS) -> Reading:
        """The n-th reading from now on: it was measured after this call as a whole; raises as `latest`."""
        wanted = len(self._readings) + n
        deadline = np.inf if self.facts.is_typed else host_clock.now() + n * self.silence_s
        while len(self._readings) < wanted and host_clock.now() < deadline:
            self.latest()
            self._changed.wait_for(lambda: len(self._readings) >= wanted, 0.01)
        return self.latest()

    def since(self, host_s: float) -> list[Reading]:
        """Readings received after `host_s`, tare taken off."""
        with self._lock:
            return [self._tared(r) for r in self._readings if r.host_s > host_s]

    def recent(self, duration_s: float) -> list[Reading]:
        """Readings of the last `duration_s`, tare taken off; none where it is silent. Raises nothing."""
        since = host_clock.now() - duration_s
        with self._lock:
            n = next((i for i, r in enumerate(reversed(self._readings)) if r.host_s <= since), len(self._readings))
            return [self._tared(r) for r in self._readings[len(self._readings) - n :]]

    def collect(self, duration_s: float) -> list[Reading]:
        """Readings of the next `duration_s`; raises as `latest`."""
        start = host_clock.now()
        while host_clock.now() - start < duration_s:
            self.latest()
            host_clock.sleep(min(0.02, duration_s))
        return self.since(start)

    def tare(self, duration_s: float = 1.0) -> Array:
        """What it reads with nothing on it is zero from now on; returns it, (6,).

        Raises
        ------
        RefusedError
            It is not at rest: it moves more than its stated uncertainty explains, or it is saturated.
        """
        self.tare_change(duration_s)
        with self._lock:
            return self._zero.copy()

    def tare_change(self, duration_s: float) -> Array:
        """`tare`; returns by how much the zero moved, (6,), 0 for axes that it does not have."""
        start, readings = host_clock.now(), self.collect(duration_s)
        while len(readings) < MIN_TARE_READINGS:
            self.fresh(1)
            readings = self.since(start)
        values = np.array([r.wrench for r in readings])
        spread = values.std(axis=0)
        worst = np.nan_to_num(spread / self.facts.sigma).argmax()
        if spread[worst] > RESTLESS_SIGMAS * self.facts.sigma[worst]:
            raise RefusedError(f"{self.facts.name} moves by {spread[worst]:.3g} on {AXES[worst]} while nothing "
                               f"should touch it (stated uncertainty {self.facts.sigma[worst]:.3g}): "
                               "lift off, and keep the bench still")  # fmt: skip
        change: Array = np.nan_to_num(values.mean(axis=0))
        with self._lock:
            self._zero = self._zero + change
        return change

    @property
    def n_lost(self) -> int | None:
        """Packets without a reading so far, of a reference that numbers them; else None."""
        return lost_packets(self._reference)

    def check_rate(self, readings: Sequence[Reading], n_lost: int = 0) -> float:
        """Readings per second; raises RefusedError where that is half of what is stated, or less.

        n_lost : packets without a reading meanwhile, which the error names where they explain it
        """
        if len(readings) < 2:
            raise RefusedError(f"{self.facts.name} gave {len(readings)} readings: its rate cannot be told")
        rate_hz = (len(readings) - 1) / (readings[-1].host_s - readings[0].host_s)
        if rate_hz < SLOW * self.facts.rate_hz:
            sent_hz = rate_hz * (1 + n_lost / len(readings))
            is_lost = sent_hz >= SLOW * self.facts.rate_hz
            why = "check the line, or state the true rate"
            if is_lost:
                why = f"packets lost or damaged meanwhile: {n_lost}: check the network or the line"
            raise RefusedError(f"{self.facts.name} gives {rate_hz:.1f} readings a second instead of "
                               f"{self.facts.rate_hz:g}: {why}")  # fmt: skip
        return rate_hz

    def _tared(self, reading: Reading) -> Reading:
        return reading._replace(wrench=reading.wrench - self._zero)

    def _range(self) -> str:
        return ", ".join(f"{a} {self.facts.full_scale[AXES.index(a)]:.3g}" for a in self.facts.axes)
