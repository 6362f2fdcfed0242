"""The page beside a collection by hand: the real daemon on a pty, a person who is not there, the page in a browser."""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import colours_in, sensor_of, wait_for
from hang import HANG_S
from playwright.sync_api import Page
from test_bench_file import FEW_PICTURES, GRAMS_A_NEWTON, LIMITS, TEXT, Desk, held
from tiny_twin import Twin

from ruffini.rig.emulated_person import EmulatedPerson
from ruffini.rig.emulated_references import EmulatedTextCell
from ruffini.rig.frame_clock import FrameClock
from ruffini.rig.log_file import read_log
from ruffini.rig.manual import HandPress

MINUS = "\u2212"  # as wide as a plus

PATIENCE_S = HANG_S  # with the page; a person who waits for it has more
LONG_S = 600.0
WEIGHT = '[reference]\nkind = "weight"\nsigma_g = 0.1\n'


class SlowPerson:
    """Waits with what a test wants to see on the page until that says so."""

    def __init__(self) -> None:
        self.person = EmulatedPerson(1)
        self.heard: list[str] = []
        self.waiting: queue.Queue[str] = queue.Queue()
        self.shown = ""  # by the scale under the sensor
        self._may = threading.Semaphore(0)

    def hear(self, text: str) -> None:
        asked, is_question, _ = text.partition(", then press Enter")
        self.heard.append(asked)
        if "type what it shows" in asked:
            self.shown = self.person.number(asked)
            self._wait(asked)
            return
        if asked == "hold still":
            self.person.say(asked)
            self._wait(asked)
            return
        if is_question or asked.startswith(("press at", "page: ")):
            self._wait(asked)
        (self.person.confirm if is_question else self.person.say)(asked)

    def _wait(self, asked: str) -> None:
        self.waiting.put(asked)
        assert self._may.acquire(timeout=LONG_S)

    def go_on(self) -> None:
        self._may.release()


class RealPace(FrameClock):
    """Simulated time that leaves the browser time to draw: no faster than real."""

    def next_frame(self) -> int:
        time.sleep(self._period_s)
        return super().next_frame()


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowPerson]:
    """At a terminal that nobody types on."""
    monkeypatch.setattr("ruffini.rig.session.Pace.__new__.__defaults__", (None, 15.0, 8.0, 30.0, FEW_PICTURES))
    monkeypatch.setattr("test_bench_file.FrameClock", RealPace)
    monkeypatch.setitem(HandPress.press.__kwdefaults__, "timeout_s", LONG_S)
    someone = SlowPerson()
    monkeypatch.setattr("ruffini.cli.collect.note", someone.hear)
    reader, writer = os.pipe()
    with os.fdopen(reader) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        yield someone
    os.close(writer)


class Collecting(threading.Thread):
    """`ruffini cal collect --view`, as a person runs it."""

    def __init__(self, run: Callable[[], tuple[int, str, str]], person: SlowPerson, page: Page) -> None:
        super().__init__(daemon=True)
        self._collect, self.person, self.page = run, person, page
        self.code, self.error = -1, ""

    def run(self) -> None:
        self.code, _, self.error = self._collect()

    def words(self) -> Iterator[str]:
        """Each word that the person waits with, once the page shows it; the page is opened as soon as it is there."""
        while self.is_alive() or self.person.waiting.qsize():
            self.page.wait_for_timeout(20)
            if not self.person.waiting.qsize():
                continue
            word = self.person.waiting.get()
            if word.startswith("page: "):
                self.page.goto(word.removeprefix("page: "), timeout=PATIENCE_S * 1e3)
            else:
                shown(self.page, ".guide .said", word)
                yield word
            self.person.go_on()


def shown(page: Page, selector: str, text: str) -> None:
    wait_for(page, f"{text!r} in {selector}", lambda _: text_of(page, selector) == text)


def text_of(page: Page, selector: str) -> str:
    """Text of the first that there is; empty where there is none."""
    return str(page.evaluate("selector => document.querySelector(selector)?.textContent ?? ''", selector))


def start(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, rig: str, person: SlowPerson, page: Page, *words: Any
) -> Collecting:
    out, calibration = desk.folder / "log.h5", desk.folder / "calibration"
    argv = ("collect", "--out", out, "--calibration", calibration, "--view", "--no-browser", "--http-port", 0, *words)
    collecting = Collecting(lambda: desk.run(monkeypatch, rig, *argv), person, page)
    collecting.start()
    return collecting


def force_now(page: Page) -> float:
    return float(text_of(page, ".guide .load output").removesuffix(" N").replace(MINUS, "-"))


def load_state(page: Page) -> str:
    return str(page.evaluate("document.querySelector('.guide .load').dataset.state"))


def row(page: Page, name: str) -> str:
    """A line of what is good or bad right now, its mark first."""
    rows = page.evaluate("[...document.querySelectorAll('.guide tr')].map(row => row.textContent)")
    return next(str(text) for text in rows if name in text)


