"""The page with every kind of board, told by a sensor that only talks: what is shown, and what must not be."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import colours_in, sensor_of, state_of, step, viewer, wait_for
from google.protobuf import descriptor_pb2
from hang import until
from playwright.sync_api import Page
from test_bad_input import HOST
from told_sensor import (
    SCHEMA,
    Messages,
    Teller,
    ToldSensor,
    info_of,
    told_field,
    told_skin,
    told_tip,
    told_tray,
    told_uncertain,
)

from ruffini.boards import find_board
from ruffini.wire import Schema

ABSENT = "\u2013"
TOO_WIDE = """() => [document.documentElement, ...document.querySelectorAll(".cell, .maps figcaption")]
  .filter(e => e.scrollWidth > e.clientWidth).map(e => e.innerText.slice(0, 40))"""
LAST = 39  # frame of a sensor that then falls silent


def boards() -> list[Any]:
    """Every kind of sensor: board, what it says, nodes, what the page must then show."""
    tube = find_board("eltac").skin
    assert tube is not None
    return [
        pytest.param("gelslim", told_field(31, 25), (31, 25), ["normal", "shear", "sigma"], id="field"),
        pytest.param("ftouch", told_tray, None, [], id="wrench only"),
        pytest.param("eltac", told_skin(tube.radius_um), None, [], id="skin"),
        pytest.param("stereo-fingertip", told_tip, None, [], id="fingertip"),
    ]


def is_shown(state: dict[str, Any], maps: list[str]) -> bool:
    """Frames were drawn, with a wrench and just these maps' values: a field is a packet of its own."""
    shown = sensor_of(state)
    with_values = [name for name, word in shown["maps"].items() if word == "values"]
    return state["lines"][0]["nDrawn"] > 3 and bool(shown["wrench"]) and with_values == maps


def said_of(page: Page, component: int) -> str:
    """A component of the wrench as it is written."""
    return page.inner_text(f".cell:nth-child({component + 1}) output")


@pytest.mark.parametrize(("name", "teller", "grid", "maps"), boards())
def test_every_kind_of_board_is_shown_from_what_it_says_about_itself(
    page: Page, name: str, teller: Teller, grid: tuple[int, int] | None, maps: list[str]
) -> None:
    board = find_board(name)
    with ToldSensor([info_of(board, grid=grid)], teller, rate_hz=None) as sensor, viewer(sensor.port) as address:
        page.goto(address)
        step(page, sensor, n=4)
        state = wait_for(page, "frames", lambda s: is_shown(s, maps))
        wait_for(page, "a picture", lambda _: colours_in(page, ".stage canvas") > 50)
        absent = [validity == 0 for validity in sensor_of(state)["wrench"]["validity"]]
        wait_for(page, "the numbers", lambda _: [said_of(page, i) == ABSENT for i in range(6)] == absent)
    shown = sensor_of(state)
    assert shown["board"] == name
    wrench: Any = teller(shown["wrench"]["frame"], Schema.own().new("Stamp"))["WRENCH"]
    assert shown["wrench"]["validity"] == list(wrench.validity)
    assert shown["wrench"]["values"][2] == pytest.approx(wrench.force_z_un * 1e-6)
    for i, validity in enumerate(wrench.validity):
        assert (said_of(page, i) == ABSENT) == (validity == 0)
        assert (shown["wrench"]["values"][i] is None) == (validity == 0)
    assert shown["wrench"]["sigma"][2] == pytest.approx(5e-3)
    assert page.inner_text("h2 >> nth=0") == board.board.product


def test_what_is_invalid_or_uncalibrated_is_marked_and_in_no_chart(page: Page) -> None:
    board = find_board("gelsight-mini")
    infos = [info_of(board, grid=(20, 16))]
    with ToldSensor(infos, told_uncertain, rate_hz=None) as sensor, viewer(sensor.port) as address:
        page.goto(address)
        step(page, sensor, n=4)
        marks = ["invalid", "invalid", "uncalibrated", "not measured", "not measured", "invalid"]
        wait_for(
            page, "marks", lambda s: [page.inner_text(f".cell:nth-child({i}) .note") for i in range(1, 7)] == marks
        )
        wait_for(page, "badges", lambda s: {"uncalibrated z", "dark"} <= set(page.locator(".badge").all_inner_texts()))
        wait_for(page, "marked maps", lambda s: maps_of(s, "normal", "shear") == ["uncalibrated", "invalid"])


