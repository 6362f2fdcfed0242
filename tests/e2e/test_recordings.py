"""What `ruffini record` wrote: read again, played as a sensor, as tables, as a page; cut off and spoilt files."""

from __future__ import annotations

import contextlib
import itertools
import json
import random
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from broken_line import BrokenLine, unplugged_host
from foreign_reader import compare, read
from hang import HANG_S, Patience, until
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from test_bad_input import HOST, is_one_sentence, run_host
from tiny_sensor import N_FRAMES, Sensor, start

import ruffini
from ruffini.api import SensorFrame
from ruffini.device import Connection
from ruffini.device.line_gap import LineGap
from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.record import Recording, record_stream, replay
from ruffini.record.replay import ReplayedSensor, replayed

if TYPE_CHECKING:
    from playwright.sync_api import Page


def record(sensor: Sensor, folder: Path) -> Path:
    """The whole press, every frame of it."""
    with start(sensor, folder / "store", "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        record_stream(host, folder / "run.mcap", image_every=8)
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def run(sensor: Sensor, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(sensor, tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="module")
def frames(run: Path) -> list[SensorFrame]:
    return list(Recording(run).frames())


def test_all_frames_are_in_it_as_they_came(run: Path, frames: list[SensorFrame]) -> None:
    recording = Recording(run)
    assert [f.number for f in frames] == list(range(N_FRAMES))
    assert all(set(f.messages) >= {"WRENCH", "FIELD", "DEPTH", "CONTACTS", "MARKERS"} for f in frames)
    assert [f.number for f in frames if f.image is not None] == list(range(0, N_FRAMES, 8))
    assert all(f.is_simulated and f.is_replay and f.serial == "0001" for f in frames)
    assert not frames[0].is_valid
    assert frames[-1].is_valid
    assert frames[-1].wrench is not None
    assert frames[-1].wrench.force[2] < -0.1
    assert recording.hello.sensors[0].board == "tiny"
    assert list(recording.frames(sensor=0)) != []
    assert recording.problems == []


def test_host_times_and_arrival_are_known(run: Path) -> None:
    recording, before = Recording(run), None
    for frame in recording.frames():
        assert frame.host_time_ns is not None
        assert frame.host_time_error_ns is not None
        assert recording.arrival_ns is not None
        # One clock for sensor and host in these tests: what the time should be is known exactly.
        assert abs(frame.host_time_ns - 1e9 * frame.capture_s) <= frame.host_time_error_ns + 1000
        assert recording.arrival_ns > frame.host_time_ns - frame.host_time_error_ns
        assert before is None or frame.host_time_ns > before
        before = frame.host_time_ns


def test_ros_messages_are_what_the_stream_says(run: Path, frames: list[SensorFrame]) -> None:
    """Read by an ordinary ROS 2 reader."""
    by_topic: dict[str, list[object]] = {}
    with run.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = ["/ruffini/ros/0/wrench", "/ruffini/ros/0/field"]
        for schema, channel, _, message in reader.iter_decoded_messages(topics=topics):
            assert schema is not None
            assert schema.encoding == "ros2msg"
            by_topic.setdefault(channel.topic, []).append(message)
    assert [len(m) for m in by_topic.values()] == [N_FRAMES, N_FRAMES]
    for frame, message, cloud in zip(frames, *(by_topic[t] for t in topics), strict=True):
        assert frame.wrench is not None
        assert frame.field is not None
        w, c = message.wrench, cloud  # type: ignore[attr-defined]
        np.testing.assert_array_equal([w.force.x, w.force.y, w.force.z], frame.wrench.force)
        np.testing.assert_array_equal([w.torque.x, w.torque.y, w.torque.z], frame.wrench.torque)
        assert message.header.frame_id == "simulated_ruffini_0001_pad"  # type: ignore[attr-defined]
        assert [f.name for f in c.fields] == ["x", "y", "z", "fx", "fy", "fz"]
        assert [f.offset for f in c.fields] == list(range(0, 24, 4))
        assert {(f.datatype, f.count) for f in c.fields} == {(7, 1)}
        assert (c.point_step, c.row_step) == (24, 24 * c.width)
        points = np.frombuffer(bytes(c.data), "<f4").reshape(c.height, c.width, 6)
        np.testing.assert_array_equal(points[..., 3:], frame.field.force.astype("f4"))
        assert c.is_dense == (not np.isnan(points).any()) == frame.is_valid
    assert points[0, 0, 0] == pytest.approx(Recording(run).hello.sensors[0].grid_origin_x_nm * 1e-9, abs=1e-4)


def test_readers_that_know_no_ruffini_read_the_same_from_every_topic(run: Path) -> None:
    """Foxglove and the mcap tools have of the file what is in it: schemas and messages."""
    counts = compare(run)
    assert counts == {
        **{f"/ruffini/{name}": N_FRAMES for name in ("wrench", "field", "depth", "contacts", "markers")},
        "/ruffini/image": len(range(0, N_FRAMES, 8)),
    }  # fmt: skip
    others = {"/ruffini/hello", "/ruffini/status", "/ruffini/ros/0/wrench", "/ruffini/ros/0/field"}
    assert read(run).keys() - counts.keys() - {"/ruffini/event"} == others


def test_without_ros(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        code, _, text = run_host("record", str(tmp_path / "a.mcap"), "--n", "5", "--no-ros", port=daemon.port)
    assert code == 0, text
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {c.message_encoding for c in summary.channels.values()} == {"protobuf", "application/octet-stream"}


# ---- played as a sensor --------------------------------------------------------------------------


def test_played_it_is_the_sensor_again(run: Path, frames: list[SensorFrame]) -> None:
    command = [*HOST, "replay", str(run), "--speed", "2", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        got = []
        with ruffini.connect(told["port"], resume_s=0) as host:
            assert (host.serial_number, host.boards) == (told["serial"], ("tiny",))
            with pytest.raises(RefusedError, match=r"this is a recording \(run.mcap\)"):
                host.zero()
            with contextlib.suppress(NoDeviceError):  # it goes with its recording, which the subscription starts
                for frame in host.frames():
                    got.append(frame)
        assert process.wait(HANG_S) == 0
    assert [f.number for f in got] == list(range(N_FRAMES))
    for ours, was in zip(got, frames, strict=True):
        assert ours.is_replay
        assert ours.is_simulated
        assert set(ours.messages) == {"WRENCH", "FIELD", "DEPTH", "CONTACTS"}
        for name, message in ours.messages.items():
            original = was.messages[name]
            message.stamp.capture_us = original.stamp.capture_us
            assert message.SerializeToString() == original.SerializeToString()


@contextlib.contextmanager
def over(run: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Connection]:
    """A host that subscribed to a recording, and read nothing to its end; the line goes after that."""
    monkeypatch.setattr(replay, "QUIET_S", 0.1)
    sensor = ReplayedSensor(Recording(run), speed=50)

    def play() -> None:
        with sensor:
            sensor.run()

    playing = threading.Thread(target=play)
    playing.start()
    with Connection(sensor.port) as host:
        host.subscribe(wrench=1)
        until(lambda: sensor._is_over, "the end of the recording")
        yield host
        until(lambda: not playing.is_alive(), "the end of the line")


def test_its_end_waits_for_a_host_that_has_not_read_it(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "END_S", HANG_S)
    numbers = list[int]()
    with over(run, monkeypatch) as host, contextlib.suppress(NoDeviceError):  # the line goes with its recording
        time.sleep(10 * replay.QUIET_S)
        for _, message in host.stream():
            numbers.append(message.stamp.frame)
    assert numbers == list(range(N_FRAMES))


def test_questions_do_not_put_its_end_off(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "END_S", HANG_S)
    patience = Patience()
    with over(run, monkeypatch) as host, contextlib.suppress(NoDeviceError):
        while host.messages.n_added < N_FRAMES:
            host._read()
        while not patience.is_over():  # and no answer is read
            host._send("STATUS")
            time.sleep(replay.TURN_S)
    assert not patience.is_over()


def test_a_host_that_reads_no_more_is_given_up(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "END_S", 0.3)
    with over(run, monkeypatch):
        pass  # the host is there


def test_played_again_and_again_its_frames_go_on(run: Path) -> None:
    with replayed(Recording(run), speed=20, is_loop=True) as port:
        for _ in range(2):  # a second host on the same line
            with ruffini.connect(port) as host:
                numbers = [f.number for f in itertools.islice(host.frames(), 2 * N_FRAMES)]
            assert numbers == sorted(set(numbers))
            assert numbers[-1] - numbers[0] >= 2 * N_FRAMES - 1


def test_as_text(run: Path) -> None:
    code, out, text = run_host("replay", str(run), "--text", "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    assert code == 0, text
    assert [line["frame"] for line in lines] == list(range(N_FRAMES))
    assert lines[-1]["replay"]
    assert lines[-1]["contacts"]["contacts"][0]["force"][2] < -0.1
    code, out, _ = run_host("replay", str(run), "--text")
    assert code == 0
    assert "SIMULATED REPLAY FLAG_NO_REFERENCE" in out.splitlines()[0]


# ---- the page ------------------------------------------------------------------------------------


def test_the_page_shows_itself(run: Path, tmp_path: Path, page: Page) -> None:
    out = tmp_path / "run.html"
    code, said, text = run_host("plot", str(run), "--out", str(out), "--json")
    assert code == 0, text
    told = json.loads(said)
    assert (told["frames"], told["missing_frames"], told["line_lost"]) == (N_FRAMES, 0, 0)
    assert told["flags"]["FLAG_NO_REFERENCE"] > 0
    assert told["median_latency_s"] is not None
    assert 0.1 < told["largest_force_n"] < 10
    page.goto(out.as_uri())
    assert page.title() == "run.mcap: tiny 0001 SIMULATED REPLAY"
    widths = page.eval_on_selector_all("img", "images => images.map(i => i.naturalWidth)")
    assert len(widths) == 4
    assert min(widths) > 600
    code, _, text = run_host("plot", str(run), "--out", str(out))
    assert (code, is_one_sentence(text)) == (2, True)
    assert "--force" in text


# ---- files that are not whole --------------------------------------------------------------------


def opened(path: Path) -> Recording | None:
    """None where it is refused, with one sentence."""
    try:
        return Recording(path)
    except InputError as error:
        problem = str(error)
    assert is_one_sentence(f"ruffini: {problem}")
    return None


def test_of_a_file_that_was_cut_off_what_is_there_is_read_and_the_loss_is_said(run: Path, tmp_path: Path) -> None:
    data, path = run.read_bytes(), tmp_path / "cut.mcap"
    chances, counts = random.Random(1), []
    for size in sorted([chances.randrange(len(data)) for _ in range(30)]):
        path.write_bytes(data[:size])
        recording = opened(path)
        if recording is None:
            counts.append(0)
            continue
        numbers = [f.number for f in recording.frames()]
        assert numbers == list(range(len(numbers)))
        assert recording.problems or len(numbers) == N_FRAMES
        counts.append(len(numbers))
    assert counts == sorted(counts)
    assert 0 < counts[len(counts) // 2] < N_FRAMES
    path.write_bytes(data[: len(data) * 2 // 3])
    code, _, text = run_host("plot", str(path), "--out", str(tmp_path / "cut.html"))
    assert code == 0, text
    assert "cut off" in text
    assert "cut off" in (tmp_path / "cut.html").read_text()


def test_no_spoilt_byte_makes_a_wrong_frame(run: Path, frames: list[SensorFrame], tmp_path: Path) -> None:
    data, path, chances = run.read_bytes(), tmp_path / "spoilt.mcap", random.Random(2)
    good = {f.number: {k: m.SerializeToString() for k, m in f.messages.items()} for f in frames}
    n_less = 0
    for _ in range(40):
        spoilt = bytearray(data)
        for _ in range(chances.choice([1, 3, 30])):
            spoilt[chances.randrange(len(spoilt))] = chances.randrange(256)
        path.write_bytes(spoilt)
        recording = opened(path)
        got = [] if recording is None else list(recording.frames())
        n_less += len(got) < N_FRAMES
        for frame in got:
            assert {k: m.SerializeToString() for k, m in frame.messages.items()}.items() <= good[frame.number].items()
    assert n_less > 5, "the bytes that were spoilt were none that matter"


@pytest.mark.parametrize("case", ["NOTHING.mcap", "text", "empty", "another program's", "folder"])
def test_what_is_no_recording_is_refused_with_a_sentence(case: str, tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / ("NOTHING.mcap" if case == "NOTHING.mcap" else "file.mcap")
    if case == "text":
        path.write_text("force_x_n,force_y_n\n")
    elif case == "empty":
        path.write_bytes(b"")
    elif case == "folder":
        path.mkdir()
    elif case == "another program's":
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            writer.add_message(writer.register_channel("/imu", "json", 0), 0, b"{}", 0)
            writer.finish()
    assert opened(path) is None
    verb = {"text": "replay", "empty": "plot"}.get(case, "export")
    code, out, text = run_host(verb, str(path))
    assert (code, out, is_one_sentence(text)) == (2, "", True), text
    assert path.name in text
    assert {p.suffix for p in tmp_path.iterdir()} <= {".mcap"}


def test_a_gap_of_the_line_is_before_the_frame_that_ended_it(sensor: Sensor, tmp_path: Path) -> None:
    gaps: list[LineGap] = []
    with (
        start(sensor, tmp_path / "store", "--loop") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        unplugged_host(line, 20, 10)(line.port) as host,
    ):
        record_stream(host, tmp_path / "run.mcap", n_frames=50, resume_s=HANG_S, on_gap=gaps.append)
    (gap,) = gaps
    after = [f for f in Recording(tmp_path / "run.mcap").frames() if f.gap is not None]
    assert len(after) == 1
    assert after[0].gap is not None
    assert (after[0].gap.n_frames, after[0].gap.lost_s) == (gap.n_frames, pytest.approx(gap.lost_s, abs=0.001))
    assert after[0].n_missed is not None
    assert after[0].n_missed >= (gap.n_frames or 0)


@pytest.mark.parametrize(("every", "n_images"), [(1, 9), (4, 3), (5, 2)])
def test_a_recording_of_so_many_frames_ends_with_the_image_of_the_last(
    sensor: Sensor, tmp_path: Path, every: int, n_images: int
) -> None:
    with (
        start(sensor, tmp_path / "store", "--lockstep", "--loop", "--wait-for-host") as daemon,
        Connection(daemon.port) as host,
    ):
        host.flash(sensor.calibration)
        counts = record_stream(host, tmp_path / "run.mcap", n_frames=9, image_every=every)
    frames = list(Recording(tmp_path / "run.mcap").frames(partial=True))
    assert (counts["WRENCH"], counts["IMAGE"]) == (9, n_images)
    assert [f.is_whole for f in frames] == [True] * 9
    assert sum(f.image is not None for f in frames) == n_images


# ---- lockstep ------------------------------------------------------------------------------------


def test_a_camera_recording_played_in_lockstep_gives_the_same_bytes_out(sensor: Sensor, tmp_path: Path) -> None:
    """All but what says when: `Stamp.capture_us`, which with REPLAY is when the picture was played.

    Left out are the messages that are about the run and not about a picture: HELLO (a session of its own), STATUS and
    EVENT (times, loads), REPLY and TIME (answers to the host), and the headers' sequence numbers, which count them.
    """
    about_the_run = {"HELLO", "SCHEMA", "STATUS", "EVENT", "REPLY", "TIME"}
    runs = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        told = []
        for packet, message in Recording(record(sensor, tmp_path / name)).packets():
            kind = Recording(tmp_path / name / "run.mcap").schema.type_name(packet.type) if not told else None
            kind = kind or message.DESCRIPTOR.name.upper()
            if kind in about_the_run:
                continue
            assert packet.payload == message.SerializeToString(deterministic=True), "nothing is lost by decoding"
            message.stamp.capture_us = 0
            told.append((kind, packet.sensor, packet.flags, message.SerializeToString(deterministic=True)))
        runs.append(told)
    assert len(runs[0]) == 5 * N_FRAMES + N_FRAMES // 8
    assert runs[0] == runs[1]
    print(f"{len(runs[0])} messages, {sum(len(data) for *_, data in runs[0])} bytes the same")


def test_the_topics_are_those_of_the_readme(run: Path) -> None:
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {c.topic for c in summary.channels.values()}
    assert {t for t in topics if re.fullmatch(r"/ruffini/(ros/0/)?[a-z]+", t)} == topics
    assert {"/ruffini/raw", "/ruffini/hello", "/ruffini/ros/0/wrench", "/ruffini/ros/0/field"} <= topics
