"""A reference is looked at before the first touch; axes that a bench's file turns; the person at the terminal."""

from __future__ import annotations

import os
import pty
import time
import tty

import numpy as np
import pytest

from ruffini.errors import InputError, RefusedError
from ruffini.rig.checks import _compare, _weigh
from ruffini.rig.person import TerminalPerson
from ruffini.rig.reference import Facts, Reading, pressing
from ruffini.rig.turned import Turned, turn_of

FACTS = Facts("cell", np.full(6, 20.0), np.array([0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4]), 100, "N")


class Scale:
    """A bench whose reference shows what a person put on it, times a gain."""

    def __init__(self, gain: float) -> None:
        self.gain, self.grams, self.told = gain, 0.0, []
        self.person = self
        self.reference = self
        self.facts = FACTS

    def confirm(self, text: str) -> None:
        self.told.append(text)
        self.grams = float(text.split()[1]) if text.startswith("put") else 0.0

    def rest(self) -> list[Reading]:
        return [Reading(0.0, pressing(-self.gain * 9.80665e-3 * self.grams))]


def test_a_known_weight_tells_the_unit():
    bench = Scale(1.0)
    assert _weigh(bench, 100.0)["ok"]
    assert bench.told == ["put 100 g on the middle of the pad", "take the weight away"]
    with pytest.raises(InputError, match="it counts in lb, not in N: give unit = 'lb'"):
        _weigh(Scale(1 / 4.4482), 100.0)
    with pytest.raises(RefusedError, match="no other unit explains it"):
        _weigh(Scale(1.4), 100.0)


def test_a_sensor_that_is_yet_to_be_calibrated_tells_only_gross_mistakes():
    assert _compare(FACTS, 1.0, 0.75)["ok"] is True
    assert _compare(FACTS, 1.0, float("nan"))["ok"] is None
    assert _compare(FACTS, 1.0, 0.5)["ok"] is False
    with pytest.raises(InputError, match="seems to count in lb"):
        _compare(FACTS, 1.0, 4.1)
    with pytest.raises(InputError, match="seems to count in g"):
        _compare(FACTS, 100.0, 1.1)


class Six:
    """A six-axis reference that reads 1 2 3 4 5 6."""

    facts = FACTS
    is_closed = False

    def read(self, timeout_s: float) -> list[Reading]:
        return [Reading(time.monotonic(), np.arange(1.0, 7.0))]

    def close(self) -> None:
        self.is_closed = True


def test_axes_that_the_benchs_file_turns():
    six = Six()
    turned = Turned(six, turn_of(["+y", "-x", "+z"]))
    assert turned.read(1.0)[0].wrench.tolist() == [2, -1, 3, 5, -4, 6]
    assert turned.facts.sigma.tolist() == [0.02, 0.01, 0.03, 2e-4, 1e-4, 3e-4]
    assert Turned(six, turn_of(["+x", "+y", "+z"], is_inverted=True)).read(1.0)[0].wrench[2] == -3
    elsewhere = Turned(six, turn_of(["+x", "+y", "+z"]), (0.0, 0.0, 0.1)).read(1.0)[0].wrench
    assert elsewhere == pytest.approx([1, 2, 3, 4 + 0.2, 5 - 0.1, 6])  # a tenth of a metre below the pad's centre
    turned.close()
    assert six.is_closed
    for axes in (["+x", "+x", "+z"], ["+x", "+y", "-z"]):
        with pytest.raises(InputError, match="are no turn"):
            turn_of(axes)


def test_enter_goes_on_another_key_or_nobody_stops():
    master, slave = pty.openpty()
    tty.setraw(slave)
    said: list[str] = []
    person = TerminalPerson(said.append, slave)
    os.write(master, b"\r")
    person.confirm("put 20 g")
    assert said == ["put 20 g, then press Enter (any other key stops)"]
    os.write(master, b"q")
    with pytest.raises(RefusedError, match="stopped by a key at 'take it away'"):
        person.confirm("take it away")
    os.close(master)
    os.close(slave)
    reader, writer = os.pipe()
    os.close(writer)
    with pytest.raises(RefusedError, match="nobody answers"):
        TerminalPerson(said.append, reader).confirm("put 20 g")
    os.close(reader)
