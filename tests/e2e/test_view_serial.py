"""The page straight on a serial port, from a static host: the real daemon behind a replaced navigator.serial."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from browser import sensor_of, state_of, wait_for
from playwright.sync_api import Page
from serial_bridge import FAKE_SERIAL, SerialBridge, serial_bridge
from tiny_twin import Twin

from ruffini.demo.daemon import running_daemon
from ruffini.device import Connection
from ruffini.sim.contact import Indenter
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Steered, TwinServer
from ruffini.view.server import page_folder
from ruffini.wire.framing import cobs_encode

NOISE = os.urandom(3000) + b"\0" + cobs_encode(bytes(range(40))) + b"\0" + b"\x02" * 6000


@pytest.fixture(scope="module")
def bridge(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SerialBridge]:
    folder = tmp_path_factory.mktemp("serial")
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), Steered(twin.unit, Indenter("sphere", 3e-3)), Scenario(), folder / "twin"),
        running_daemon(twin.board.folder, f"twin:{folder / 'twin'}", folder / "store") as port,
    ):
        with Connection(port) as sensor:
            sensor.flash(twin.calibration)
        with serial_bridge(port, page_folder(), NOISE) as bridge:
            yield bridge


def test_a_sensor_is_opened_by_webserial_behind_noise_and_again_after_it_was_unplugged(
    bridge: SerialBridge, page: Page
) -> None:
    page.add_init_script(FAKE_SERIAL.replace("PORT", str(bridge.port)))
    page.goto(f"http://127.0.0.1:{bridge.port}/")
    wait_for(page, "the prompt", lambda s: "Press Connect" in s["notice"])
    page.keyboard.press("k")
    wait_for(page, "frames", lambda s: sensor_of(s)["nChartPoints"] > 5 and sensor_of(s)["field"])
    wait_for(page, "the noise", lambda s: s["lines"][0]["health"]["counters"]["oversize"] == 1)
    state = wait_for(page, "valid forces", lambda s: sensor_of(s)["wrench"]["validity"] == [1] * 6)
    assert page.evaluate("window.__opened") == {"baudRate": 115_200, "bufferSize": 1 << 20}
    assert sensor_of(state)["board"] == "tiny"
    assert sensor_of(state)["isSimulated"]
    counters = state["lines"][0]["health"]["counters"]
    assert counters["malformed"] + counters["bad_crc"] > 0
    assert counters["oversize"] == 1
    bridge.unplug()
    wait_for(page, "the loss", lambda s: "unplugged" in s["notice"])
    last = sensor_of(state_of(page))["wrench"]["frame"]
    page.evaluate("window.__plugIn()")
    wait_for(page, "later frames", lambda s: sensor_of(s)["wrench"]["frame"] > last and "plug" not in s["notice"])


def test_a_browser_without_webserial_is_told_what_to_do(bridge: SerialBridge, page: Page) -> None:
    page.add_init_script("delete Navigator.prototype.serial")
    page.goto(f"http://127.0.0.1:{bridge.port}/")
    wait_for(page, "the way out", lambda s: "start `ruffini view`" in s["notice"])
