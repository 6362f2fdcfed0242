"""Debian's Chromium and the viewer's server, for tests of the page."""

from __future__ import annotations

import base64
import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol
from unittest import mock

from aiohttp import web
from hang import Patience
from playwright.sync_api import Browser, Page, sync_playwright
from told_sensor import ToldSensor

from ruffini.view.guided import serving
from ruffini.view.line import Line, SharedLine

CHROMIUM = "/usr/bin/chromium-headless-shell"
# WebGL by the processor, as without a graphics card; what else the page is put together of needs no WebGL there, which
# would take twice the processor's time.
SOFTWARE_GL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing"]
SHUTDOWN_S = 0.01  # that the server waits twice for a page that is still open; a person's 1 s is two a test
LOOK_MS, LONGEST_LOOK_MS = 20, 200  # between two looks at the page's state: each costs both sides
KINDS = ("wrench", "field")


class Evaluates(Protocol):
    """Of a page, in whatever browser."""

    def evaluate(self, expression: str) -> Any: ...


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    """One browser; `make test` installs it."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        yield browser
        browser.close()


@contextlib.contextmanager
def viewer(*ports: str | Line) -> Iterator[str]:
    """The server in a thread of its own; yields its address. It does not wait for open pages at its end."""
    told, runner = list[str](), web.AppRunner
    lines = [SharedLine(port) if isinstance(port, str) else port for port in ports]

    def hurried(*arguments: Any, **options: Any) -> web.AppRunner:
        return runner(*arguments, **options | {"shutdown_timeout": SHUTDOWN_S})

    with mock.patch.object(web, "AppRunner", hurried), serving(lines, 0, told.append):
        yield told[0]


def state_of(page: Evaluates) -> dict[str, Any]:
    """What the page says that it shows."""
    return page.evaluate("JSON.parse(JSON.stringify(window.__state ?? {lines: []}))")  # type: ignore[no-any-return]


def wait_for(
    page: Evaluates,
    what: str,
    accept: Callable[[Any], bool],
    state_of: Callable[[Evaluates], Any] = state_of,
) -> Any:
    """The page's state, or that part of it which `state_of` reads, once it is accepted."""
    patience, look_ms = Patience(), float(LOOK_MS)
    while not patience.is_over():
        state = state_of(page)
        with contextlib.suppress(KeyError, IndexError, TypeError, ValueError):
            if accept(state):
                return state
        time.sleep(1e-3 * look_ms)  # by the page's own clock it would cost as much as the look
        look_ms = min(1.2 * look_ms, LONGEST_LOOK_MS)
    raise AssertionError(f"the page never showed {what}: {state}")


HEAR = """() => {
  const [notice, said] = [document.querySelector("#notice"), (window.__said = [])];
  const options = { childList: true, characterData: true, subtree: true };
  new MutationObserver(() => said.push(notice.textContent)).observe(notice, options);
}"""


def press(page: Page, key: str, says: str) -> None:
    """Press a key; a notice of after that has these words, however soon the next one takes its place."""
    page.evaluate(HEAR)
    page.keyboard.press(key)
    wait_for(page, says, lambda _: says in "\n".join(page.evaluate("window.__said")))


def step(page: Evaluates, *sensors: ToldSensor, n: int = 1) -> dict[str, Any]:
    """Let each sensor, one a line of the page, send a frame and the page draw it, `n` times; the page's state then."""
    for _ in range(n):
        frames = [sensor.send() for sensor in sensors]
        state = wait_for(page, f"frames {frames}", lambda s, f=frames: newest_of(s) == f)  # type: ignore[misc]
    return state  # type: ignore[no-any-return]


def newest_of(state: dict[str, Any]) -> list[int]:
    """Of each line the frame that all its sensors' wrenches are of, and their fields where they have some; else -1."""
    newest = []
    for line in state["lines"]:
        shown = [sensor[kind]["frame"] for sensor in line["sensors"].values() for kind in KINDS if sensor.get(kind)]
        newest.append(shown[0] if len(set(shown)) == 1 else -1)
    return newest


def drop_file(page: Page, path: Path) -> None:
    """As a person drops it on the page."""
    page.evaluate(
        """([name, data]) => {
          const transfer = new DataTransfer();
          transfer.items.add(new File([Uint8Array.from(atob(data), (c) => c.charCodeAt(0))], name));
          document.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, cancelable: true }));
        }""",
        [path.name, base64.b64encode(path.read_bytes()).decode()],
    )


def sensor_of(state: dict[str, Any], line: int = 0, sensor: int = 0) -> Any:
    """One sensor in the page's state."""
    return state["lines"][line]["sensors"][str(sensor)]


def colours_in(page: Page, selector: str) -> int:
    """How many different colours a canvas shows: 1 is an empty one."""
    return int(
        page.eval_on_selector(
            selector,
            """canvas => {
              const copy = document.createElement("canvas");
              [copy.width, copy.height] = [canvas.width, canvas.height];
              const context = copy.getContext("2d");
              context.drawImage(canvas, 0, 0);
              const pixels = context.getImageData(0, 0, copy.width, copy.height).data;
              const seen = new Set();
              for (let i = 0; i < pixels.length; i += 4) seen.add(pixels[i] << 16 | pixels[i + 1] << 8 | pixels[i + 2]);
              return seen.size;
            }""",
        )
    )
