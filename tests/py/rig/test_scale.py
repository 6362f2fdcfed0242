"""A kitchen scale under the sensor: the person types what it shows."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.rig import by_hand
from ruffini.rig.found import estimate
from ruffini.rig.log_file import ACTIVITY, TouchRecord
from ruffini.rig.person import PageKeys, TerminalPerson
from ruffini.rig.placed_weight import PlacedWeight, grams_of
from ruffini.rig.program import ByHand, ScalePress, Span, check_weights, plan
from ruffini.rig.settings import SCALE_MAX_N, scale_rig

SPAN = Span(0.004, 0.003, 0.001, 0.0)
PRESS = ScalePress(0.001, -0.002, 200.0)


@pytest.mark.parametrize(
    ("text", "grams"), [("203", 203.0), ("203,5", 203.5), (" 203.5 g", 203.5), ("0", 0.0), ("12345g", 12345.0)]
)
def test_grams_are_read_as_people_type_them(text: str, grams: float) -> None:
    assert grams_of(text) == grams


@pytest.mark.parametrize("text", ["", "g", "-203", "2e2", "nan", "1.203,5", "203 kg", "٢٠٠", "2 03", "9" * 400, "1..2"])
def test_what_is_no_weight_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(InputError, match="is no weight in grams: type what the scale shows") as caught:
        grams_of(text)
    assert len(str(caught.value)) < 120


class Typist:
    """Types one text after the other."""

    def __init__(self, *texts: str) -> None:
        self.texts, self.heard = list(texts), list[str]()

    def say(self, text: str) -> None:
        self.heard.append(text)

    confirm = say

    def number(self, text: str) -> str:
        self.heard.append(text)
        return self.texts.pop(0)


def pressed(*texts: str, weight: PlacedWeight | None, max_force_n: float = 10.0) -> tuple[dict[str, Any], list[str]]:
    person, read = Typist(*texts), list[float]()

    def hold(started_s: float, least_s: float = 0.5) -> float:
        if not least_s:  # of the untouched pad, before the press
            return started_s
        assert weight is not None
        read.append(-weight.read(0.0)[0].wrench[2])
        return started_s + 0.5

    bench: Any = SimpleNamespace(
        person=person, weight=weight, max_force_n=max_force_n, hold=hold, rest=lambda: [],
        reference=SimpleNamespace(fresh=lambda: None),
    )  # fmt: skip
    facts = by_hand.scale(bench, PRESS, [])
    assert person.heard.pop(0) == "wait: a picture of the untouched pad is taken"
    return {**facts, "read_n": read[0], "after_n": -weight.read(0.0)[0].wrench[2] if weight else None}, person.heard


def test_the_reference_has_what_was_typed_while_it_is_held_and_nothing_after() -> None:
    facts, heard = pressed("203,5", weight=PlacedWeight(2.0))
    assert facts["typed_g"] == 203.5
    assert facts["read_n"] == pytest.approx(0.2035 * 9.80665)
    assert facts["after_n"] == 0
    assert heard == [
        "press at x +1.0, y -2.0 mm until the scale shows about 200 g, keep pressing, and type what it shows, in grams",
        "hold still", "let go",
    ]  # fmt: skip


def test_nonsense_and_typing_errors_are_asked_again() -> None:
    facts, heard = pressed("abc", "2000", "20", "", "198", weight=PlacedWeight(2.0))
    assert facts["typed_g"] == 198
    starts = [
        "press at",
        "'abc' is no weight",
        "2000 g is far from 200 g: press again",
        "20 g is far",
        "'' is no weight",
    ]
    assert [h.startswith(s) for h, s in zip(heard, starts, strict=False)] == [True] * 5


def test_too_hard_a_press_ends_it_and_another_reference_is_refused() -> None:
    with pytest.raises(RefusedError, match=r"1\.96 N, more than the 1\.5 N allowed: let go"):
        pressed("200", weight=PlacedWeight(2.0), max_force_n=1.5)
    with pytest.raises(InputError, match="give --rig scale"):
        pressed("200", weight=None)


def record(moved: list[float], **arrays: Any) -> TouchRecord:
    n = len(moved)
    facts = {"kind": "scale", "held_host_s": 0.5, "lifted_host_s": n - 1.5, "session": "a"}
    times = np.arange(n, dtype=float)
    return TouchRecord(facts, {"stream_s": times, "stream_host_s": times, "reference_s": times,
                               "stream_wrench": np.full((n, 6), np.nan), "reference_wrench": np.zeros((n, 6)),
                               "stage_place": np.zeros((0, 3)), ACTIVITY: np.array(moved), **arrays})  # fmt: skip


def test_a_press_that_changes_while_the_scale_is_read_is_done_again() -> None:
    assert PRESS.faults(record([0, 2.0, 2.1, 1.95, 0])) == []
    assert PRESS.faults(record([0, 2.0, 3.0, 2.0, 0])) == ["the press changed by 43 % while it was held"]


def test_where_no_markers_are_seen_the_force_tells_a_change() -> None:
    force = np.zeros((5, 6))
    force[1:4, 2] = [-1, -1.5, -1]
    touch = record([0] * 5, stream_wrench=force)
    del touch.arrays[ACTIVITY]
    assert PRESS.faults(touch) == ["the press changed by 43 % while it was held"]


def test_a_typed_reference_tells_nothing_of_the_clocks() -> None:
    found = estimate([record([0, 2, 2, 2, 0])], {"sigma": [0, 0, 0.02, 0, 0, 0]})
    assert "typed" in found["clocks"][0]["why_not"]


def test_no_file_is_needed() -> None:
    settings = scale_rig()
    reference = settings.reference.open()
    assert reference.facts.axes == ("fz",)
    assert reference.facts.sigma[2] == pytest.approx(0.0196, abs=1e-4)
    grams = (50.0, 100.0)
    items = plan("scale", SPAN, 3, 1, ByHand(grams))
    assert [item.grams for item in items if isinstance(item, ScalePress)] == [50.0, 100.0, 50.0]
    assert settings.limits.max_force_n == SCALE_MAX_N


@pytest.mark.parametrize("grams", [(), (0.0,), (50.0, float("nan")), (float("inf"),), (2e4,)])
def test_weights_that_nobody_can_press_are_refused(grams: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="needs weights of more than 0 and less than 20000 g"):
        plan("scale", SPAN, 3, 1, ByHand(grams))


def test_a_weight_beyond_the_force_limit_is_refused_before_anything_is_pressed() -> None:
    check_weights(plan("scale", SPAN, 3, 1, ByHand((20.0, 200.0))), 10.0)
    with pytest.raises(InputError, match=r"grams: 2000 g is a press of 19.6 N, more than the 10 N"):
        check_weights(plan("scale", SPAN, 3, 1, ByHand((20.0, 2000.0))), 10.0)


def asked(*keys: bytes) -> tuple[str, list[str]]:
    reader, writer = os.pipe()
    said = list[str]()
    os.write(writer, b"".join(keys))
    os.close(writer)
    with os.fdopen(reader) as keyboard:
        return TerminalPerson(said.append, keyboard.fileno()).number("how much"), said


def test_a_number_is_typed_at_the_terminal() -> None:
    assert asked(b"20x", b"\x7f", b"3,5\n9\n") == ("203,5", ["how much, then press Enter (q stops)"])
    with pytest.raises(RefusedError, match="stopped by a key at 'how much'"):
        asked(b"20q")
    with pytest.raises(RefusedError, match="because nobody answers"):
        asked(b"203")


@pytest.mark.parametrize(
    ("typed", "read"), [("203,5", "203,5"), ("q\n", "??"), ("1\r2", "1?2"), ("é", "?"), ("1" * 99, "1" * 20)]
)
def test_a_page_types_numbers_and_nothing_else(typed: str, read: str) -> None:
    keys = PageKeys()
    try:
        keys.press(is_stop=False, typed=typed)
        assert TerminalPerson(lambda _: None, keys.descriptor).number("how much") == read
    finally:
        keys.close()


def test_a_sensor_that_is_lost_ends_the_question() -> None:
    reader, writer = os.pipe()
    looks = list[int]()

    def watch() -> None:
        looks.append(1)
        if len(looks) == 2:
            raise NoDeviceError("the line was lost")

    with os.fdopen(reader), os.fdopen(writer, "wb"), pytest.raises(NoDeviceError, match="the line was lost"):
        TerminalPerson(lambda _: None, reader, watch=watch).number("press")