def test_two_pads_of_one_line_and_two_lines_stand_side_by_side(page: Page) -> None:
    board = find_board("gelslim")
    pads = [info_of(board, i, (31, 25)) for i in range(2)]
    with (
        ToldSensor(pads, told_field(31, 25), serial="left", rate_hz=None) as left,
        ToldSensor([info_of(find_board("ftouch"))], told_tray, serial="right", rate_hz=None) as right,
        viewer(left.port, right.port) as address,
    ):
        page.goto(address)
        step(page, left, right, n=3)
        state = wait_for(page, "both", lambda s: min(line["nDrawn"] for line in s["lines"]) > 2)
        wait_for(page, "both pads", lambda s: sensor_of(s, 0, 1)["wrench"] and sensor_of(s, 1, 0)["wrench"])
        assert page.locator("section.sensor").count() == 3
    assert [line["serial"] for line in state["lines"]] == ["left", "right"]


WIDTHS_PX = (400, 900, 1280, 1800)


def test_two_sensors_stand_beside_each_other_where_there_is_room_and_no_number_leaves_its_cell(page: Page) -> None:
    pad = info_of(find_board("gelslim"), 0, (31, 25))
    with (
        ToldSensor([pad], told_field(31, 25), serial="left", rate_hz=None) as left,
        ToldSensor([pad], told_field(31, 25), serial="right", rate_hz=None) as right,
        viewer(left.port, right.port) as address,
    ):
        page.goto(address)
        step(page, left, right, n=3)
        wait_for(page, "both", lambda s: min(line["nDrawn"] for line in s["lines"]) > 2 and len(s["lines"]) == 2)
        for width_px in WIDTHS_PX:
            page.set_viewport_size({"width": width_px, "height": 900})
            for unit in ("N", "mN", "gf"):
                wait_for(page, unit, lambda _, u=unit: page.locator(".cell .unit").first.inner_text() == u)  # type: ignore[misc]
                step(page, left, right)
                assert page.evaluate(TOO_WIDE) == [], width_px
                page.keyboard.press("u")
            for part in ("sensor", "health"):
                first, second = (page.locator(f"section.{part}").nth(i).bounding_box() for i in range(2))
                assert first is not None
                assert second is not None
                if width_px > 1000:
                    assert first["y"] == second["y"]
                    assert first["x"] + first["width"] <= second["x"]
                else:
                    assert first["y"] + first["height"] <= second["y"]


WHITE = """() => {
  const canvas = document.querySelector(".maps figure:nth-child(2) canvas");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let n = 0;
  for (let i = 0; i < pixels.length; i += 4) n += Math.min(pixels[i], pixels[i + 1], pixels[i + 2]) > 200;
  return n;
}"""
CORNER = """() => {
  const [from, to] = [document.querySelector(".stage canvas"), document.createElement("canvas")];
  [to.width, to.height] = [from.width, from.height];
  to.getContext("2d").drawImage(from, 0, 0);
  return [...to.getContext("2d").getImageData(3, 3, 1, 1).data.slice(0, 3)];
}"""


def test_shear_is_told_without_colour_the_keys_turn_the_pad_and_the_theme_follows_the_system(page: Page) -> None:
    pad = info_of(find_board("gelslim"), 0, (31, 25))
    page.emulate_media(color_scheme="dark", reduced_motion="reduce")
    with ToldSensor([pad], told_field(31, 25), rate_hz=None) as sensor, viewer(sensor.port) as address:
        page.goto(address)
        step(page, sensor, n=4)
        state = wait_for(page, "frames", lambda s: sensor_of(s)["field"] and s["lines"][0]["nDrawn"] > 3)
        assert page.evaluate(WHITE) > 50  # no hue of the wheel is over 170 in all colours: these are the arrows
        wait_for(page, "a dark picture", lambda _: max(page.evaluate(CORNER)) < 60)
        page.focus(".stage")
        from_ = sensor_of(state)["seenFrom"]
        for key in ("ArrowLeft", "+"):
            before = sensor_of(state)["seenFrom"]
            page.keyboard.press(key)
            state = wait_for(page, key, lambda s, b=before: sensor_of(s)["seenFrom"] != b)  # type: ignore[misc]
        page.keyboard.press("Home")
        wait_for(page, "as at first", lambda s: sensor_of(s)["seenFrom"] == pytest.approx(from_))
        page.emulate_media(color_scheme="light", reduced_motion="no-preference")
        wait_for(page, "a light picture", lambda _: min(page.evaluate(CORNER)) > 200)


def test_an_older_schema_is_fetched_and_decoded(page: Page) -> None:
    """A sensor whose schema is another one: fields that this page knows are shown, those it lacks are absent."""
    files = descriptor_pb2.FileDescriptorSet.FromString(Schema.own().bytes)
    field = next(m for m in files.file[0].message_type if m.name == "Field")
    for part in [f for f in field.field if f.name in ("sigma", "sigma_validity", "slip")]:
        field.field.remove(part)
    schema = files.SerializeToString()
    infos = [info_of(find_board("gelslim"), grid=(31, 25))]
    sensor = ToldSensor(infos, told_field(31, 25), schema=schema, rate_hz=None)
    with sensor, viewer(sensor.port) as address:
        page.goto(address)
        step(page, sensor)
        state = wait_for(page, "a field", lambda s: sensor_of(s)["field"])
    assert sensor_of(state)["maps"]["normal"] == "values"
    assert sensor_of(state)["maps"]["sigma"] == "not measured"


