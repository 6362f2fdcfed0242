"""First newtons in the page alone: the real daemon, viewer and page; an emulated person reads the page and presses."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Evaluates, sensor_of, viewer, wait_for
from hang import HANG_S, Patience
from playwright.sync_api import Page
from test_bench_file import FEW_PICTURES, Desk
from test_kitchen_scale import STIFFER, Truth
from tiny_twin import Twin

from ruffini import host_clock
from ruffini.boards import find_board
from ruffini.daemon import Daemon, started_daemon
from ruffini.device import Connection
from ruffini.estimators.wrench.log import read_feature_runs
from ruffini.rig.emulated_person import EmulatedPerson
from ruffini.rig.frame_clock import FrameClock
from ruffini.sim.unit import TwinUnit
from ruffini.sim.units import build_unit
from ruffini.view.calibrating_line import CalibratingLine
from ruffini.view.scale_calibration import ScaleCalibration

FASTER = 12.0  # than real
SETTLED_FRAMES = 5
LOOK_S = 0.04  # between two looks at what the page asks
BALL_MM = 6.0  # of `Desk`
ERROR_TOUCHES = 40  # behind an uncertainty that these tests do not judge
MOST_ROUNDS = 3  # of presses after the first
JUDGED = ((70.0, "x +1.5, y -1.0 mm"), (110.0, "x -2.0, y +1.5 mm"), (160.0, "x +0.5, y +0.5 mm"))  # never fitted
GUIDE = "JSON.parse(JSON.stringify([window.__state?.lines[0]?.guide ?? null, window.__state?.notice ?? '']))"
PICTURES = os.environ.get("RUFFINI_PICTURES", "")  # folder for a picture of each step, for a person to look at


def step_of(page: Evaluates) -> dict[str, Any]:
    """What the page shows of the calibration, what it asks, and its notice."""
    guide, notice = page.evaluate(GUIDE)
    guide = guide or {"step": {"phase": ""}}
    return {**guide, **guide["step"], "notice": notice}


def choose(page: Page, label: str) -> None:
    """Press a button, and wait for what follows."""
    number = step_of(page)["number"]
    page.click(f".guide .choices button:text-is('{label}')")
    wait_for(page, f"what follows {label!r}", lambda s: s["number"] > number, step_of)


def follow(
    page: Page, person: EmulatedPerson, heard: list[str], is_enough: Callable[[dict[str, Any]], bool] = lambda _: False
) -> None:
    """Do what the page says until it is no press any more, or `is_enough` of what it shows."""
    answered, said, seen, patience = 0, "", None, Patience()
    while (step := step_of(page))["phase"] in ("press", "work"):
        time.sleep(LOOK_S)
        if seen != (seen := (step["phase"], step["number"], step["said"], step["asked"], step.get("part"))):
            patience = Patience()
        assert not patience.is_over(), f"the page stands still at {seen}"
        assert "No reply" not in step["notice"]
        if is_enough(step):
            return
        if step["phase"] == "work" or (step["said"] == said and not step["asked"]):
            continue
        said = step["said"]
        if not step["asked"]:
            heard.append(said)
            person.say(said)
        elif step["asked"] != answered:
            answered = step["asked"]
            heard.append(said)
            if step["wantsNumber"]:
                typed = person.number(said)
                page.wait_for_selector(".guide .typed input:focus", timeout=1e3 * HANG_S)  # drawn after it is told
                page.keyboard.type(typed)
                assert page.input_value(".guide .typed input") == typed
            else:
                person.confirm(said)
            page.keyboard.press("Enter")
    picture(page, step["phase"])


def picture(page: Page, name: str) -> None:
    if PICTURES:
        page.wait_for_timeout(500)
        page.screenshot(path=f"{PICTURES}/{int(time.time())}-{name}.png", full_page=True)


class BrisklyPaced(FrameClock):
    """Simulated time that leaves viewer and browser some of the processor: a few times as fast as real."""

    is_watched = True  # somebody reads each frame: the next one waits for that

    def next_frame(self) -> int:
        time.sleep(self._period_s / FASTER)
        return super().next_frame()

    def _is_read(self) -> bool:
        return not self.is_watched or super()._is_read()


@pytest.fixture
def slow_is_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The twin shares its computer with everything else."""
    monkeypatch.setattr("test_bench_file.FrameClock", BrisklyPaced)
    monkeypatch.setattr("ruffini.rig.session.Pace.__new__.__defaults__", (None, 15.0, 8.0, 30.0, FEW_PICTURES))
    fewer = partial(ScaleCalibration, n_error_touches=ERROR_TOUCHES)
    monkeypatch.setattr("ruffini.view.scale_calibration.ScaleCalibration", fewer)


# A person who reads a number needs few drawings, and each takes the processor from the fit beside it.
FEW_DRAWINGS = """(() => {
  const own = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (callback) => setTimeout(() => own(callback), 120);
})()"""


