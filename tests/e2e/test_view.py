"""The page in a real browser, on the real daemon: numbers against the truth, lines that break, pages that are slow."""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest
from broken_line import BrokenLine
from browser import colours_in, press, sensor_of, state_of, step, viewer, wait_for
from hang import HANG_S, until
from playwright.sync_api import Page
from tiny_twin import Twin
from told_sensor import ToldSensor, info_of, told_tray

from ruffini.boards import find_board
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.errors import NoDeviceError
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Steered, TwinServer
from ruffini.view.outbox import Outbox
from ruffini.view.server import page_folder
from ruffini.wire import Frame, Schema, encode_message
from ruffini.wire.framing import cobs_encode, crc32c

MM = 1e-3
MAX_PAGE_BYTES = 350_000  # gzip, all of it
N_STILLS = 20
VALID = 1
NUMBER = Schema.own().type_numbers
PLACE_AND_COLOUR = """element => {
  const [box, all] = [element.getBoundingClientRect(), document.querySelector("main").getBoundingClientRect()];
  const colour = getComputedStyle(element).borderLeftColor.match(/\\d+/g).slice(0, 3).map(Number);
  return {x: Math.round(box.left - all.left + 12), y: Math.round(box.top + box.height / 2 - all.top + 12), colour};
}"""
MINUS = "\u2212"  # as wide as a plus


@pytest.fixture(scope="module")
def pressed(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Steered]]:
    """A calibrated sensor on a pty with a ball held in its pad."""
    folder = tmp_path_factory.mktemp("pressed")
    steered = Steered(twin.unit, Indenter("sphere", 3 * MM))
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), steered, Scenario(), folder / "twin"),
        running_daemon(twin.board.folder, f"twin:{folder / 'twin'}", folder / "store") as port,
    ):
        with Connection(port) as sensor:
            sensor.flash(twin.calibration)
            sensor.subscribe(wrench=1)
            for frame, message in sensor.stream(timeout_s=HANG_S):
                if frame.type == NUMBER["WRENCH"] and message.validity[2] == VALID:  # rest is learned
                    break
        steered.move_to(Pose(MM, 0.5 * MM, 0.6 * MM))
        yield port, steered


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> dict[int, list[list[float]]]:
    """By frame, the wrenches that the server handed on, N and N m: a stall sends the last frame's again, stale."""
    out: dict[int, list[list[float]]] = {}
    put, schema = Outbox.put, Schema.own()

    def heard(box: Outbox, frame: Frame, own: Schema) -> None:
        if schema.type_name(frame.type) == "WRENCH":
            m: Any = schema.decode(frame.type, frame.payload)
            forces = [m.force_x_un, m.force_y_un, m.force_z_un]
            torques = [m.torque_x_un_um, m.torque_y_un_um, m.torque_z_un_um]
            out.setdefault(m.stamp.frame, []).append([f * 1e-6 for f in forces] + [t * 1e-12 for t in torques])
        put(box, frame, own)

    monkeypatch.setattr(Outbox, "put", heard)
    return out


def still_of(page: Page) -> Any:
    """The sensor as it is frozen on a new picture; a busy machine's twin may send none for a while, which is STALE."""
    for _ in range(N_STILLS):
        wait_for(page, "a new picture", lambda s: "STALE" not in sensor_of(s)["flags"])
        page.keyboard.press("Space")
        sensor = sensor_of(wait_for(page, "a still", lambda _: "Frozen" in page.inner_text("#notice")))
        if "STALE" not in sensor["flags"]:
            return sensor
        page.keyboard.press("Space")
        wait_for(page, "live again", lambda _: "Frozen" not in page.inner_text("#notice"))
    raise AssertionError(f"{N_STILLS} stills, each of a picture that stood still: {sensor}")


