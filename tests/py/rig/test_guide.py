"""What a page is told beside a collection, and what a person's answers do."""

from __future__ import annotations

import json
import os
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ruffini import host_clock
from ruffini.errors import RefusedError
from ruffini.rig import guide_view
from ruffini.rig.guide import KEPT_FAULTS, Guide
from ruffini.rig.guide_view import HeardPerson
from ruffini.rig.person import PageKeys, TerminalPerson
from ruffini.rig.program import CONDITIONS, Condition, HandTouch, Touch, Weight
from ruffini.rig.reference import Reading
from ruffini.rig.stream_watch import StreamSample

DARK = 16
VALID, UNCALIBRATED, NOT_MEASURED = 1, 2, 0
ITEMS = [HandTouch(0.001, -0.002, 1.0), Weight(0.003, 0.0, 50.0), Touch(0.0, 0.004, 0.0005)]


class Still(host_clock.RealTime):
    """Time that does not pass."""

    def now(self) -> float:
        return 100.0


@pytest.fixture(autouse=True)
def still():
    with host_clock.lent(Still()):
        yield


def bench(
    reference_n: float | None, sensor_n: float, flags: int = 0, validity: int = VALID, *, is_saturated: bool = False
) -> Any:
    """One that was pressed so for a second."""
    now = host_clock.now()
    times = now - 0.9 + 0.1 * np.arange(10)

    def pressed(force_n: float) -> np.ndarray:
        return np.array([0, 0, -force_n, 0, 0, 0])

    frames = [StreamSample(t, t, i, flags, pressed(sensor_n), (validity,) * 6) for i, t in enumerate(times)]
    readings = [] if reference_n is None else [Reading(t, pressed(reference_n), is_saturated) for t in times]
    return SimpleNamespace(
        stream=SimpleNamespace(recent=lambda _: frames, stall_s=2.0),
        reference=SimpleNamespace(
            recent=lambda s: [r for r in readings if r.host_s > now - s], silence_s=0.5,
            facts=SimpleNamespace(full_scale=np.array([20, 20, 20, np.nan, np.nan, np.nan])),
        ),
        drift=np.array([0, 0, 0.4, 0, 0, 0]), bad_flags={DARK: "dark", 32: "over_range"}, weight=None,
    )  # fmt: skip


def told(guide: Guide, at: Any = None) -> dict[str, Any]:
    """As it goes to the page: no NaN, nothing that is not JSON."""
    return json.loads(json.dumps(guide_view.told(guide, at), allow_nan=False))


def rows(at: Any) -> dict[str, tuple[bool | None, str]]:
    return {row["name"]: (row["ok"], row["text"]) for row in told(Guide(), at)["quality"]}


def test_a_plan_is_told_with_what_is_kept_and_what_is_next() -> None:
    guide = Guide()
    assert told(guide)["touches"] == []
    guide.begin(ITEMS, [2])
    guide.touch(0)
    state = told(guide)
    assert state["touches"] == [[1.0, -2.0, 0], [3.0, 0.0, 0], [0.0, 4.0, 1]]
    assert (state["n_done"], state["n_total"], state["target"]) == (1, 3, [1.0, -2.0])
    assert "nothing may touch" in state["said"]
    guide.bad(0, "no frame for 1.00 s")
    guide.touch(0)
    guide.good(0)
    state = told(guide)
    assert (state["n_done"], state["n_redone"], state["target"], state["load"]) == (2, 1, None, None)
    assert state["set_aside"] == ["press by hand at x +1.0, y -2.0 mm with 1.00 N: no frame for 1.00 s"]
    guide.doubt([0, 2])
    assert told(guide)["n_done"] == 0
    for _ in range(20):
        guide.bad(1, "dark")
    assert len(told(guide)["set_aside"]) == KEPT_FAULTS
    guide.touch(2)
    assert "hands off" in guide.said


def test_the_force_now_is_told_beside_what_is_wanted() -> None:
    guide = Guide()
    guide.begin([*ITEMS, Condition(CONDITIONS[0], 2.0, 0.01, 4.0)], [])
    guide.touch(0)
    assert told(guide, bench(0.7, 0.6))["load"] == pytest.approx(
        {"unit": "N", "low": 0.85, "high": 1.15, "now": 0.7, "sensor": 0.6}
    )
    assert told(guide, bench(None, 0.6, validity=UNCALIBRATED))["load"]["now"] is None
    assert told(guide, bench(0.7, 0.6, validity=UNCALIBRATED))["load"]["sensor"] is None
    guide.touch(1)
    assert told(guide, bench(0.0, 0.0))["load"]["low"] == pytest.approx(0.9 * 0.05 * 9.80665)
    guide.touch(2)
    assert told(guide, bench(0.7, 0.6))["load"] is None  # a machine presses
    guide.touch(3)
    assert told(guide, bench(1.0, 0.6))["load"] == {"unit": "%", "low": 40.0, "high": 100.0, "now": 25.0,
                                                    "sensor": None}  # fmt: skip