def test_a_person_is_guided_through_presses_until_they_are_done(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    person: SlowPerson, page: Page,
) -> None:  # fmt: skip
    n_pressed = n_held = 0
    with EmulatedTextCell(1, unit="g", per_newton=GRAMS_A_NEWTON) as cell:
        desk = Desk(twin, tmp_path, person.person, capsys)
        desk.bench.twin.listeners.append(cell.measure)
        with desk.running():
            rig = TEXT.format(port=cell.port) + LIMITS
            collecting = start(desk, monkeypatch, rig, person, page, "--program", "free", "--force-n", 0.8, "--n", 2)
            for word in collecting.words():
                n_pressed, n_held = n_pressed + word.startswith("press"), n_held + (word == "hold still")
                if word.startswith("press") and n_pressed == 1:
                    wait_for(page, "frames", lambda s: sensor_of(s)["wrench"]["validity"][2] == 1)
                    place = word.removeprefix("press at ").split(" with")[0]
                    ring = f"Press in the ring: {place}".replace("-", MINUS).replace("+", "")
                    assert ring in text_of(page, ".guide .where")
                    assert text_of(page, ".guide .counts").startswith("0 of 2 touches")
                    assert colours_in(page, ".guide canvas") > 3
                    assert "✓" in row(page, "flags")
                    assert "✓" in row(page, "frames")
                    assert force_now(page) == pytest.approx(0, abs=0.1)
                elif word == "hold still" and n_held == 1:
                    wait_for(page, "the right force", lambda _: load_state(page) == "right")
                    assert "% off the reference" in row(page, "the sensor's force")
            shown(page, ".guide .said", "Complete.")
            assert page.evaluate("document.querySelector('.guide .stop').hidden")
            end = text_of(page, ".guide .end")
            collecting.join(PATIENCE_S)
    assert collecting.code == 0, collecting.error
    assert f"ruffini cal fit {tmp_path / 'log.h5'} --board" in end
    assert {"harder", "hold still", "good", "let go"} <= set(person.heard)
    assert text_of(page, ".guide .counts").startswith("2 of 2 touches")
    wait_for(page, "the end of the line", lambda s: "The collection has ended" in s["notice"])
    assert len(read_log(tmp_path / "log.h5").touches) == 2


def test_questions_are_answered_on_the_page_and_stop_keeps_what_is_there(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    person: SlowPerson, page: Page,
) -> None:  # fmt: skip
    desk = Desk(twin, tmp_path, person.person, capsys)
    n_taken = 0
    with desk.running():
        words = ("--program", "weights", "--grams", "40,90", "--n", 3)
        collecting = start(desk, monkeypatch, WEIGHT + LIMITS, person, page, *words)
        for word in collecting.words():
            if word.startswith("put 40 g") and not n_taken:
                wait_for(page, "frames", lambda s: sensor_of(s)["wrench"]["validity"])
                page.keyboard.press("z")  # the page only looks on
                wait_for(page, "the refusal", lambda s: "its page only looks on" in s["notice"])
            if word.startswith("put"):
                page.click(".guide .ask button", timeout=PATIENCE_S * 1e3)
            else:
                n_taken += 1
                page.keyboard.press("Enter" if n_taken == 1 else "x")
        shown(page, ".guide .said", "It has ended.")
        collecting.join(PATIENCE_S)
        assert "goes on from there" in text_of(page, ".guide .end.bad")
    assert collecting.code == 4
    assert "stopped" in collecting.error


def test_what_a_kitchen_scale_shows_is_typed_into_the_page(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    person: SlowPerson, page: Page,
) -> None:  # fmt: skip
    """Nonsense and a typing error are refused in one sentence; x and z are no keys while a person types."""
    desk = Desk(twin, tmp_path, person.person, capsys)
    wrong = {0: ("2oo zx", "'2oo zx' is no weight in grams"), 1: ("2000", "2000 g is far from 60 g")}
    shown_g: dict[str, float] = {}  # by what was asked; a press that a busy computer spoils is asked for again
    n_typed = 0
    with desk.running():
        words = ("--program", "scale", "--grams", "60,90", "--n", 2)
        rig = WEIGHT.replace("0.1", "2.0") + LIMITS
        collecting = start(desk, monkeypatch, rig, person, page, *words)
        for word in collecting.words():
            if "type what it shows" in word:
                assert word.startswith(wrong[n_typed - 1][1] if n_typed - 1 in wrong else "press at")
                typed = wrong[n_typed][0] if n_typed in wrong else person.shown
                if n_typed not in wrong:
                    shown_g[word[word.index("press at") :]] = float(typed.replace(",", "."))
                n_typed += 1
                page.wait_for_selector(".guide .typed input:focus", timeout=PATIENCE_S * 1e3)  # drawn after it is told
                page.keyboard.type(typed)
                assert page.input_value(".guide .typed input") == typed
                page.keyboard.press("Enter")
            elif word == "let go":
                assert not page.is_visible(".guide .typed")
                page.click(".guide .ask button", timeout=PATIENCE_S * 1e3)
        shown(page, ".guide .said", "Complete.")
        collecting.join(PATIENCE_S)
    assert collecting.code == 0, collecting.error
    log = read_log(tmp_path / "log.h5")
    assert [t.facts["typed_g"] for t in log.touches] == list(shown_g.values())
    assert "typed" in log.found["clocks"][0]["why_not"]
    for touch, grams in zip(log.touches, (60.0, 90.0), strict=True):
        typed_n = touch.facts["typed_g"] / GRAMS_A_NEWTON
        said_n = -held(touch, "stream_wrench", "stream_host_s")
        print(f"{grams:g} g: typed {typed_n:.3f} N, the sensor says {said_n:.3f} N")
        assert -held(touch, "reference_wrench", "reference_s") == pytest.approx(typed_n)
        assert typed_n == pytest.approx(grams / GRAMS_A_NEWTON, abs=0.02)
        assert said_n == pytest.approx(typed_n, rel=0.3)
