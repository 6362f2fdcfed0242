"""The page straight on a serial port, from a static host: the real daemon behind a replaced navigator.serial."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import drop_file, sensor_of, state_of, wait_for
from playwright.sync_api import Page
from serial_bridge import FAKE_SERIAL, SerialBridge, serial_bridge
from tiny_sensor import Sensor, start
from tiny_twin import Twin

from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.record import record_stream
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Steered, TwinServer
from ruffini.view.server import page_folder
from ruffini.wire.framing import cobs_encode

NOISE = os.urandom(3000) + b"\0" + cobs_encode(bytes(range(40))) + b"\0" + b"\x02" * 6000


@pytest.fixture(scope="module")
def steered(twin: Twin) -> Steered:
    return Steered(twin.unit, Indenter("sphere", 3e-3))


@pytest.fixture(scope="module")
def bridge(twin: Twin, steered: Steered, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SerialBridge]:
    folder = tmp_path_factory.mktemp("serial")
    assert twin.board.folder is not None
    with (
        TwinServer(twin.unit.renderer(), steered, Scenario(), folder / "twin"),
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


@pytest.fixture
def recorded(sensor: Sensor, tmp_path: Path) -> Path:
    path = tmp_path / "host.mcap"
    with start(sensor, tmp_path / "store", "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        record_stream(host, path)
    return path


def connected(bridge: SerialBridge, page: Page) -> None:
    page.add_init_script(FAKE_SERIAL.replace("PORT", str(bridge.port)))
    page.goto(f"http://127.0.0.1:{bridge.port}/")
    wait_for(page, "the prompt", lambda s: "Press Connect" in s["notice"])


def test_a_port_that_is_busy_is_told_and_leaves_nothing_behind(bridge: SerialBridge, page: Page) -> None:
    connected(bridge, page)
    page.evaluate("window.__isBusy = true")
    page.keyboard.press("k")
    state = wait_for(page, "the reason", lambda s: "is another program using it" in s["notice"])
    assert state["lines"] == []
    page.evaluate("window.__isBusy = false")
    page.keyboard.press("k")
    wait_for(page, "forces", lambda s: sensor_of(s)["wrench"]["validity"] == [1] * 6)
    page.keyboard.press("k")
    state = wait_for(page, "that it is", lambda s: s["notice"] == "This port is connected already.")
    assert len(state["lines"]) == 1
    page.keyboard.press("z")
    wait_for(page, "no complaint of a sensor that is not there", lambda s: s["notice"] == "")


def test_a_port_is_given_back_for_a_recording_and_taken_again(bridge: SerialBridge, page: Page, recorded: Path) -> None:
    connected(bridge, page)
    for _ in range(2):
        page.keyboard.press("k")
        wait_for(page, "forces", lambda s: sensor_of(s)["wrench"]["values"] and not sensor_of(s)["isReplay"])
        drop_file(page, recorded)
        wait_for(page, "the recording", lambda s: sensor_of(s)["isReplay"])
        page.keyboard.press("b")
        wait_for(page, "the prompt", lambda s: "Press Connect" in s["notice"] and s["lines"] == [])


def test_the_force_is_the_twins(bridge: SerialBridge, page: Page, steered: Steered) -> None:
    connected(bridge, page)
    page.keyboard.press("k")
    wait_for(page, "valid forces", lambda s: sensor_of(s)["wrench"]["validity"] == [1] * 6)
    steered.move_to(Pose(1e-3, 0.5e-3, 0.6e-3))
    wait_for(
        page, "a press", lambda s: sensor_of(s)["wrench"]["values"][2] < -0.3 and sensor_of(s)["field"]["sum"][2] < 0
    )

    def is_true(force_n: float) -> bool:
        """The truth at each look: while a frame is made the ball's force is on its way."""
        return force_n == pytest.approx(steered.wrench[2], rel=0.25)

    wait_for(page, "its force", lambda s: is_true(sensor_of(s)["wrench"]["values"][2]))
    wait_for(page, "its field", lambda s: is_true(sensor_of(s)["field"]["sum"][2]))


def test_a_browser_without_webserial_is_told_what_to_do(bridge: SerialBridge, page: Page) -> None:
    page.add_init_script("delete Navigator.prototype.serial")
    page.goto(f"http://127.0.0.1:{bridge.port}/")
    wait_for(page, "the way out", lambda s: "start `ruffini view`" in s["notice"])
