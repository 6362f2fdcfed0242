"""A calibration from the page: what is offered, what a stale or strange choice does, how each failure is said."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
from hang import until

from ruffini.boards import find_board
from ruffini.calibrate.gates import REMEDIES
from ruffini.device import Connection
from ruffini.device.backlog import Backlog
from ruffini.errors import InputError, LineLostError, NoDeviceError, RefusedError, RuffiniError
from ruffini.estimators.table import needs_ball_first, scale_span
from ruffini.rig.program import ScalePress
from ruffini.view import scale_calibration
from ruffini.view.calibration import Calibration
from ruffini.view.guided import serving
from ruffini.view.line import SharedLine
from ruffini.view.scale_calibration import Plan, ScaleCalibration, asked_for
from ruffini.wire import Frame


@contextlib.contextmanager
def gone() -> Iterator[Connection]:
    raise NoDeviceError("/dev/pts/7 is gone")
    yield


def run(calibration: Calibration, word: str, **fields: str) -> dict[str, Any]:
    """The step after a choice."""
    number = calibration.state()["step"]
    calibration.choose(word, number, fields)
    until(lambda: calibration.state()["phase"] != "work", "the step after it")
    return calibration.state()


def words(state: dict[str, Any]) -> list[str]:
    return [choice["word"] for choice in state["choices"]]


def test_nothing_is_shown_but_the_button_until_it_is_pressed() -> None:
    state = Calibration(gone, None).state()
    assert (state["phase"], words(state)) == ("", ["open"])
    json.dumps(state)


def test_a_sensor_that_is_gone_is_one_sentence_and_can_be_tried_again() -> None:
    calibration = Calibration(gone, None)
    state = run(calibration, "open")
    assert (state["phase"], state["is_bad"], words(state)) == ("ended", True, ["open", "close"])
    assert state["text"] == "/dev/pts/7 is gone."
    state = run(calibration, "open")
    assert state["text"] == "/dev/pts/7 is gone."
    assert run(calibration, "close")["phase"] == ""


@pytest.mark.parametrize(
    ("word", "step"), [("open", 1), ("open", -1), ("open", None), ("flash", 0), ("undo", 0), (7, 0), (None, 0), ([], 0)]
)
def test_what_is_not_offered_at_this_step_is_no_choice(word: object, step: object) -> None:
    calibration = Calibration(gone, None)
    calibration.choose(word, step, None)
    assert (calibration.state()["phase"], calibration.state()["step"]) == ("", 0)


def test_of_two_browsers_that_choose_at_once_one_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = list[str]()

    def note(_: ScaleCalibration, word: str, __: Any) -> None:
        chosen.append(word)
        raise NoDeviceError("gone")

    monkeypatch.setattr(ScaleCalibration, "run", note)
    calibration = Calibration(gone, None)
    for _ in range(2):
        calibration.choose("open", 0, "no fields")
    until(lambda: calibration.state()["phase"] == "ended", "the step after it")
    assert chosen == ["open"]


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "/x/00001.h5"),
         "/x/00001.h5: No space left on device: make room, then continue."),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "{folder}: Disk quota exceeded: make room, then continue."),
        (PermissionError(errno.EACCES, "Permission denied", "/x/00001.h5"), "/x/00001.h5: Permission denied."),
        (OSError("Unable to open file (file signature not found)"),
         "{folder}: Unable to open file (file signature not found)."),
        (NoDeviceError("the line was lost"), "the line was lost."),
        (InputError("is it plugged in?"), "is it plugged in?"),
        (ZeroDivisionError("0"), "this is a fault of ruffini (ZeroDivisionError('0'))."),
    ],
)  # fmt: skip
def test_what_ends_the_presses_is_said_with_where_they_are_kept(
    error: Exception, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(work: ScaleCalibration, *_: Any) -> None:
        work.current = tmp_path
        raise error

    monkeypatch.setattr(ScaleCalibration, "run", fail)
    state = run(Calibration(gone, None), "open")
    assert state["text"] == f"{sentence.format(folder=tmp_path)} The presses are kept in {tmp_path}."
    assert words(state) == ["continue", "open", "close"]


def at_step(
    step: scale_calibration.Step, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., dict[str, Any]]:
    """Choose at this step what ends in this error."""

    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(ScaleCalibration, "run", fail)
    calibration = Calibration(gone, None)
    calibration._show(step)
    return lambda word, **fields: run(calibration, word, **fields)


def test_a_form_that_makes_no_sense_stays_as_it_was_filled_in(monkeypatch: pytest.MonkeyPatch) -> None:
    fields = (scale_calibration.Field("grams", "Weights", "50", "g"), scale_calibration.Field("ball", "Ball", "", "mm"))
    offer = scale_calibration.Step("offer", "Calibrate", choices=(scale_calibration.BEGIN,), fields=fields)
    state = at_step(offer, InputError("no weight"), monkeypatch)("begin", grams="many", other="x")
    assert (state["phase"], state["text"], state["is_bad"]) == ("offer", "no weight.", True)
    assert [one["value"] for one in state["fields"]] == ["many", ""]


def test_a_flash_that_is_refused_leaves_the_report_there(monkeypatch: pytest.MonkeyPatch) -> None:
    report = scale_calibration.Step("report", "Passes", choices=(scale_calibration.FLASH,), has_report=True)
    state = at_step(report, RefusedError("needs a signature"), monkeypatch)("flash")
    assert (state["phase"], state["text"], words(state)) == ("report", "needs a signature.", ["flash"])
    assert state["report"] == state["step"]


@pytest.mark.parametrize(
    ("grams", "presses", "ball", "wanted"),
    [
        ("50, 100, 200", "20", "", ((50.0, 100.0, 200.0), 20, None)),
        ("50.5 100,5;5", " 1 ", "6.35 mm", ((50.5, 100.5, 5.0), 1, 6.35)),
        ("20,5,10", "200", "6,35", ((20.0, 5.0, 10.0), 200, 6.35)),
        ("12,25", "1", "", ((12.0, 25.0), 1, None)),
        ("20,5, 10", "1", "", ((20.5, 10.0), 1, None)),
        ("20,5;10 ; 7", "1", "", ((20.5, 10.0, 7.0), 1, None)),
        ("50 g, 100 g", "1", "", ((50.0, 100.0), 1, None)),
        ("50g,100g", "1", "", ((50.0, 100.0), 1, None)),
        ("50 , 100,", "1", "", ((50.0, 100.0), 1, None)),
        ("50,100,", "1", "", ((50.0, 100.0), 1, None)),
        ("50,100, 200", "1", "", ((50.0, 100.0, 200.0), 1, None)),
        ("203.5 g", "1", "", ((203.5, ), 1, None)),
    ],
)  # fmt: skip
def test_a_form_is_read_as_people_fill_it_in(grams: str, presses: str, ball: str, wanted: Any) -> None:
    assert asked_for({"grams": grams, "presses": presses, "ball": ball}) == wanted


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({}, "weights: give one at least"),
        ({"grams": "x", "presses": "3"}, "'x' is no weight in grams"),
        ({"grams": "50 kg", "presses": "3"}, "'kg' is no weight in grams"),
        ({"grams": "50 gr, 7", "presses": "3"}, "'gr' is no weight in grams"),
        ({"grams": "nan", "presses": "3"}, "'nan' is no weight in grams"),
        ({"grams": "50"}, "'' is no number of presses: give 1 to 200"),
        ({"grams": "50", "presses": "0"}, "'0' is no number of presses"),
        ({"grams": "50", "presses": "٣"}, "is no number of presses"),
        ({"grams": "50", "presses": "3", "ball": "0.2"}, "'0.2' is no diameter of a ball: give 1 to 50 mm"),
        ({"grams": "50", "presses": "3", "ball": "1e1"}, "'1e1' is no diameter of a ball"),
    ],
)
def test_what_makes_no_sense_is_named(fields: dict[str, str], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        asked_for(fields)


def test_a_plan_is_read_back_and_counts_what_is_there(tmp_path: Path) -> None:
    presses = (ScalePress(0.001, -0.002, 50.0), ScalePress(1 / 3000, 0.002, 100.0))
    kept = Plan(6.35, "/dev/hidraw0", (50.0, 100.0), (presses, presses[:1]), "5f")
    kept.write(tmp_path)
    assert Plan.read(tmp_path) == kept
    (tmp_path / "presses-1.h5").touch()
    (tmp_path / "presses-2.h5.parts").mkdir()
    assert (kept.n_done(tmp_path), kept.n_total) == (2, 3)
    (tmp_path / "presses-2.h5.parts" / "00000.h5").touch()
    assert kept.n_done(tmp_path) == 3


@pytest.mark.parametrize(
    "text", ["", "{}", "[1]", "[1, 2, 3, 4]", '[null, "", [1], [[[1, 2, 3]]]]', '[null, "", [1], [[[1, 2]]], ""]']
)
def test_a_spoilt_plan_is_refused_in_a_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_text(text)
    with pytest.raises(RuffiniError, match="begin a new calibration"):
        Plan.read(tmp_path)


def sensor_with(
    sha256: bytes = b"", *, key_ids: Sequence[str] = (), **can: Any
) -> Callable[[], contextlib.AbstractContextManager[Connection]]:
    """Lends a gelslim with this calibration in force; it can be looked at, and what `can` names."""
    calibration = SimpleNamespace(present=bool(sha256), sha256=sha256)
    described = SimpleNamespace(board_toml=find_board("gelslim").text, calibration=calibration)
    hello = SimpleNamespace(sensors=[described], key_ids=key_ids)
    sensor: Any = SimpleNamespace(hello=hello, port="/dev/pts/7", serial_number="7", **can)
    return lambda: contextlib.nullcontext(sensor)


def test_a_spoilt_plan_does_not_stand_in_the_way_of_a_new_one(tmp_path: Path) -> None:
    path = tmp_path / "20260101T000000Z" / "settings.json"
    path.parent.mkdir()
    path.write_text("spoilt")
    state = run(Calibration(sensor_with(), tmp_path), "open")
    assert (state["phase"], state["is_bad"], words(state)) == ("offer", True, ["begin", "close"])
    assert re.match(rf"{path}: cannot be read .*: begin a new calibration\. Lay the sensor", state["text"])
    assert [one["name"] for one in state["fields"]] == ["grams", "presses", "ball", "scale"]


def test_a_scale_that_cannot_be_opened_leaves_the_form_and_nothing_else(tmp_path: Path) -> None:
    calibration = Calibration(sensor_with(b"\1"), tmp_path / "calibrations")
    run(calibration, "open")
    state = run(calibration, "begin", grams="50", presses="3", scale="/dev/hidraw999")
    assert (state["phase"], state["is_bad"]) == ("offer", True)
    assert state["text"].startswith("/dev/hidraw999 cannot be opened")
    assert [one["value"] for one in state["fields"]] == ["50", "3", "", "/dev/hidraw999"]
    assert not (tmp_path / "calibrations").exists()


@pytest.mark.parametrize("text", ["spoilt", "[]", '{"worst": [{"x_m": 0}]}', '{"worst": 7}'])
def test_a_spoilt_report_is_named_and_made_again(text: str, tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    assert scale_calibration._worst_of(path) == []
    path.write_text(text)
    with pytest.raises(InputError, match=rf"{path}: cannot be read .*: Continue makes it again"):
        scale_calibration._worst_of(path)
    path.write_text('{"axes": {}}')  # of a wrench, which names no places
    assert scale_calibration._worst_of(path) == []
    path.write_text('{"worst": [{"x_m": 0.001, "y_m": 0, "grams": 50, "told": "press", "error_n": 1}]}')
    assert scale_calibration._worst_of(path) == [ScalePress(0.001, 0.0, 50.0)]


@pytest.mark.parametrize(("before", "now"), [("", b"\1"), ("01", b"\2"), ("01", b"")])
def test_presses_under_two_calibrations_are_never_mixed(before: str, now: bytes, tmp_path: Path) -> None:
    folder = tmp_path / "20260101T000000Z"
    kept = Plan(None, "", (50.0,), ((ScalePress(0.0, 0.0, 50.0),),), before)
    kept.write(folder)
    calibration = Calibration(sensor_with(now), tmp_path)
    state = run(calibration, "open")
    assert (state["phase"], state["is_bad"]) == ("offer", True)
    assert words(state) == ["begin", "undo", "close"]
    assert "0 of 1 presses are kept in" in state["text"]
    assert "begin a new calibration, or put the former back with Undo" in state["text"]
    same = Calibration(sensor_with(bytes.fromhex(before)), tmp_path)
    assert words(run(same, "open"))[0] == "continue"
    same._borrow = same._work.borrow = sensor_with(now)  # type: ignore[union-attr]  # flashed by another program
    state = run(same, "continue")
    assert state["text"].startswith("these presses were begun with another calibration in force than now")
    assert words(state) == ["continue", "open", "close"]
    assert words(run(same, "open"))[0] == "begin"


def test_presses_that_are_all_there_are_fitted_whatever_is_in_force(tmp_path: Path) -> None:
    folder = tmp_path / "20260101T000000Z"
    Plan(None, "", (50.0,), ((ScalePress(0.0, 0.0, 50.0),),), "01").write(folder)
    (folder / "presses-1.h5").touch()
    assert words(run(Calibration(sensor_with(b"\2"), tmp_path), "open"))[0] == "continue"


def test_a_sensor_that_is_lost_at_the_first_question_is_said_before_an_answer(tmp_path: Path) -> None:
    folder, lost, messages = tmp_path / "20260101T000000Z", threading.Event(), Backlog()
    Plan(None, "", (50.0,), (tuple(ScalePress(0.0, 0.001 * i, 50.0) for i in range(3)),), "").write(folder)
    (folder / "presses-1.h5.parts").mkdir()
    (folder / "presses-1.h5.parts" / "00000.h5").touch()

    def status() -> None:
        messages.append(Frame(0, 0, 0, 2, b""), None)  # the sensor's stream goes on meanwhile
        if lost.is_set():
            raise LineLostError("/dev/pts/7: the line was lost")

    calibration = Calibration(sensor_with(status=status, messages=messages), tmp_path)
    run(calibration, "open")
    run(calibration, "continue")
    until(lambda: calibration.state()["said"].startswith("set the scale to zero"), "the first question")
    until(lambda: messages.n_added > 1, "a second look at the sensor")
    assert len(messages) < messages.n_added
    lost.set()
    until(lambda: calibration.state()["phase"] == "ended", "the loss")
    state = calibration.state()
    assert state["text"] == f"/dev/pts/7: the line was lost. The presses are kept in {folder}."
    assert words(state)[0] == "continue"
    assert "1 of 3 presses are kept" in run(calibration, "open")["text"]


def test_owners_are_told_before_they_press_how_they_flash(tmp_path: Path) -> None:
    text = run(Calibration(sensor_with(key_ids=["12ab34cd", "5678ef90"]), tmp_path), "open")["text"]
    assert "owners (keys 12ab34cd, 5678ef90), and a page signs with no key of theirs" in text
    assert "end the viewer, then `ruffini cal flash FILE --key NAME`" in text
    assert "owners" not in run(Calibration(sensor_with(), tmp_path), "open")["text"]


@pytest.mark.parametrize(("key_ids", "is_named"), [(["12ab34cd"], True), ([], False)])
def test_a_refused_flash_of_a_sensor_with_owners_says_how_they_flash(
    key_ids: list[str], is_named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise RefusedError("no key of this sensor signed it")

    file = SimpleNamespace(data=b"", sha256=b"")
    for name in ("container.read", "container.check_board", "check_gates"):
        monkeypatch.setattr(f"ruffini.view.scale_calibration.{name}", lambda *_, **__: file)
    calibration = Calibration(sensor_with(key_ids=key_ids, flash=refuse), tmp_path)
    run(calibration, "open")
    assert calibration._work is not None
    calibration._work.current = tmp_path
    calibration._show(scale_calibration.Step("report", "Passes", choices=(scale_calibration.FLASH,), has_report=True))
    state = run(calibration, "flash")
    assert (state["phase"], words(state)) == ("report", ["flash"])
    command = f"`ruffini cal flash {tmp_path}/calibration.safetensors --key NAME`"
    assert state["text"].startswith("no key of this sensor signed it")
    assert (command in state["text"]) == is_named


def test_boards_that_a_scale_cannot_calibrate_say_so() -> None:
    assert scale_span(find_board("gelslim")).half_x_m > 0
    assert needs_ball_first(find_board("gelslim"))
    assert not needs_ball_first(find_board("gelsight-wedge"))
    for name in ("ftouch", "eltac", "stereo-fingertip"):
        with pytest.raises(InputError, match=r"scale|videos|estimator"):
            scale_span(find_board(name))


def test_remedies_are_of_gates_that_there_are() -> None:
    package = Path(scale_calibration.__file__).parents[1]
    sources = [*package.glob("estimators/*/*.py"), package / "calibrate" / "gates.py"]
    source = "".join(path.read_text() for path in sources)
    assert [name for name in REMEDIES if not re.search(rf'\("{name}",', source)] == []


class Reported(SharedLine):
    """A line whose report is there."""

    def __init__(self, path: Path) -> None:
        super().__init__("/dev/null")
        self._path = path

    @property
    def report(self) -> Path:
        return self._path

    async def start(self) -> None: ...

    async def close(self) -> None: ...


def test_a_report_runs_no_script_and_is_shown_in_no_foreign_page(tmp_path: Path) -> None:
    path, told = tmp_path / "report.html", list[str]()

    async def get(url: str) -> tuple[int, str, str]:
        async with aiohttp.ClientSession() as session, session.get(url) as answer:
            return answer.status, await answer.text(), answer.headers.get("Content-Security-Policy", "")

    with serving([Reported(path)], 0, told.append):
        assert asyncio.run(get(f"{told[0]}report/0"))[0] == 404
        path.write_text("<p>report")
        status, text, policy = asyncio.run(get(f"{told[0]}report/0?7"))
        assert (status, text) == (200, "<p>report")
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'self'; sandbox" in policy
        assert "script" not in policy
        assert asyncio.run(get(f"{told[0]}report/1"))[0] == 404