def test_what_is_shown_is_what_was_sent_and_near_the_truth(
    pressed: tuple[str, Steered], page: Page, sent: dict[int, list[list[float]]]
) -> None:
    port, steered = pressed
    with viewer(port) as address:
        page.goto(address)
        first = wait_for(page, "a frame", lambda s: s["lines"][0]["firstFrameMs"])["lines"][0]["firstFrameMs"]
        print(f"first frame drawn {first:.0f} ms after the line was opened")
        wait_for(page, "a press", lambda s: sensor_of(s)["wrench"]["values"][2] < -0.3 and sensor_of(s)["field"])
        wait_for(page, "a depth", lambda s: sensor_of(s)["maps"]["depth"] == "values")  # sent less often

        def is_true(state: dict[str, Any]) -> bool:
            """The truth at each look: while a frame is made the ball's force is on its way."""
            return sensor_of(state)["wrench"]["values"][2] == pytest.approx(steered.wrench[2], rel=0.25)  # type: ignore[no-any-return]

        true_n = sensor_of(wait_for(page, "the truth", is_true))["wrench"]["values"][2]
        sensor = still_of(page)
        n_sent = len(sent)
        until(lambda: len(sent) > n_sent + 3, "frames that a still does not show")
        assert sensor_of(state_of(page))["wrench"] == sensor["wrench"]
        colours = colours_in(page, ".stage canvas"), colours_in(page, ".maps figure:nth-child(1) canvas")
    assert sensor["board"] == "tiny"
    assert sensor["isSimulated"]
    assert not sensor["isReplay"]
    assert sensor["flags"] == ["REST_UNVERIFIED"]  # a new store, and nobody has zeroed
    wrench = sensor["wrench"]
    assert wrench["validity"] == [VALID] * 6
    assert wrench["values"][2] == pytest.approx(true_n, rel=0.25)
    assert pytest.approx(wrench["values"], abs=1e-12) in sent[wrench["frame"]]
    if sensor["field"]["frame"] == wrench["frame"]:  # what is drawn sums to the number beside it
        assert sensor["field"]["sum"] == pytest.approx(wrench["values"][:3], abs=2e-6)
    assert [sensor["maps"][name] for name in ("normal", "shear", "depth")] == ["values"] * 3
    assert sensor["maps"]["camera"] == "press C"
    assert sensor["nArrows"] > 3
    assert len(sensor["contacts"]) == 1
    assert sensor["contacts"][0]["center"] == pytest.approx([MM, 0.5 * MM], abs=MM)
    assert min(colours) > 50
    assert page.inner_text(".cell:nth-child(3) output") == f"{wrench['values'][2]:.3f}".replace("-", MINUS)
    assert page.inner_text(".badges .simulated") == "SIMULATED"
    assert re.fullmatch("tiny [0-9a-f]{8}", page.inner_text("#who"))  # a serial of its own


def is_untouched(state: dict[str, Any]) -> bool:
    wrench = sensor_of(state)["wrench"]
    return wrench["validity"][2] == VALID and abs(wrench["values"][2]) < 0.1


def normal_shown(page: Page) -> float:
    return float(page.inner_text(".cell:nth-child(3) output").replace(MINUS, "-"))


def test_keys_zero_the_pad_change_units_and_ask_for_the_camera(pressed: tuple[str, Steered], page: Page) -> None:
    port, _ = pressed
    with viewer(port) as address:
        page.goto(address)
        wait_for(page, "a press", lambda s: sensor_of(s)["wrench"]["values"][2] < -0.3)
        page.keyboard.press("u")
        wait_for(page, "millinewtons", lambda s: page.inner_text(".cell .unit >> nth=0") == "mN")
        wait_for(page, "the press in them", lambda s: -1000 < normal_shown(page) < -300)
        page.keyboard.press("c")
        wait_for(page, "the camera", lambda s: sensor_of(s)["maps"]["camera"] == "values")
        press(page, "z", says="Press Zero once more")
        page.keyboard.press("z")
        # The ball that is held is rest from now on.
        wait_for(page, "no press", is_untouched)
        with page.expect_download() as download:
            page.keyboard.press("s")
        legend = page.eval_on_selector(".u-marker >> nth=1", PLACE_AND_COLOUR)
        y, x = legend["y"], legend["x"]
        saved = cv2.imread(str(download.value.path()))[y - 2 : y + 3, x - 2 : x + 3, ::-1].astype(int)
        assert (abs(saved - legend["colour"]).max(axis=2) < 30).any()  # a picture of the page, not only of its canvases
        page.keyboard.press("?")
        wait_for(page, "the help", lambda _: page.is_visible("#help"))