@pytest.fixture
def page(page: Page) -> Page:
    page.add_init_script(FEW_DRAWINGS)
    return page


@pytest.fixture
def person() -> EmulatedPerson:
    return EmulatedPerson(1)


@pytest.fixture
def desk(
    bench_twin: Twin, tmp_path: Path, capsys: pytest.CaptureFixture[str], person: EmulatedPerson, slow_is_fine: None
) -> Desk:
    """A pad that is stiffer than its board says, on a scale."""
    unit = bench_twin.unit
    model = replace(unit.model, modulus_pa=unit.model.modulus_pa * STIFFER)
    stiff = TwinUnit(unit.board, unit.twin, model, unit.compliance / STIFFER)
    return Desk(Twin(stiff, bench_twin.calibration), tmp_path, person, capsys)


def force_error(page: Page, person: EmulatedPerson, truth: Truth, grams: float, place: str) -> float:
    """The force that the page shows of a weight on the pad, over the twin's own, less 1."""
    person.confirm(f"put {grams:g} g at {place}")
    frame = truth.frame  # the page may be behind
    shown = wait_for(page, "frames of it", lambda s: sensor_of(s)["wrench"]["frame"] > frame + SETTLED_FRAMES)
    said_n, true_n = -sensor_of(shown)["wrench"]["values"][2], -truth.rows[-1][1]
    person.confirm("take it away")
    return said_n / true_n - 1


def force_errors(desk: Desk, page: Page, person: EmulatedPerson, truth: Truth, n: int = len(JUDGED)) -> np.ndarray:
    """Of each of the first n weights of `JUDGED`. Only the page looks on."""
    assert isinstance(desk.clock, BrisklyPaced)
    desk.clock.is_watched = False
    wait_for(page, "forces", lambda s: sensor_of(s)["wrench"]["validity"][2] == 1)
    errors = np.array([force_error(page, person, truth, *one) for one in JUDGED[:n]])
    desk.clock.is_watched = True
    return errors


def ask(page: Page, address: str) -> None:
    """Open the page, and the first step by its key."""
    page.goto(address)
    wait_for(page, "the button", lambda _: page.is_visible("nav button:text-is('Calibrate')"))
    page.keyboard.press("n")
    wait_for(page, "the offer", lambda s: s["phase"] == "offer", step_of)
    picture(page, "offer")


def fill(page: Page, grams: str, presses: str, ball: str = "") -> None:
    for name, text in (("grams", grams), ("presses", presses), ("ball", ball)):
        page.fill(f".guide input[name={name}]", text)
    choose(page, "Begin")