def test_how_long_it_is_held() -> None:
    guide = Guide()
    assert told(guide)["held"] is None
    guide.hold = (host_clock.now() - 1.0, 2.0)
    assert told(guide)["held"] == 0.5
    guide.hold = (host_clock.now() - 9.0, 2.0)
    assert told(guide)["held"] == 1


def test_what_is_good_and_what_is_not() -> None:
    good = rows(bench(1.0, 0.9))
    assert good["reference"] == (True, "1.000 N, readings 10/s")
    assert good["frames"] == (True, "10/s, 100 % good")
    assert good["flags"] == (True, "none")
    assert good["stillness"][0]
    assert good["the sensor's force"] == (None, "0.900 N, -10 % off the reference")
    assert good["drift of the reference"] == (True, "2.0 % of its range since it was tared")
    assert rows(bench(1.0, 0.9, DARK))["flags"] == (False, "dark")
    assert rows(bench(1.0, 0.9, DARK))["frames"] == (False, "10/s, 0 % good")
    assert rows(bench(None, 0.9))["reference"] == (False, "silent: is it plugged in?")
    assert rows(bench(20.0, 0.9, is_saturated=True))["reference"][0] is False
    assert rows(bench(1.0, 0.9, validity=NOT_MEASURED))["the sensor's force"] == (None, "not measured yet")
    assert "not calibrated" in rows(bench(1.0, 0.9, validity=UNCALIBRATED))["the sensor's force"][1]
    moving = bench(1.0, 0.9)
    readings = moving.reference.recent(9.0)
    moving.reference.recent = lambda _: [r._replace(wrench=r.wrench * (1 + 0.1 * i)) for i, r in enumerate(readings)]
    assert rows(moving)["stillness"][0] is False
    moving.weight = object()  # it is said to lie there: the sensor knows whether it does
    assert rows(moving)["stillness"][0] is True
    assert rows(bench(0.01, 0.0))["stillness"][0] is None  # nothing presses


class Silent:
    def __init__(self) -> None:
        self.heard: list[str] = []
        self.was_asked: list[bool] = []

    def say(self, text: str) -> None:
        self.heard.append(text)

    def confirm(self, text: str) -> None:
        self.heard.append(text)
        raise RefusedError(text)


def test_a_question_is_open_until_it_is_answered_and_words_reach_person_and_page() -> None:
    guide, person = Guide(), Silent()
    heard = HeardPerson(person, guide, lambda: None)
    heard.say("harder")
    assert (guide.said, told(guide)["asked"]) == ("harder", 0)
    with pytest.raises(RefusedError):
        heard.confirm("put 20 g")
    assert (guide.n_asked, guide.is_asked, guide.said) == (1, False, "put 20 g")
    assert person.heard == ["harder", "put 20 g"]


@pytest.fixture
def keyboard():
    reader, writer = os.pipe()
    yield reader, writer
    os.close(reader)


def test_terminal_or_page_answer_whichever_is_first(keyboard) -> None:
    reader, writer = keyboard
    keys = PageKeys()
    person = TerminalPerson(lambda _: None, reader, keys)
    keys.press(is_stop=False)
    person.confirm("put 20 g")
    os.write(writer, b"\n")
    person.confirm("take it away")
    late = threading.Timer(0.05, lambda: keys.press(is_stop=True))
    late.start()
    with pytest.raises(RefusedError, match="stopped by a key"):
        person.confirm("put 50 g")
    os.close(writer)  # nobody at the terminal: the page alone
    keys.press(is_stop=False)
    person.confirm("put 50 g")
    alone = TerminalPerson(lambda _: None, reader)
    with pytest.raises(RefusedError, match="nobody answers"):
        alone.confirm("put 50 g")
    keys.close()


def test_what_a_page_pressed_before_a_question_does_not_answer_it(keyboard) -> None:
    reader, writer = keyboard
    keys, guide = PageKeys(), Guide()
    heard = HeardPerson(TerminalPerson(lambda _: None, reader, keys), guide, keys.guard)
    os.write(writer, b"\n")
    heard.confirm("put 20 g")
    keys.press(is_stop=False)  # both answered it
    os.write(writer, b"x")
    with pytest.raises(RefusedError, match="stopped by a key at 'put 50 g'"):
        heard.confirm("put 50 g")
    keys.press(is_stop=True)
    with pytest.raises(RefusedError, match="from the page"):
        heard.confirm("put 50 g")
    assert guide.n_asked == 2
    os.close(writer)
    keys.close()


def test_a_page_that_presses_without_end_neither_fails_nor_hides_its_stop() -> None:
    keys = PageKeys()
    keys.press(is_stop=True)
    for _ in range(100_000):
        keys.press(is_stop=False)
    with pytest.raises(RefusedError, match="from the page"):
        keys.guard()
    keys.guard()
    keys.close()


def test_the_pages_stop_stops_between_questions_and_its_done_does_not() -> None:
    keys = PageKeys()
    keys.guard()
    keys.press(is_stop=False)
    keys.guard()
    keys.press(is_stop=True)
    with pytest.raises(RefusedError, match="from the page"):
        keys.guard()
    keys.guard()
    keys.close()
