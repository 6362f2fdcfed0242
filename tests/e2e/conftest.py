"""The tiny sensor and its twin, made once."""

from __future__ import annotations

import pkgutil
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hang import HANG_S
from tiny_sensor import Sensor, make_sensor
from tiny_twin import Twin, make_twin, slowed

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


LOCAL = re.compile(r"(https?|wss?)://(127\.0\.0\.1|localhost)[:/]|blob:|data:|file:")


@pytest.fixture(scope="module", autouse=True)
def _busy_computer() -> Iterator[None]:
    """What is late for want of a core has neither fallen silent nor been unplugged."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name in (("watch", "MIN_SILENCE_S"), ("marlin", "START_S"), ("grbl", "START_S")):
            where = f"ruffini.rig.{module}.{name}"
            patch.setattr(where, 10 * pkgutil.resolve_name(f"ruffini.rig.{module}:{name}"))
        yield


@pytest.fixture(scope="module")
def chrome() -> Iterator[Browser]:
    """Debian's Chromium; `make test` installs it."""
    from browser import chromium

    with chromium() as found:
        yield found


# What draws sixty times a second without a graphics card takes most of a core from the tests beside it.
TWENTY_DRAWINGS_A_SECOND = """(() => {
  const own = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (callback) => setTimeout(() => own(callback), 33);
})()"""


@pytest.fixture
def page(chrome: Browser) -> Iterator[Page]:
    """A page in which no script fails, and which asks nobody but this computer."""
    page = chrome.new_page(viewport={"width": 800, "height": 600})
    page.set_default_timeout(1e3 * HANG_S)
    page.add_init_script(TWENTY_DRAWINGS_A_SECOND)
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", lambda request: LOCAL.match(request.url) or faults.append(request.url))
    page.on("websocket", lambda socket: LOCAL.match(socket.url) or faults.append(socket.url))
    yield page
    page.close()
    assert faults == []


@pytest.fixture(scope="session")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Sensor:
    return make_sensor(tmp_path_factory.mktemp("sensor"))


@pytest.fixture(scope="session")
def twin(sensor: Sensor, tmp_path_factory: pytest.TempPathFactory) -> Twin:
    return make_twin(sensor, tmp_path_factory.mktemp("twin"))


@pytest.fixture(scope="session")
def bench_twin(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Twin:
    """For minutes of simulated time at a bench: its camera is so slow that not every stall shows as repeated frames."""
    return slowed(twin, tmp_path_factory.mktemp("bench_twin"))
