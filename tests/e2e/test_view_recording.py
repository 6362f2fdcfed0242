"""Recordings and the page: what it records others read, what `ruffini record` wrote it shows, others it refuses."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from browser import drop_file, press, sensor_of, step, viewer, wait_for
from foreign_reader import compare
from mcap.reader import make_reader
from playwright.sync_api import Page
from tiny_sensor import N_FRAMES, Sensor, start
from told_sensor import ToldSensor, info_of, told_field

from ruffini.boards import find_board
from ruffini.device import Connection
from ruffini.record import Recording, record_stream
from ruffini.wire import Decoder, Schema

N_RECORDED = 10


def open_file(page: Page, path: Path) -> None:
    page.set_input_files("#file", path)


@pytest.fixture
def told() -> ToldSensor:
    return ToldSensor([info_of(find_board("gelslim"), grid=(31, 25))], told_field(31, 25), rate_hz=None)


def test_what_the_page_records_others_read_and_it_shows_again(page: Page, told: ToldSensor, tmp_path: Path) -> None:
    path = tmp_path / "page.mcap"
    with told, viewer(told.port) as address:
        page.goto(address)
        step(page, told, n=4)
        page.keyboard.press("r")
        step(page, told, n=N_RECORDED)
        with page.expect_download() as download:
            page.keyboard.press("r")
        download.value.save_as(path)
        schema, frames, messages = Schema.own(), Counter[str | None](), Counter[str]()
        decoder = Decoder()
        with path.open("rb") as stream:
            for kind, channel, message in make_reader(stream).iter_messages():
                if channel.topic == "/ruffini/raw":
                    frames.update(schema.type_name(f.type) for f in decoder.feed(message.data))
                else:
                    assert kind is not None
                    assert kind.encoding == "protobuf"
                    messages[kind.name] += 1
        assert messages["ruffini.Hello"] == 1
        assert messages["ruffini.Field"] == messages["ruffini.Wrench"] == frames["FIELD"] == N_RECORDED
        assert decoder.counters.bad_crc == decoder.counters.malformed == 0
        recording = Recording(path)
        with_wrench = [frame for frame in recording.frames() if frame.wrench is not None]
        assert len(with_wrench) > 5
        assert all(frame.is_simulated and frame.is_valid for frame in with_wrench)
        # A page that is slow gets of some frames the one result without the other.
        with_field = [frame for frame in recording.frames(partial=True) if frame.field is not None]
        assert abs(len(with_field) - messages["ruffini.Field"]) <= 1
        assert recording.problems == []
        counts = compare(path)
        assert min(counts["/ruffini/wrench"], counts["/ruffini/field"]) > 5
        open_file(page, path)
        state = wait_for(page, "the recording", lambda s: sensor_of(s)["isReplay"] and sensor_of(s)["field"])
    assert len(state["lines"]) == 1
    assert sensor_of(state)["board"] == "gelslim"
    assert sensor_of(state)["isSimulated"]


def test_what_ruffini_record_wrote_is_shown_to_its_end(page: Page, sensor: Sensor, tmp_path: Path) -> None:
    path = tmp_path / "host.mcap"
    with start(sensor, tmp_path / "store", "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        counts = record_stream(host, path)
    assert counts["WRENCH"] == N_FRAMES
    assert "HELLO" not in counts
    with ToldSensor([], told_field(2, 2)) as silent, viewer(silent.port) as address:
        page.goto(address)
        wait_for(page, "itself", lambda s: "notice" in s)
        open_file(page, path)
        state = wait_for(page, "the last frame", lambda s: sensor_of(s)["wrench"]["frame"] == N_FRAMES - 1)
        wait_for(page, "the end", lambda s: "The recording is over" in s["notice"])
    shown = sensor_of(state)
    assert shown["board"] == "tiny"
    assert shown["isSimulated"]
    assert shown["wrench"]["validity"] == [1] * 6
    assert shown["wrench"]["values"][2] < -0.1


@pytest.fixture
def recorded(sensor: Sensor, tmp_path: Path) -> Path:
    path = tmp_path / "host.mcap"
    with start(sensor, tmp_path / "store", "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        record_stream(host, path)
    return path


def test_a_file_that_is_none_is_refused_with_a_sentence_and_live_goes_back(
    page: Page, told: ToldSensor, tmp_path: Path
) -> None:
    paths = {
        "it is no MCAP file": b"no recording" * 50,
        "it was cut short before anything": b"\x89MCAP0\r\n" + bytes(5),
    }
    with told, viewer(told.port) as address:
        page.goto(address)
        step(page, told)
        assert not page.is_visible("text=Live")
        for why, data in paths.items():
            (tmp_path / "none.mcap").write_bytes(data)
            drop_file(page, tmp_path / "none.mcap")
            wait_for(page, "the reason", lambda _, w=why: f"cannot be shown: {w}" in page.inner_text("#notice"))  # type: ignore[misc]
        told.subscribed.clear()
        page.click("text=Live")
        step(page, told)
        wait_for(page, "frames again", lambda s: sensor_of(s)["field"] and not sensor_of(s)["isReplay"])
        assert not page.is_visible("text=Live")


def test_a_file_that_is_cut_is_shown_as_far_as_it_goes(page: Page, recorded: Path, tmp_path: Path) -> None:
    data = recorded.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 3 // 4])
    with ToldSensor([], told_field(2, 2)) as silent, viewer(silent.port) as address:
        page.goto(address)
        wait_for(page, "itself", lambda s: "notice" in s)
        drop_file(page, tmp_path / "cut.mcap")
        wait_for(page, "the end", lambda s: "cut short: it is shown as far as it goes" in s["notice"])
        state = wait_for(page, "its last frame", lambda s: sensor_of(s)["wrench"]["frame"] > 0)
    assert sensor_of(state)["isReplay"]
    assert sensor_of(state)["wrench"]["frame"] < N_FRAMES - 1


def test_a_recording_is_not_lost_when_another_file_is_opened_or_the_page_left(
    page: Page, told: ToldSensor, recorded: Path, tmp_path: Path
) -> None:
    asked: list[str] = []
    page.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.dismiss()))
    with told, viewer(told.port) as address:
        page.goto(address)
        step(page, told)
        page.keyboard.press("r")
        step(page, told, n=N_RECORDED)
        page.evaluate("setTimeout(() => location.reload())")
        wait_for(page, "the question", lambda _: asked == ["beforeunload"])
        with page.expect_download() as download:
            drop_file(page, recorded)
        download.value.save_as(tmp_path / "page.mcap")
        wait_for(page, "the file", lambda s: sensor_of(s)["isReplay"])
        assert not page.is_visible("body.recording")
        press(page, "r", says="Nothing to record: this is a recording")
        assert not page.is_visible("body.recording")
        told.subscribed.clear()
        page.reload()
        step(page, told)
        wait_for(page, "itself again", lambda s: s["lines"] and not sensor_of(s)["isReplay"])
    assert asked == ["beforeunload"]
    assert len(list(Recording(tmp_path / "page.mcap").frames())) > 5
