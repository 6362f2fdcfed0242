"""A watched reference: tare, silence, saturation, rate, units and axes."""

from __future__ import annotations

import contextlib
import threading
import time

import numpy as np
import pytest
from hang import HANG_S, until

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.rig import watch as watch_module
from ruffini.rig.checks import check_axes, check_unit
from ruffini.rig.placed_weight import PlacedWeight
from ruffini.rig.reference import Facts, Reading, pressing
from ruffini.rig.turned import Turned
from ruffini.rig.watch import Watch

FACTS = Facts.of_one_axis("cell", 10, 0.01, 100, "N")


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A computer that gives the reading thread no time for half a second makes no reference silent."""
    monkeypatch.setattr(watch_module, "MIN_SILENCE_S", HANG_S)


def is_silent(watch: Watch) -> bool:
    """Never: silence is an error."""
    watch.latest()
    return False


class Scripted:
    """A reference whose force is what the test says; None = silent."""

    facts = FACTS

    def __init__(self, force_n: float | None = 0.3, noise_n: float = 0.002, period_s: float = 0.01) -> None:
        self.force_n, self.noise_n, self.period_s, self.is_saturated = force_n, noise_n, period_s, False
        self.is_closed = False
        self._rng = np.random.default_rng(1)

    def read(self, timeout_s: float) -> list[Reading]:
        time.sleep(self.period_s)
        pressed_n = self.force_n
        if pressed_n is None:
            time.sleep(timeout_s)
            raise NoDeviceError("cell sends nothing")
        force = pressed_n + self.noise_n * self._rng.normal()
        return [Reading(time.monotonic(), pressing(force), self.is_saturated)]

    def close(self) -> None:
        self.is_closed = True


def test_tare_makes_rest_zero_and_is_kept(patient):
    cell = Scripted()
    with Watch(cell) as watch:
        assert watch.tare(0.2)[2] == pytest.approx(0.3, abs=0.005)
        cell.force_n = -0.7
        until(lambda: watch.latest().wrench[2] == pytest.approx(-1, abs=0.02), "1 N")
        assert np.isnan(watch.latest().wrench[0])
    assert cell.is_closed


def test_restless_reference_is_not_tared(patient):
    with Watch(Scripted(noise_n=0.2)) as watch, pytest.raises(RefusedError, match=r"moves by .* on fz while nothing"):
        watch.tare(0.2)


def test_a_saturated_reference_is_not_believed(patient):
    cell = Scripted()
    with Watch(cell) as watch:
        watch.latest()
        cell.is_saturated = True
        with pytest.raises(RefusedError, match=r"saturated \(range fz 10\)"):
            until(lambda: not watch.latest(), "the refusal")


class Busy(PlacedWeight):
    """Its thread gets a core only for its first reading, and when the test lets it go on."""

    def __init__(self) -> None:
        super().__init__(2.0)
        self.go_on, self.n_read = threading.Event(), 0

    def read(self, timeout_s: float) -> list[Reading]:
        if self.n_read:
            self.go_on.wait(HANG_S)
        self.n_read += 1
        return super().read(timeout_s)


def test_a_typed_weight_stands_however_busy_the_computer_is(monkeypatch):
    now_s, weight = [100.0], Busy()
    monkeypatch.setattr(host_clock, "now", lambda: now_s[0])
    with Watch(weight) as watch, contextlib.ExitStack() as at_end:
        at_end.callback(weight.go_on.set)
        assert watch.latest().wrench[2] == 0
        now_s[0] += 100
        assert watch.latest().wrench[2] == 0
        weight.place(100)
        threading.Timer(0.05, weight.go_on.set).start()
        assert watch.fresh().wrench[2] == pytest.approx(-0.981, abs=0.001)


def test_a_silent_reference_is_not_believed():
    cell = Scripted()
    with Watch(cell) as watch:
        cell.force_n = None
        with pytest.raises(NoDeviceError, match=r"silent|sends nothing"):
            until(lambda: is_silent(watch), "the silence")


def test_slow_reference_is_named(patient):
    with Watch(Scripted(period_s=0.05)) as watch:
        readings = watch.collect(0.4)
        with pytest.raises(RefusedError, match="instead of 100: check the line, or state the true rate"):
            watch.check_rate(readings)
        with pytest.raises(RefusedError, match="instead of 100: check the line, or state the true rate"):
            watch.check_rate(readings, 1)  # not because of that one
        with pytest.raises(RefusedError, match="100: packets lost or damaged meanwhile: 1000: check the net"):
            watch.check_rate(readings, 1000)


@pytest.mark.parametrize("n_lost", [None, 3])
def test_lost_packets_are_known_where_the_reference_numbers_them(n_lost: int | None, patient: None) -> None:
    cell = Scripted()
    if n_lost is not None:
        cell.n_lost = n_lost  # type: ignore[attr-defined]
    with Watch(Turned(cell, np.eye(3))) as watch:
        assert watch.n_lost == n_lost


@pytest.mark.parametrize(
    ("ratio", "unit"), [(1 / 4.4482, "lb"), (1 / 9.80665, "kg"), (1 / 9.80665e-3, "g"), (1000, "mN")]
)
def test_wrong_unit_is_recognised(ratio, unit):
    with pytest.raises(InputError, match=f"counts in {unit}, not in N"):
        check_unit(FACTS, 2 * ratio, 2)


def test_right_unit_passes_and_a_wrong_scale_is_not_taken_for_a_unit():
    check_unit(FACTS, 2.1, 2)
    with pytest.raises(RefusedError, match="no other unit explains it"):
        check_unit(FACTS, 3.1, 2)


@pytest.mark.parametrize(
    ("force", "sentence"),
    [([1, 0, 0.1], r"on \+x instead of -z"), ([0, -1, 0], "on -y"), ([0, 0, 1], "as \\+z"), ([0.7, 0, -0.7], "askew")],
)
def test_swapped_axes_are_named(force, sentence):
    with pytest.raises(InputError, match=sentence):
        check_axes(FACTS, np.array([*force, 0, 0, 0], float))


def test_right_axes_pass():
    check_axes(FACTS, np.array([0.1, 0, -1, 0, 0, 0]))
    check_axes(FACTS, pressing(-1))
