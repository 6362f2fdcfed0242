"""A reference under watch: a thread reads it, tares it, and stops believing it where it must not be believed."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError, NoDeviceError, RefusedError, RuffiniError
from ruffini.rig.reference import AXES, Facts, Reading, Reference
from ruffini.rig.units import likely_mistake

Array = npt.NDArray[np.float64]

SILENCE_PERIODS = 10  # of the stated rate, and never less than
MIN_SILENCE_S = 0.5
MIN_TARE_READINGS = 5
RESTLESS_SIGMAS = 6  # spread of an untouched reference, over its stated uncertainty
SLOW = 0.5  # of the stated rate is too slow
FRESH_READINGS = 2  # the first may have been under way
AXIS_DOMINATES = 0.8  # part of the force that a straight press puts on z


class Watch:
    """Reads a reference until `close`; `latest`, `since` and `tare` may be called from any thread."""

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self.facts: Facts = reference.facts
        self.silence_s = max(MIN_SILENCE_S, SILENCE_PERIODS / self.facts.rate_hz)
        self._readings: list[Reading] = []
        self._zero = np.zeros(6)
        self._error: RuffiniError | None = None
        self._changed, self._stop = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="reference", daemon=True)
        self._thread.start()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop reading and give the device back."""
        self._stop.set()
        self._thread.join()
        self._reference.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                new = self._reference.read(self.silence_s)
            except RuffiniError as error:
                with self._changed:
                    self._error = error
                    self._changed.notify_all()
                return
            with self._changed:
                self._readings += new
                self._changed.notify_all()

    def latest(self) -> Reading:
        """The newest reading, tare taken off.

        Raises
        ------
        NoDeviceError, InputError
            The reference failed, or fell silent.
        RefusedError
            It is saturated.
        """
        deadline = time.monotonic() + self.silence_s + 5.0  # a board that resets when it is opened takes seconds
        with self._changed:
            while not self._readings and self._error is None and time.monotonic() < deadline:
                self._changed.wait(0.1)
            if self._error is not None:
                raise self._error
            if not self._readings:
                raise NoDeviceError(f"{self.facts.name} sends nothing: is it plugged in?")
            newest = self._readings[-1]
        age_s = time.monotonic() - newest.host_s
        if age_s > self.silence_s:
            raise NoDeviceError(f"{self.facts.name} fell silent {age_s:.1f} s ago: is it plugged in?")
        if newest.is_saturated:
            raise RefusedError(
                f"{self.facts.name} is saturated (range {self._range()}): press less, or take a larger one"
            )
        return self._tared(newest)

    def fresh(self, n: int = FRESH_READINGS) -> Reading:
        """The n-th reading from now on: it was measured after this call as a whole; raises as `latest`."""
        with self._changed:
            wanted = len(self._readings) + n
        deadline = time.monotonic() + n * self.silence_s
        while len(self._readings) < wanted and time.monotonic() < deadline:
            self.latest()
            with self._changed:
                self._changed.wait(0.01)
        return self.latest()

    def since(self, host_s: float) -> list[Reading]:
        """Readings received after `host_s`, tare taken off."""
        with self._changed:
            return [self._tared(r) for r in self._readings if r.host_s > host_s]

    def collect(self, duration_s: float) -> list[Reading]:
        """Readings of the next `duration_s`; raises as `latest`."""
        start = time.monotonic()
        while time.monotonic() - start < duration_s:
            self.latest()
            time.sleep(min(0.02, duration_s))
        return self.since(start)

    def tare(self, duration_s: float = 1.0) -> Array:
        """What it reads with nothing on it is zero from now on; returns it, (6,).

        Raises
        ------
        RefusedError
            It is not at rest: it moves more than its stated uncertainty explains, or it is saturated.
        """
        readings = self.collect(duration_s)
        if len(readings) < MIN_TARE_READINGS:
            raise RefusedError(f"{self.facts.name} gave {len(readings)} readings in {duration_s:g} s: "
                               f"{MIN_TARE_READINGS} are needed for a tare: give it more time")  # fmt: skip
        values = np.array([r.wrench for r in readings])
        spread = values.std(axis=0)
        worst = np.nan_to_num(spread / self.facts.sigma).argmax()
        if spread[worst] > RESTLESS_SIGMAS * self.facts.sigma[worst]:
            raise RefusedError(f"{self.facts.name} moves by {spread[worst]:.3g} on {AXES[worst]} while nothing "
                               f"should touch it (stated uncertainty {self.facts.sigma[worst]:.3g}): "
                               "lift off, and keep the bench still")  # fmt: skip
        with self._changed:
            self._zero = self._zero + np.nan_to_num(values.mean(axis=0))
            return self._zero.copy()

    def check_rate(self, readings: Sequence[Reading]) -> float:
        """Readings per second; raises RefusedError where that is half of what is stated, or less."""
        if len(readings) < 2:
            raise RefusedError(f"{self.facts.name} gave {len(readings)} readings: its rate cannot be told")
        rate_hz = (len(readings) - 1) / (readings[-1].host_s - readings[0].host_s)
        if rate_hz < SLOW * self.facts.rate_hz:
            raise RefusedError(f"{self.facts.name} gives {rate_hz:.1f} readings a second instead of "
                               f"{self.facts.rate_hz:g}: check the line, or state the true rate")  # fmt: skip
        return rate_hz

    def _tared(self, reading: Reading) -> Reading:
        return reading._replace(wrench=reading.wrench - self._zero)

    def _range(self) -> str:
        return ", ".join(f"{a} {self.facts.full_scale[AXES.index(a)]:.3g}" for a in self.facts.axes)


def check_unit(facts: Facts, measured_n: float, expected_n: float, tolerance: float = 0.1) -> None:
    """A known weight or a known press must read what it is.

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
    unit = likely_mistake(measured_n, expected_n, facts.unit)
    if unit is not None:
        raise InputError(f"{facts.name} reads {measured_n:.3g} N for {expected_n:.3g} N: "
                         f"it counts in {unit}, not in {facts.unit}: give --unit {unit}")  # fmt: skip
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
                         f"axes are swapped: turn it, or say so with --axes")  # fmt: skip
    if force[2] > 0:
        raise InputError(f"{facts.name} sees a press as +z: it measures the force on itself, or is upside down: "
                         "give --inverted")  # fmt: skip