def test_a_sensor_that_is_unplugged_is_said_and_comes_back_by_itself(
    pressed: tuple[str, Steered], page: Page, tmp_path: Path
) -> None:
    port, _ = pressed
    with BrokenLine(port, tmp_path) as line, viewer(line.port) as address:
        page.goto(address)
        wait_for(page, "frames", lambda s: sensor_of(s)["nChartPoints"] > 5)
        line.unplug()
        wait_for(page, "the loss", lambda s: "plug the sensor in" in s["notice"] or "cannot be opened" in s["notice"])
        wait_for(page, "it marked", lambda _: page.is_visible("section.sensor.lost"))
        last = sensor_of(state_of(page))["wrench"]["frame"]
        line.plug_in()
        # Frames that were on their way when the line was lost may be shown after its notice.
        wait_for(page, "later frames", lambda s: sensor_of(s)["wrench"]["frame"] > last and "line" not in s["notice"])
        wait_for(page, "the mark gone", lambda _: not page.is_visible("section.sensor.lost"))


def test_broken_pieces_are_counted_and_never_shown(
    pressed: tuple[str, Steered], page: Page, sent: dict[int, list[list[float]]], tmp_path: Path
) -> None:
    port, _ = pressed
    with BrokenLine(port, tmp_path) as line, viewer(line.port) as address:
        page.goto(address)
        wait_for(page, "frames", lambda s: sensor_of(s)["nChartPoints"] > 5)
        line.loss = 0.05
        state = wait_for(page, "broken frames", lambda s: s["lines"][0]["health"]["counters"]["bad_crc"] > 3)
        wrench = sensor_of(state)["wrench"]
        assert pytest.approx(wrench["values"], abs=1e-12) in sent[wrench["frame"]]


HOLD_DRAWING = """
const [ask, held] = [window.requestAnimationFrame.bind(window), []];
window.requestAnimationFrame = callback => window.__isHeld ? held.push(callback) : ask(callback);
window.__release = () => { window.__isHeld = false; held.splice(0).forEach(ask); };
"""


def test_a_page_that_is_slow_gets_the_newest_and_no_backlog(page: Page) -> None:
    page.add_init_script(HOLD_DRAWING)
    infos = [info_of(find_board("ftouch"))]
    with ToldSensor(infos, told_tray, rate_hz=None) as sensor, viewer(sensor.port) as address:
        page.goto(address)
        n_before = step(page, sensor, n=3)["lines"][0]["nDrawn"]
        page.evaluate("window.__isHeld = true")
        newest = sensor.send(100)
        page.evaluate("window.__release()")
        state = wait_for(page, "the newest", lambda s: sensor_of(s)["wrench"]["frame"] == newest)

        def n_left_out() -> int:
            """By the page, or by the server, which tells its number once a second."""
            health = step(page, sensor, n=1)["lines"][0]["health"]
            return int(health["notShown"] + health["notSent"])

        until(n_left_out, "how many were not drawn")
    assert state["lines"][0]["nDrawn"] - n_before < 50


class OtherDevice:
    """Something on a pty that says the same again and again."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._say, daemon=True)

    def __enter__(self) -> OtherDevice:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)

    def _say(self) -> None:
        os.set_blocking(self._master, False)
        while not self._stop.wait(0.05):
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, self._data)
            with contextlib.suppress(BlockingIOError):
                os.read(self._master, 4096)


def of_version_2() -> bytes:
    body = bytes([2, 0, 1, 255]) + bytes(8)
    return cobs_encode(body + crc32c(body).to_bytes(4, "little")) + b"\0"


def hello(**fields: object) -> bytes:
    message = Schema.own().new("Hello", **fields).SerializeToString()
    return encode_message(1, message, sensor=255, sequence=0, flags=0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (of_version_2(), "is not protocol version 1"),
        (hello(protocol_version=3), "speaks protocol version 3"),
        (b"", "Nothing answers on this line"),
    ],
)
def test_who_does_not_speak_our_protocol_is_said_to(page: Page, data: bytes, words: str) -> None:
    with OtherDevice(data) as other, viewer(other.port) as address:
        page.goto(address)
        wait_for(page, words, lambda s: words in page.inner_text("#notice"))


def test_a_port_that_is_missing_or_taken_is_named(pressed: tuple[str, Steered]) -> None:
    port, _ = pressed
    with pytest.raises(NoDeviceError, match="/dev/nothing"), viewer("/dev/nothing"):
        pass
    with viewer(port), pytest.raises(NoDeviceError, match="busy"), viewer(port):
        pass


def test_the_page_is_light() -> None:
    files = {path.name: len(gzip.compress(path.read_bytes(), 9)) for path in page_folder().iterdir()}
    print(f"page: {sum(files.values()) / 1e3:.0f} kB gzip, limit {MAX_PAGE_BYTES / 1e3:.0f} kB: {files}")
    assert 50_000 < sum(files.values()) <= MAX_PAGE_BYTES
