"""Devices that answer what no device should: each verb ends in one sentence, none waits without end."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import refusal_in, run_ruffini
from hang import until
from told_sensor import SCHEMA, Messages, ToldSensor, info_of, told_field

from ruffini.boards import find_board
from ruffini.device import Connection, flashing
from ruffini.errors import NoDeviceError, VerifyError
from ruffini.record import Recording, record_stream

FILE = b"a calibration"
DURABLE, ACTIVE = flashing.FLASH_DURABLE, flashing.FLASH_ACTIVE


def told(*infos: Any, **how: Any) -> ToldSensor:
    board = find_board("gelslim")
    return ToldSensor(list(infos) or [info_of(board)], told_field(board.grid.n_x, board.grid.n_y), **how)


@pytest.mark.parametrize("words", [("info",), ("cal", "undo"), ("cal", "zero"), ("snapshot",), ("record", "{}/a.mcap")])
def test_a_device_without_a_sensor(tmp_path: Path, words: tuple[str, ...]) -> None:
    with ToldSensor([], lambda *_: {}) as device:
        done = run_ruffini(*(word.format(tmp_path) for word in words), port=device.port)
        assert (done.code, refusal_in(done.err)) == (
            3, f"ruffini: {device.port}: the device names no sensor: update its firmware",
        )  # fmt: skip


def test_a_snapshot_without_a_picture_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ruffini.device.connection.IMAGE_S", 0.1)
    with told() as device:  # fields come without end
        done = run_ruffini("snapshot", "--out", tmp_path / "a.png", port=device.port)
    assert done.code == 3
    no_field = "(no field and )?"  # on a busy computer
    assert re.fullmatch(
        rf"ruffini: {device.port}: {no_field}no image came: does this sensor send it\?", refusal_in(done.err)
    )
    assert not (tmp_path / "a.png").exists()


class Flashed(ToldSensor):
    """Takes an upload; `trial` says how many frames a query is told, by its number; None: it is in force."""

    def __init__(self, trial: Callable[[int], int | None], in_force: dict[str, Any] | None = None) -> None:
        board = find_board("gelslim")
        super().__init__([info_of(board)], lambda *_: {}, rate_hz=None)
        self._trial, self.n_queries, self.n_commands = trial, 0, 0
        self._in_force = {"flash_state": ACTIVE, **(in_force or {})}

    def _answer(self, frame: Any) -> None:
        if SCHEMA.type_name(frame.type) != "COMMAND":
            super()._answer(frame)
            return
        self.n_commands += 1
        command: Any = SCHEMA.decode(frame.type, frame.payload)
        action, fields = command.WhichOneof("action"), {}
        if action == "flash_chunk":
            fields = {"next_offset": command.flash_chunk.offset + len(command.flash_chunk.data)}
        elif action == "flash_commit":
            fields = {"flash_state": DURABLE}
        elif action == "flash_query":
            value = self._trial(self.n_queries)
            self.n_queries += 1
            fields = self._in_force if value is None else {"flash_state": DURABLE, "value": value}
        self._send("REPLY", SCHEMA.new("Reply", request_id=command.request_id, **fields), 255)


@pytest.mark.parametrize(
    ("trial", "error", "words"),
    [
        (lambda n: 100 * n, VerifyError, "the trial does not end after 1100 frames"),
        (lambda n: n % 2, NoDeviceError, "the camera gives no frames to try it on"),
        (lambda n: 0, NoDeviceError, "the camera gives no frames to try it on"),
    ],
)
def test_a_trial_without_end(
    monkeypatch: pytest.MonkeyPatch, trial: Callable[[int], int], error: type[Exception], words: str
) -> None:
    monkeypatch.setattr(flashing, "TRIAL_STALL_S", 0.05)
    monkeypatch.setattr(flashing, "TRIAL_POLL_S", 0.0)
    with Flashed(trial) as device, Connection(device.port) as host, pytest.raises(error, match=words):
        host.flash(FILE)


@pytest.mark.parametrize("is_flashed_before", [False, True])
@pytest.mark.parametrize("code", ["REPLY_STORAGE", "REPLY_OK"])  # firmware 0.1.0 only has the text
def test_a_flash_that_a_power_cut_may_undo_is_no_success(code: str, is_flashed_before: bool) -> None:
    """Nor is a second one, which sends the file again."""
    storage = {"code": SCHEMA.enum_number("ReplyCode", code), "text": "may not be so after a power cut"}
    with Flashed(lambda _: None, storage) as device:
        if is_flashed_before:
            device._hello.sensors[0].calibration.sha256 = hashlib.sha256(FILE).digest()
        with Connection(device.port) as host, pytest.raises(VerifyError, match="may not be so after a power cut"):
            host.flash(FILE)
    assert device.n_queries == 1 + is_flashed_before


def test_another_sensor_on_the_line_gets_no_commit() -> None:
    """A pseudo-terminal's name that another daemon got, or a cable that was put into another sensor."""
    with Flashed(lambda _: None) as device, Connection(device.port) as host:
        answer = device._answer

        def swapped(frame: Any) -> None:
            answer(frame)
            if device.n_commands:
                device._hello.device_serial = "another"

        device._answer = swapped  # type: ignore[method-assign]
        with pytest.raises(NoDeviceError, match="sensor another answers in place of told: connect again"):
            host.flash(FILE)
    assert device.n_queries == 0