def test_from_the_button_to_newtons_and_back(
    desk: Desk, person: EmulatedPerson, page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gate that fails asks for more presses; what is flashed measures, and undo takes it back."""
    monkeypatch.setenv("RUFFINI_BACKUPS", str(tmp_path / "backups"))
    truth, heard = Truth(), list[str]()
    desk.bench.twin.listeners.append(truth.note)
    with desk.running():
        with Connection(desk.port) as sensor:
            sensor.flash(desk.twin.calibration)
        with viewer(CalibratingLine(desk.port, tmp_path / "calibrations")) as address:
            page.goto(address)
            before = force_errors(desk, page, person, truth, n=2)
            start_s = host_clock.now()
            ask(page, address)
            fill(page, "100, 200, 300", "9")  # a gate wants ten
            follow(page, person, heard)
            refused = passed = step_of(page)
            for _ in range(MOST_ROUNDS):  # as a person does: how well 15 presses tell the modulus is a matter of chance
                choose(page, "Press 6 more")
                follow(page, person, heard)
                if (passed := step_of(page))["said"] == "Passes its gates":
                    break
            took_s = host_clock.now() - start_s
            report = next(frame for frame in page.frames if "/report/" in frame.url)
            # Chromium does not always lay out a frame without scripts: what it contains is read, not what it shows.
            wait_for(page, "the report", lambda _: "Passes its gates" in (report.text_content("body") or ""))
            assert report.evaluate("document.images.length") >= 2
            choose(page, "Flash it")
            wait_for(page, "the end", lambda s: s["phase"] == "flashed", step_of)
            picture(page, "flashed")
            after = force_errors(desk, page, person, truth)
            choose(page, "Undo")
            wait_for(page, "the end", lambda s: s["said"] == "Undone", step_of)
            picture(page, "undone")
            undone = force_errors(desk, page, person, truth, n=2)
            choose(page, "Close")
            assert not page.is_visible(".guide")
    n_presses = sum("type what it shows" in text for text in heard)
    print(
        f"{n_presses} presses in {took_s:.0f} s of the bench's time; the force that the page shows is off the truth by "
        f"{100 * np.abs(before).mean():.1f} % before, {100 * np.abs(after).mean():.1f} % after (at most "
        f"{100 * np.abs(after).max():.1f} %), {100 * np.abs(undone).mean():.1f} % when undone"
    )
    assert refused["said"].startswith("Not good enough: touches")
    assert "To be pressed again" in refused["text"]
    bad = {gate["name"]: gate["remedy"] for gate in refused["gates"] if gate["ok"] is False}
    assert bad["touches"] == "press more"
    assert passed["said"] == "Passes its gates"
    assert not [gate for gate in passed["gates"] if not gate["ok"]]
    assert len(list((tmp_path / "backups").iterdir())) == 1
    assert np.abs(before).mean() > 0.12
    assert np.abs(after).mean() < 0.06
    assert undone.mean() == pytest.approx(before.mean(), abs=0.03)


@pytest.mark.long
def test_a_gel_without_markers_gives_newtons_after_twenty_presses(
    person: EmulatedPerson, page: Page, tmp_path: Path, capsys: pytest.CaptureFixture[str], slow_is_fine: None
) -> None:
    """Colours and force from presses with one ball; another round with it is no other kind of contact."""
    desk = Desk(Twin(build_unit(find_board("digit-tactile")), b""), tmp_path, person, capsys)
    truth, heard = Truth(), list[str]()
    desk.bench.twin.listeners.append(truth.note)
    with desk.running(), viewer(CalibratingLine(desk.port, tmp_path / "calibrations")) as address:
        ask(page, address)
        assert "no markers" in step_of(page)["text"]
        fill(page, "50, 100, 150, 200", "18", f"{BALL_MM:g}")
        follow(page, person, heard)
        choose(page, "Press 6 more")
        follow(page, person, heard)
        passed = step_of(page)
        choose(page, "Flash it")
        wait_for(page, "the end", lambda s: s["phase"] == "flashed", step_of)
        after = force_errors(desk, page, person, truth)
    print(f"the force that the page shows is off the truth by {100 * np.abs(after).mean():.1f} %")
    assert passed["said"] == "Passes its gates"
    assert np.abs(after).mean() < 0.06
    (log,) = {path.parent for path in (tmp_path / "calibrations").glob("*/presses-2.h5")}
    runs = read_feature_runs(sorted(log.glob("presses-*.h5")), desk.twin.board)
    assert len({run.kind for run in runs}) == 1


def test_whatever_ends_it_the_presses_stay_and_are_gone_on_with(
    desk: Desk, person: EmulatedPerson, page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A form that makes no sense, a second browser that stops, a page that is closed, a daemon that dies."""
    daemons, heard = list[Daemon](), list[str]()

    @contextlib.contextmanager
    def known(*arguments: Any) -> Iterator[str]:
        with started_daemon(*arguments) as daemon:
            daemons.append(daemon)
            yield daemon.port

    monkeypatch.setattr("test_bench_file.running_daemon", known)
    with desk.running():
        with Connection(desk.port) as sensor:
            sensor.flash(desk.twin.calibration)
        with viewer(CalibratingLine(desk.port, tmp_path / "calibrations")) as address:
            ask(page, address)
            for wrong, sentence in (
                (("60, x", "3"), "'x' is no weight in grams"),
                (("60", "many"), "'many' is no number of presses: give 1 to 200"),
                (("60", "3", "-5"), "'-5' is no diameter of a ball"),
                (("5000", "3"), "5000 g is a press of 49.0 N, more than the 10 N"),
            ):
                fill(page, *wrong)
                wait_for(page, sentence, lambda step, s=sentence: s in step["text"], step_of)  # type: ignore[misc]
                assert page.input_value(".guide input[name=grams]") == wrong[0]
            assert not (tmp_path / "calibrations").exists()
            fill(page, "60, 90", "3")
            follow(page, person, heard, is_enough=lambda step: step["nDone"] == 1 and step["asked"] > 0)
            assert page.context.browser is not None
            other = page.context.browser.new_page()
            other.goto(address)
            wait_for(other, "the question", lambda s: s["asked"], step_of)
            assert "until the scale shows about 90 g" in step_of(other)["said"]
            other.click(".guide .stop")
            wait_for(page, "the stop", lambda s: s["phase"] == "ended", step_of)
            assert "stopped from the page: what was collected is kept" in step_of(page)["text"]
            page.reload()
            wait_for(page, "the same step", lambda s: s["phase"] == "ended", step_of)
            choose(other, "Continue")
            wait_for(page, "what the other page began", lambda s: s["phase"] in ("press", "work"), step_of)
            follow(page, person, heard, is_enough=lambda step: step["nDone"] == 2 and step["asked"] > 0)
            os.kill(daemons[0].pid, signal.SIGKILL)
            wait_for(page, "the loss", lambda s: s["phase"] == "ended", step_of)
            picture(page, "lost")
            lost = step_of(page)["text"]
            other.close()
    assert lost.count("The presses are kept in") == 1
    assert [path.name for path in sorted((tmp_path / "calibrations").glob("*/*.parts/[0-9]*.h5"))] == [
        "00000.h5", "00001.h5"
    ]  # fmt: skip
