"""The page in a browser that is not Chromium; and without WebSerial, as Safari is without, where that is told."""

from __future__ import annotations

import functools
import http.server
import threading
from collections.abc import Iterator

import pytest
from browser import sensor_of, step, viewer, wait_for
from firefox import FirefoxPage, firefox
from told_sensor import SCHEMA, ToldSensor, info_of, told_field

from ruffini.boards import find_board
from ruffini.view.server import page_folder

COLOURS = """(() => {
  const canvas = document.querySelector(".maps canvas");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(new Uint32Array(pixels.buffer)).size;
})()"""


@pytest.fixture(scope="module")
def page() -> Iterator[FirefoxPage]:
    with firefox() as page:
        yield page
        assert page.faults == []


def test_it_shows_what_is_sent(page: FirefoxPage) -> None:
    teller = told_field(31, 25)
    with (
        ToldSensor([info_of(find_board("gelslim"), grid=(31, 25))], teller, rate_hz=None) as sensor,
        viewer(sensor.port) as address,
    ):
        page.goto(address)
        step(page, sensor)
        state = wait_for(page, "a field", lambda s: sensor_of(s)["field"] and sensor_of(s)["wrench"])
        n_colours = page.evaluate(COLOURS)
    shown = sensor_of(state)
    wrench = teller(shown["wrench"]["frame"], SCHEMA.new("Stamp"))["WRENCH"]
    assert shown["wrench"]["values"][2] == pytest.approx(wrench.force_z_un * 1e-6)
    assert shown["maps"]["normal"] == "values"
    assert n_colours > 20


def test_without_webserial_and_the_server_it_says_what_works(page: FirefoxPage) -> None:
    page.run_before_scripts("() => { delete Navigator.prototype.serial; }")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(page_folder()))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page.goto(f"http://localhost:{server.server_port}/")
        notice = "document.querySelector('#notice').textContent"
        wait_for(page, "a sentence", lambda _: "start `ruffini view` on this computer" in page.evaluate(notice))
        server.shutdown()