READ_MS = 4000  # of the page: how long a notice stands at least
SET_CLOCK = "window.__nowMs = 1000; performance.now = () => window.__nowMs;"


def test_an_answer_can_be_read_before_the_newest_news_takes_its_place_and_what_is_over_goes(page: Page) -> None:
    is_stalled, is_back = threading.Event(), threading.Event()

    def tell(frame: int, stamp: Any) -> Messages:
        told: Messages = {}
        for happened, severity, what, text in (
            (is_stalled, 2, "camera_stalled", "the camera stalled"),
            (is_back, 1, "camera_back", "frames come again"),
        ):
            if happened.is_set():
                happened.clear()
                told["EVENT"] = SCHEMA.new("Event", severity=severity, what=what, text=text)
        return told | told_tray(frame, stamp)  # the news first: where the page has the wrench, it has them, too

    page.add_init_script(SET_CLOCK)
    with ToldSensor([info_of(find_board("ftouch"))], tell, rate_hz=None) as sensor, viewer(sensor.port) as address:
        page.goto(address)
        step(page, sensor, n=3)
        page.keyboard.press("z")
        wait_for(page, "the answer", lambda s: s["notice"] == "done")
        assert later(page, sensor, 0, is_stalled) == "done"
        assert later(page, sensor, READ_MS - 1, is_back) == "done"
        assert later(page, sensor, 2) == "frames come again"
        assert page.get_attribute("#notice", "class") == "warn"
        assert later(page, sensor, READ_MS - 1) == "frames come again"
        assert later(page, sensor, 2) == "", "nothing is left to do"
        assert not page.is_visible("#notice")
        assert later(page, sensor, 0, is_stalled) == "the camera stalled"
        assert page.get_attribute("#notice", "class") == "bad"
        assert later(page, sensor, 100 * READ_MS) == "the camera stalled", "until it is over"


def later(page: Page, sensor: ToldSensor, ms: int, happens: threading.Event | None = None) -> str:
    """The page's notice so much later by its own clock, after a frame beside which this happens."""
    page.evaluate("ms => { window.__nowMs += ms; }", ms)
    if happens:
        happens.set()
    return str(step(page, sensor)["notice"])


def maps_of(state: dict[str, Any], *names: str) -> list[str]:
    return [sensor_of(state)["maps"][name] for name in names]


TEN_FRAMES = """new Promise(done => {
  const wait = n => n ? requestAnimationFrame(() => wait(n - 1)) : done();
  wait(10);
})"""


def picture_of(page: Page) -> list[int]:
    """The three dimensions as 24 x 20 squares of a colour, red, green, blue in turn."""
    found: list[int] = page.eval_on_selector(
        ".stage canvas",
        """canvas => {
          const small = document.createElement("canvas");
          [small.width, small.height] = [24, 20];
          const context = small.getContext("2d");
          context.imageSmoothingQuality = "high";
          context.drawImage(canvas, 0, 0, 24, 20);
          return [...context.getImageData(0, 0, 24, 20).data].filter((_, i) => i % 4 !== 3);
        }""",
    )
    return found


def still_picture(page: Page) -> list[int]:
    """Of what no longer changes: the same for forty of the browser's frames."""
    shown = [picture_of(page)]
    while len(shown) < 5 or any(picture != shown[-1] for picture in shown[-5:]):
        assert len(shown) < 100, "it is still changing"
        page.evaluate(TEN_FRAMES)
        shown.append(picture_of(page))
    return shown[-1]


@pytest.mark.parametrize("name", ["gelslim", "eltac", "stereo-fingertip"])
def test_without_a_graphics_card_the_same_is_drawn_and_the_last_is_never_left_out(page: Page, name: str) -> None:
    """Once the sensor falls silent, field, numbers and picture are of its last frame, whoever draws."""
    board = find_board(name)
    tube, grid = board.skin, (39, 31) if name == "gelslim" else None
    teller = told_field(39, 31) if grid else told_skin(tube.radius_um) if tube else told_tip
    pictures = []
    for draw in ("webgl", "software"):
        with ToldSensor([info_of(board, grid=grid)], teller, rate_hz=None) as sensor, viewer(sensor.port) as address:
            page.goto(f"{address}?draw={draw}")
            sensor.send(LAST + 1)
            state = wait_for(page, "the last frame", lambda s: sensor_of(s)["wrench"]["frame"] == LAST)
            number = f"{sensor_of(state)['wrench']['values'][2]:.3f}".replace("-", "\u2212")
            wait_for(page, "its number", lambda s: page.inner_text(".cell:nth-child(3) output") == number)  # noqa: B023
            wait_for(page, "its field", lambda s: (sensor_of(s).get("field") or {"frame": LAST})["frame"] == LAST)
            assert page.locator(".scale").first.inner_text().endswith("no graphics card") == (draw == "software")
            pictures.append(still_picture(page))
    apart = np.abs(np.subtract(*pictures)).reshape(-1, 3).mean(axis=1)
    print(f"{name}: squares of the two pictures are {apart.mean():.1f} of 255 apart, {apart.max():.0f} at most")
    assert np.ptp(pictures[0]) > 100
    assert apart.mean() < 4


