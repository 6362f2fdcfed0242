"""Pictures of the page of `ruffini view`, to be looked at: every kind of board, its views, what a fault looks like.

Debian's Chromium (`make test` installs it) on the demo's real daemon and twin, and on sensors that only talk for the
other boards. All SIMULATED. Prints what is on each picture.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from playwright.sync_api import Browser, Page

from ruffini.boards import find_board
from ruffini.view.demo import running_demo

sys.path.insert(0, str(Path(__file__).parents[1] / "e2e"))
from browser import chromium, sensor_of, viewer, wait_for
from told_sensor import Teller, ToldSensor, info_of, told_field, told_skin, told_tip, told_tray, told_uncertain

DEMO = "gelslim"
PRESSED_N, TWISTED_N = 1.0, 2.4  # of the demo's presses, when its pictures are taken
SIZE, NARROW = (1280, 900), (420, 900)
SETTLE_MS = 1500  # charts have something to show
DRAWN_MS = 200  # what was said last is on the screen, also without a graphics card


class Album:
    """Pages of one browser, and the folder that their pictures go to."""

    def __init__(self, browser: Browser, folder: Path) -> None:
        self._browser, self._folder, self._n = browser, folder, 0

    @contextlib.contextmanager
    def page(self, address: str, size: tuple[int, int] = SIZE) -> Iterator[Page]:
        page = self._browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark")
        page.goto(address)
        wait_for(page, "a frame", lambda s: min(line["nDrawn"] for line in s["lines"]) > 2)
        yield page
        page.close()

    def add(self, page: Page, name: str, what: str) -> None:
        self._n += 1
        path = self._folder / f"{self._n:02d}-{name}.png"
        page.wait_for_timeout(DRAWN_MS)
        page.screenshot(path=path, full_page=True)
        print(f"{path.name}: {what}", flush=True)


def wait_for_press(page: Page, least_n: float = PRESSED_N) -> None:
    wait_for(page, "a press", lambda s: sensor_of(s)["wrench"]["values"][2] < -least_n, 60.0)


def demo(album: Album, folder: Path) -> None:
    """The force field, live."""
    with running_demo(DEMO) as port, viewer(port) as address:
        with album.page(address) as page:
            page.wait_for_timeout(3 * SETTLE_MS)
            wait_for_press(page, TWISTED_N)
            page.keyboard.press(" ")  # a picture takes longer than the press
            album.add(page, "field", f"{DEMO} pressed, frozen: field, wrench, maps, contacts, charts, health")
            page.keyboard.press(" ")
            page.keyboard.press("i")
            page.keyboard.press("t")
            page.keyboard.press("u")
            wait_for_press(page)
            album.add(page, "light-slip", "light theme, surface coloured by slip, millinewtons")
            page.keyboard.press("t")
            page.keyboard.press("c")
            page.keyboard.press("e")
            page.wait_for_timeout(SETTLE_MS)
            wait_for_press(page)
            album.add(page, "camera-residual", "with the camera's picture and what the forces do not explain")
            page.keyboard.press("r")
            page.wait_for_timeout(2 * SETTLE_MS)
            album.add(page, "recording", "while it records")
            with page.expect_download() as download:
                page.keyboard.press("r")
            download.value.save_as(folder / "run.mcap")
            page.keyboard.press("?")
            album.add(page, "help", "what the keys do")
            page.keyboard.press("Escape")
            page.keyboard.press("m")
            album.add(page, "rates", "what the sensor is asked for")
        with album.page(f"{address}?draw=webgl") as page:
            wait_for_press(page)
            album.add(page, "webgl", "the same by WebGL")
        with album.page(address, NARROW) as page:
            wait_for_press(page)
            album.add(page, "narrow", "on a narrow screen")
        with album.page(address) as page:
            page.set_input_files("#file", folder / "run.mcap")
            wait_for(page, "the recording", lambda s: sensor_of(s)["isReplay"] and sensor_of(s)["field"])
            page.wait_for_timeout(SETTLE_MS)
            album.add(page, "replay", "that recording, dropped on the page")
            (folder / "none.mcap").write_bytes(b"no recording")
            page.set_input_files("#file", folder / "none.mcap")
            page.wait_for_timeout(SETTLE_MS)
            album.add(page, "no-recording", "a file that is no recording")


def told(album: Album) -> None:
    """Boards without a field, and marks."""
    tube = find_board("eltac").skin
    assert tube is not None
    boards: list[tuple[str, Teller, tuple[int, int] | None, str]] = [
        ("eltac", told_skin(tube.radius_um), None, "a glowing skin"),
        ("stereo-fingertip", told_tip, None, "a fingertip"),
        ("ftouch", told_tray, None, "a tray on springs"),
        ("gelsight-mini", told_uncertain, (20, 16), "what is invalid, uncalibrated, not measured"),
    ]
    for name, teller, grid, what in boards:
        with (
            ToldSensor([info_of(find_board(name), grid=grid)], teller) as sensor,
            viewer(sensor.port) as address,
            album.page(address) as page,
        ):
            page.wait_for_timeout(SETTLE_MS)
            album.add(page, name, f"{what} (made-up numbers)")


def side_by_side(album: Album) -> None:
    """Two sensors; then one is gone."""
    pad = info_of(find_board(DEMO), 0, (31, 25))
    with contextlib.ExitStack() as stack, contextlib.ExitStack() as unplug:
        right = unplug.enter_context(ToldSensor([pad], told_field(31, 25), serial="right"))
        left = stack.enter_context(ToldSensor([pad], told_field(31, 25), serial="left"))
        page = stack.enter_context(album.page(stack.enter_context(viewer(left.port, right.port)), (1800, 1000)))
        page.wait_for_timeout(SETTLE_MS)
        album.add(page, "two-pads", "two pads side by side (made-up numbers)")
        unplug.close()
        page.wait_for_timeout(2 * SETTLE_MS)
        album.add(page, "line-lost", "one of them unplugged")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/page"))
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with chromium() as browser, tempfile.TemporaryDirectory() as folder:
        album = Album(browser, out)
        parts: list[Callable[[], None]] = [
            lambda: side_by_side(album), lambda: told(album), lambda: demo(album, Path(folder)),
        ]  # fmt: skip
        for part in parts:
            part()


if __name__ == "__main__":
    main()
