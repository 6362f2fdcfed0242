"""Flashing a calibration: upload, trial, undo, read back. Protocol: proto/README.md, FLASH."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from typing import Any

from ruffini.device.line import Line
from ruffini.errors import LineLostError, NoDeviceError, RefusedError, VerifyError

CHUNK_BYTES = 3072
CHUNK_TRIES = 40  # per chunk: a line that loses half of all frames fails once in 1e12
SHORTEST_WAIT_S, LONGEST_WAIT_S = 0.02, 2.0  # for the reply to a chunk
FIRST_WAIT_S = 0.2  # before the first round trip is measured
QUICK_TRIES = 4  # retries at the measured round-trip time; after them the device is assumed to be busy
LATE_WAIT_S = 0.5  # the waits then double up to this, so that a stalled machine is not flooded
COMMIT_WAITS_S = (1.0,) * 30  # checks, fsync and read-back of a large table on slow storage
RESUME_S = 10.0  # time to wait for a lost line
RESUMES = 100
TRIAL_POLL_S = 0.1
TRIAL_STALL_S = 10.0  # without a frame during the trial: the camera has stalled
TRIAL_FRAMES = 1024  # upper bound of a trial: four times the length in proto/README.md
FLASH_DURABLE, FLASH_ACTIVE = 3, 4  # FlashState of the schema
MAX_FILE_BYTES = 128 << 20  # largest size of a calibration that is accepted from a device


def flash(sensor: Line, data: bytes, progress: Callable[[float], None], say: Callable[[str], None]) -> Any:
    """Upload a file and wait for the end of its trial; errors as in Connection.flash.

    The device requests the next byte offset, so a lost chunk is sent again, and an upload whose line was lost
    continues once the sensor is back, on any port.
    """
    sha256 = hashlib.sha256(data).digest()

    def install() -> Any:
        sensor.refresh_hello()
        if sensor.hello.sensors[0].calibration.sha256 == sha256:  # flashed before, or its reply was lost
            reply = sensor.command(flash_query={"sha256": sha256})
            if not reply.code and (reply.flash_state == FLASH_DURABLE or not reply.text):
                return reply  # otherwise a restart may not restore it
        _upload(sensor, data, sha256, progress)
        sensor.refresh_hello()  # the device that commits must be the one that received the file
        return _in_force(sensor, flash_commit={})

    reply = _across_unplugs(sensor, say, install)
    if reply.flash_state == FLASH_DURABLE:
        reply = _across_unplugs(sensor, say, lambda: _end_of_trial(sensor, sha256, say))
    if sensor.hello.sensors[0].calibration.sha256 != sha256:
        raise VerifyError(f"{sensor.port}: the calibration in force is not the one sent")
    return reply


def undo(sensor: Line) -> Any:
    """Restore the calibration that the last flash replaced; errors as in Connection.undo_flash."""
    before = sensor.hello.sensors[0].calibration.sha256
    reply = _in_force(sensor, flash_undo={})
    if sensor.hello.sensors[0].calibration.sha256 == before:
        raise VerifyError(f"{sensor.port}: the calibration in force is still the one that was to be undone")
    return reply


def read_back(sensor: Line, progress: Callable[[float], None]) -> bytes:
    """The calibration in force; errors as in Connection.read_calibration.

    Each command requests one piece, so the device cannot run ahead of the host.
    """
    in_force = sensor.hello.sensors[0].calibration
    data, pace = bytearray(), Pace()
    if not in_force.present:
        return b""

    def read() -> None:
        while True:
            reply = pace.command(sensor, flash_read={"sha256": in_force.sha256, "offset": len(data)})
            if reply.code:
                raise RefusedError(f"{sensor.port}: {reply.text}")
            if reply.value > MAX_FILE_BYTES or (not reply.data and len(data) < reply.value):
                raise VerifyError(f"{sensor.port}: the calibration cannot be read back: {reply.value} bytes are said")
            data.extend(reply.data)
            if len(data) >= reply.value:
                return
            progress(len(data) / reply.value)

    _across_unplugs(sensor, lambda _: None, read)
    if hashlib.sha256(data).digest() != in_force.sha256:
        raise VerifyError(f"{sensor.port}: what was read back is not the calibration in force: read it again")
    return bytes(data)


class Pace:
    """Reply timeout per piece: mean round trip plus four mean deviations (RFC 6298)."""

    def __init__(self) -> None:
        self._mean_s: float | None = None
        self._deviation_s = 0.0

    def command(self, sensor: Line, **action: Any) -> Any:
        """Send a command that transfers one piece and return its reply."""
        sent, n_before = time.monotonic(), sensor.n_retries
        reply = sensor.command(waits_s=self.waits_s(), **action)
        if sensor.n_retries == n_before:  # otherwise the reply may belong to any of the tries
            self._add(time.monotonic() - sent)
        return reply

    def waits_s(self) -> list[float]:
        """Timeouts of the tries of one piece, seconds."""
        wait_s = FIRST_WAIT_S if self._mean_s is None else self._mean_s + 4 * self._deviation_s
        wait_s = min(max(wait_s, SHORTEST_WAIT_S), LONGEST_WAIT_S)
        late_s = max(wait_s, LATE_WAIT_S)
        return [min(wait_s * 2.0 ** max(i - QUICK_TRIES + 1, 0), late_s) for i in range(CHUNK_TRIES)]

    def _add(self, round_trip_s: float) -> None:
        if self._mean_s is None:
            self._mean_s, self._deviation_s = round_trip_s, round_trip_s / 2
            return
        self._deviation_s += (abs(round_trip_s - self._mean_s) - self._deviation_s) / 4
        self._mean_s += (round_trip_s - self._mean_s) / 8


def _across_unplugs(sensor: Line, say: Callable[[str], None], work: Callable[[], Any]) -> Any:
    """Run `work`, again after each lost line that comes back, and return its result."""
    for _ in range(RESUMES):
        try:
            return work()
        except LineLostError as error:
            say(f"{error}; waiting for it to come back")
            sensor.resume(RESUME_S)
    raise NoDeviceError(f"{sensor.port}: the line was lost {RESUMES} times: check the cable and flash again")


def _upload(sensor: Line, data: bytes, sha256: bytes, progress: Callable[[float], None]) -> None:
    reply = sensor.checked(flash_begin={"size_bytes": len(data), "sha256": sha256})
    offset, stuck, pace = reply.next_offset, 0, Pace()
    while offset < len(data):
        chunk = {"offset": offset, "data": data[offset : offset + CHUNK_BYTES]}
        reply = pace.command(sensor, flash_chunk=chunk)
        if reply.code == sensor.schema.enum_number("ReplyCode", "REPLY_REFUSED"):
            raise RefusedError(f"{sensor.port}: {reply.text}")
        stuck = stuck + 1 if reply.next_offset <= offset else 0
        if stuck > CHUNK_TRIES:
            raise RefusedError(f"{sensor.port}: the upload makes no progress: {reply.text}")
        offset = reply.next_offset
        progress(offset / len(data))


def _accepted(sensor: Line, reply: Any) -> Any:
    """Return a reply without an error; raises VerifyError if the medium failed, else RefusedError."""
    if reply.code == sensor.schema.enum_number("ReplyCode", "REPLY_STORAGE"):
        raise VerifyError(f"{sensor.port}: {reply.text}")
    if reply.code:
        raise RefusedError(f"{sensor.port}: {reply.text}")
    return reply


def _in_force(sensor: Line, **action: Any) -> Any:
    """Send a command that puts a calibration in force, on trial or for good, and refresh HELLO."""
    reply = _accepted(sensor, sensor.command(**action, waits_s=COMMIT_WAITS_S))
    if reply.flash_state not in (FLASH_DURABLE, FLASH_ACTIVE):
        raise RefusedError(f"{sensor.port}: {reply.text}")
    sensor.refresh_hello()
    return reply


def _end_of_trial(sensor: Line, sha256: bytes, say: Callable[[str], None]) -> Any:
    """Wait for the reply that ends a calibration's trial, and refresh HELLO."""
    n_frames, since, said = 0, time.monotonic(), ""
    while (reply := sensor.command(flash_query={"sha256": sha256})).flash_state == FLASH_DURABLE:
        if reply.value > TRIAL_FRAMES:
            raise VerifyError(f"{sensor.port}: the trial does not end after {reply.value} frames: restart the sensor, "
                              "which goes back to what was before, and update its firmware")  # fmt: skip
        if reply.value > n_frames:
            n_frames, since = reply.value, time.monotonic()
        elif time.monotonic() - since > TRIAL_STALL_S:
            raise NoDeviceError(
                f"{sensor.port}: the calibration is stored, but the camera gives no frames to try it on: "
                f"see why, and flash again; until then a restart goes back to what was before"
            )
        if reply.text != said:
            say(said := reply.text)
        time.sleep(TRIAL_POLL_S)
    if _accepted(sensor, reply).text:  # firmware 0.1.0 says so that a power cut may undo it
        raise VerifyError(f"{sensor.port}: {reply.text}")
    sensor.refresh_hello()
    return reply