def test_of_many_fields_of_1200_nodes_the_newest_is_shown(page: Page) -> None:
    """They are written as fast as the line takes them, which is faster than any page draws."""
    sensor = ToldSensor([info_of(find_board("gelslim"), grid=(40, 30))], told_field(40, 30), rate_hz=None)
    with sensor, viewer(sensor.port) as address:
        page.goto(address)
        before = step(page, sensor, n=3)["lines"][0]["nDrawn"]
        newest = sensor.send(180)
        state = wait_for(page, "the newest", lambda s: sensor_of(s)["field"]["frame"] == newest)
    assert state["lines"][0]["nDrawn"] - before <= 2 * 180  # of a frame wrench and field may be drawn one by one


@pytest.mark.realtime
def test_1200_nodes_come_as_fast_as_they_are_sent_and_the_newest_is_shown(page: Page) -> None:
    """Fields of 1,200 nodes, 60 a second; how many are drawn on this computer's software renderer is printed."""
    sensor = ToldSensor([info_of(find_board("gelslim"), grid=(40, 30))], told_field(40, 30), rate_hz=60)
    with sensor, viewer(sensor.port) as address:
        page.goto(address)
        before = wait_for(page, "fields", lambda s: sensor_of(s)["field"] and s["lines"][0]["nDrawn"] > 2)
        start, n_before = time.monotonic(), sensor.n_frames
        page.wait_for_timeout(3000)
        state, n_sent, elapsed_s = state_of(page), sensor.n_frames, time.monotonic() - start
        assert sensor_of(state)["field"]["frame"] > n_before
    drawn = state["lines"][0]["nDrawn"] - before["lines"][0]["nDrawn"]
    behind = n_sent - sensor_of(state)["field"]["frame"]
    print(
        f"{(n_sent - n_before) / elapsed_s:.0f} fields/s sent, {drawn / elapsed_s:.0f} drawn/s, {behind} frames behind"
    )


def test_view_opens_the_persons_browser_on_the_page(tmp_path: Path) -> None:
    note, browser = tmp_path / "address", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" > {note}\n')
    browser.chmod(0o755)
    with ToldSensor([info_of(find_board("ftouch"))], told_tray) as sensor:
        command = [*HOST, "--port", sensor.port, "view", "--http-port", "0"]
        environment = os.environ | {"BROWSER": str(browser)}
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as process:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            until(lambda: note.exists() and note.read_text(), "the browser's start")
            process.send_signal(signal.SIGINT)
    assert note.read_text().strip() == address
    assert address.startswith("http://127.0.0.1:")


def test_the_sensor_is_asked_for_what_the_person_chose(page: Page) -> None:
    number = SCHEMA.type_numbers

    def asked() -> dict[int, int]:
        newest = [c.subscribe for c in sensor.commands if c.WhichOneof("action") == "subscribe"][-1]
        return {s.type: s.every for s in newest.subscriptions if s.every}

    with (
        ToldSensor([info_of(find_board("gelslim"), 0, (31, 25))], told_field(31, 25), rate_hz=None) as sensor,
        viewer(sensor.port) as address,
    ):
        page.goto(address)
        step(page, sensor, n=4)
        wait_for(page, "frames", lambda s: s["lines"][0]["nDrawn"] > 3)
        assert asked()[number["FIELD"]] == 1
        assert number["IMAGE"] not in asked()
        page.keyboard.press("m")
        page.select_option("#rates select[name=field]", label="each 4th")
        page.select_option("#rates select[name=wrench]", label="off")
        page.select_option("#rates select[name=image]", label="each 30th")
        wait_for(page, "the sensor being asked", lambda _: asked().get(number["IMAGE"]) == 30)
        assert asked()[number["FIELD"]] == 4
        assert number["WRENCH"] not in asked()
        page.keyboard.press("Escape")
        page.keyboard.press("c")
        wait_for(page, "no picture", lambda _: number["IMAGE"] not in asked())