def test_statuses_that_waited_are_no_silence(tmp_path: Path) -> None:
    """This process was suspended: what the line kept of the time is seven statuses, and no frame."""
    board = find_board("gelslim")
    field = told_field(board.grid.n_x, board.grid.n_y)

    def tell(frame: int, stamp: Any) -> Messages:
        if 3 <= frame < 10:
            return {"STATUS": SCHEMA.new("Status", frames_processed=30 * frame)}
        return {**field(frame, stamp), "MARKERS": SCHEMA.new("Markers", stamp=stamp)}

    with ToldSensor([info_of(board)], tell) as device, Connection(device.port) as host:
        record_stream(host, tmp_path / "a.mcap", n_frames=5)
    assert sum(1 for _ in Recording(tmp_path / "a.mcap").frames(partial=True)) == 5


def test_a_recording_ends_with_its_last_frame_where_more_came_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tell(_: int, stamp: Any) -> Messages:
        return {"WRENCH": SCHEMA.new("Wrench", stamp=stamp), "MARKERS": SCHEMA.new("Markers", stamp=stamp)}

    read = Connection._read
    with ToldSensor([info_of(find_board("gelslim"))], tell) as device, Connection(device.port) as host:

        def read_late(host: Connection) -> None:
            until(lambda: host._serial.in_waiting > 2000, "more than five frames in one read")
            read(host)

        monkeypatch.setattr(Connection, "_read", read_late)
        counts = record_stream(host, tmp_path / "a.mcap", n_frames=5)
    assert counts["WRENCH"] == 5
    assert sum(1 for _ in Recording(tmp_path / "a.mcap").frames(partial=True)) == 5


def test_a_camera_that_stands_still_is_named(tmp_path: Path) -> None:
    board = find_board("gelslim")
    status = SCHEMA.new("Status", frames_processed=7)
    with (
        ToldSensor([info_of(board)], lambda *_: {"STATUS": status}) as device,
        Connection(device.port) as host,
        pytest.raises(NoDeviceError, match="is the camera running"),
    ):
        record_stream(host, tmp_path / "a.mcap", n_frames=5)


class Slow(ToldSensor):
    """Answers STATUS: so many frames were left out."""

    def __init__(self, n_left_out: int) -> None:
        super().__init__([info_of(find_board("gelslim"))], lambda *_: {}, rate_hz=None)
        self._n_left_out = n_left_out

    def _answer(self, frame: Any) -> None:
        if SCHEMA.type_name(frame.type) == "STATUS":
            self._send("STATUS", SCHEMA.new("Status", frames_left_out=self._n_left_out), 255)
        super()._answer(frame)


@pytest.mark.parametrize("n", [0, 150])
def test_info_says_why_frames_were_left_out(n: int) -> None:
    with Slow(n) as device:
        text, data = (run_ruffini("info", *words, port=device.port) for words in ([], ["--json"]))
    assert (text.code, data.code) == (0, 0), text.err + data.err
    assert json.loads(data.out)["frames_left_out"] == n
    words = "left out 150 frames: the computer was too slow for every frame, or had lowered its clock"
    assert (f"  {words}" in text.out.splitlines()) == (n == 150)
    assert ("left out" in text.out) == (n == 150)


NO_REFERENCE = SCHEMA.enum_number("FlagBit", "FLAG_NO_REFERENCE")


@pytest.mark.parametrize(
    ("learning", "event", "code", "said"),
    [
        (range(3, 8), None, 0, "rest is learned"),
        (range(0), None, 0, "rest is learned"),  # the line lost those frames
        (range(3, 6), "zero_refused", 4, "something pressed"),
        (range(3, 6), "zero_given_up", 4, "something pressed"),
    ],
)
def test_a_zero_waits_for_its_end(learning: range, event: str | None, code: int, said: str) -> None:
    begun: list[int] = []

    def zeros() -> int:
        return sum(command.WhichOneof("action") == "zero" for command in device.commands)

    def tell(frame: int, stamp: Any) -> Messages:
        if not zeros():
            return {"WRENCH": SCHEMA.new("Wrench", stamp=stamp)}
        begun.append(frame)
        n = frame - begun[0]
        if event and n == learning.stop:
            return {"EVENT": SCHEMA.new("Event", what=event, text="something pressed")}
        stamp.flags = NO_REFERENCE if n in learning else 0
        return {"WRENCH": SCHEMA.new("Wrench", stamp=stamp)}

    with ToldSensor([info_of(find_board("gelslim"))], tell) as device:
        done = run_ruffini("cal", "zero", port=device.port)
    assert done.code == code
    assert said in (done.out if code == 0 else refusal_in(done.err))
    assert zeros() == 1


class Busy(ToldSensor):
    """Answers only the fifth HELLO; sends a frame at each one before it if it `talks`."""

    def __init__(self, *, talks: bool) -> None:
        board = find_board("gelslim")
        super().__init__([info_of(board)], told_field(board.grid.n_x, board.grid.n_y), rate_hz=None)
        self._talks, self.n_asked = talks, 0

    def _answer(self, frame: Any) -> None:
        if SCHEMA.type_name(frame.type) == "HELLO":
            self.n_asked += 1
            if self.n_asked < 5:
                if self._talks:
                    self._send_frame()
                return
        super()._answer(frame)


def test_a_busy_sensor_that_sends_is_asked_longer() -> None:
    with Busy(talks=True) as device, Connection(device.port, hello_timeout_s=6) as host:
        assert host.serial_number == "told"
    with (
        Busy(talks=False) as device,
        pytest.raises(NoDeviceError, match="nothing answers HELLO"),
    ):
        Connection(device.port, hello_timeout_s=0.06)
