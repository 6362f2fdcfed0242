"""MCAP with the device's own protobuf schema: opens in Foxglove and the mcap tools as it is."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ruffini.device import Connection
from ruffini.device.connection import SILENCE_S
from ruffini.device.line import DEVICE
from ruffini.device.line_gap import LineGap
from ruffini.errors import InputError, NoDeviceError
from ruffini.files import lock_alone
from ruffini.record.recording import HELLO_ATTACHMENT, RAW_TOPIC, Recording
from ruffini.record.ros_types import RosChannels
from ruffini.wire import Frame

CLOCK_EVERY_US = 10_000_000
CHUNK_BYTES = 256 << 10  # what a power cut may cost


def record_stream(
    sensor: Connection,
    path: Path,
    *,
    n_frames: int = 0,
    image_every: int = 0,
    residual_every: int = 0,
    has_ros: bool = True,
    resume_s: float = 0.0,
    on_gap: Callable[[LineGap], None] = lambda _: None,
    on_end: Callable[[str], None] = lambda _: None,
) -> dict[str, int]:
    """Record until `n_frames` frames came (0: until interrupted, or the line is lost or silent for `resume_s`).

    Every message goes to topic /ruffini/<type>, the sensor's HELLO first; all received bytes to /ruffini/raw, for
    bit-exact replay, with the host's monotonic time of their arrival as `publish_time`; with `has_ros` wrench and field
    also as ROS 2 messages; each time without line is a metadata record "gap". Times are the sensor's; a metadata record
    "clock" every ten seconds gives them on the host's clocks, with a bound of the error. HELLO is also an attachment
    "hello", outside the compressed chunks. The file is finished and valid whatever ends it, and locked until then.
    `on_end` gets the reason if the sensor ended the recording.

    Returns
    -------
    dict
        Number of messages by type; results that the sensor repeats while its camera gives nothing are "REPEATED".

    Raises
    ------
    InputError
        The file cannot be written, is being recorded already, or the disk is full; what came before is kept.
    NoDeviceError
        `n_frames` will not be reached: the line was lost, or no frame came for a while.
    """
    from mcap.writer import Writer

    counts: dict[str, int] = {}
    channels: dict[str, int] = {}
    with _full_disk_named(path), _opened(path) as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES)
        writer.start(profile="ruffini", library="ruffini")
        clock_us, said_us = 0, -CLOCK_EVERY_US
        raw_channel = writer.register_channel(topic=RAW_TOPIC, message_encoding="application/octet-stream", schema_id=0)

        # Reads that end behind the last message taken: (bytes read before, log time, publish time, data).
        held: deque[tuple[int, int, int, bytes]] = deque()
        n_taken = 0

        def write_raw(end: float = math.inf) -> None:
            while held and held[0][0] + len(held[0][3]) <= end:
                _, log_ns, publish_ns, data = held.popleft()
                writer.add_message(raw_channel, log_time=log_ns, publish_time=publish_ns, data=data)

        def keep_raw(data: bytes) -> None:
            write_raw(n_taken)
            held.append((sensor.decoder.n_fed, clock_us * 1000, time.monotonic_ns(), data))

        def keep_gap(gap: LineGap) -> None:
            write_raw()  # a new line counts its bytes from 0
            writer.add_metadata("gap", gap.words())
            on_gap(gap)

        # First of all what sensor this is, and last of all again: a file must be readable without either.
        hello = sensor.hello.SerializeToString()
        attach_hello(writer, hello)
        writer.add_message(
            register_messages(writer, "HELLO", sensor.schema.bytes), log_time=0, data=hello, publish_time=0
        )
        ros = RosChannels(writer, sensor.hello)
        # Messages whose bytes arrived before the recording are not in the raw bytes: they belong to no topic either.
        sensor.messages.clear()
        is_older = sensor.decoder.is_midway
        sensor.raw_sink = keep_raw
        sensor.subscribe(
            wrench=1, field=1, depth=1, contacts=1, markers=1, learned=1, status=1, image=image_every,
            residual=residual_every,
        )  # fmt: skip
        silence_s = max(SILENCE_S, resume_s)  # a sensor that is suspended is waited for as a lost one
        n_silent, n_processed = 0, -1
        last: Frame | None = None  # the last message of the last frame
        last_number, image_number = 0, -image_every
        try:
            for frame, message in sensor.stream(timeout_s=silence_s, resume_s=resume_s, on_gap=keep_gap):
                n_taken = frame.end
                if is_older:
                    is_older = False
                    continue
                name = sensor.schema.type_name(frame.type)
                if name is None or name in ("HELLO", "SCHEMA", "REPLY"):
                    continue
                stamp: Any = getattr(message, "stamp", None)
                if last is not None and stamp is not None and stamp.frame != last_number:
                    break  # the image that was due did not come
                if name not in channels:
                    channels[name] = register_messages(writer, name, sensor.schema.bytes)
                clock_us = stamp.capture_us if stamp is not None else clock_us
                writer.add_message(
                    channels[name], log_time=clock_us * 1000, data=frame.payload,
                    publish_time=clock_us * 1000, sequence=frame.sequence,
                )  # fmt: skip
                kind = name if frame.sensor != DEVICE or stamp is None else "REPEATED"
                counts[kind] = counts.get(kind, 0) + 1
                if stamp is not None and has_ros and frame.sensor != DEVICE:
                    ros.write(name, frame, message, clock_us * 1000, utc_ns(clock_us, frame))
                if stamp is not None and clock_us - said_us >= CLOCK_EVERY_US and frame.host_time_ns is not None:
                    said_us = clock_us
                    writer.add_metadata("clock", clock_words(clock_us, frame))
                if name == "MARKERS":  # a frame's last message, but for its image
                    n_silent = 0
                    if n_frames and counts.get("WRENCH", 0) >= n_frames:
                        last, last_number = frame, stamp.frame
                        if not image_every or last_number < image_number + image_every:
                            break
                elif name == "IMAGE":
                    image_number = stamp.frame
                    if last is not None:
                        last = frame
                        break
                elif name == "STATUS":  # comes each second, whatever the camera does
                    # Those that waited while this process was suspended come at once: only the camera counts.
                    n_silent = n_silent + 1 if message.frames_processed == n_processed else 0
                    n_processed = message.frames_processed
                    if last is not None and n_silent > SILENCE_S:
                        break
                    if n_frames and n_silent > SILENCE_S:
                        raise NoDeviceError(f"{sensor.port}: no frame for {SILENCE_S:.0f} s: is the camera running?")
            else:
                if last is None:
                    raise NoDeviceError(f"{sensor.port}: nothing came for {silence_s:.0f} s: is ruffinid running?")
        except KeyboardInterrupt:
            pass
        except NoDeviceError as error:
            reason = f"{error} (after {counts.get('WRENCH', 0)} frames; {path} holds them)"
            if last is None and (n_frames or not counts):
                raise NoDeviceError(reason) from error
            if last is None:
                on_end(reason)  # without a number of frames the end of the line is the end of the recording
        finally:
            sensor.raw_sink = None
            if last is not None:
                held = deque((n, log, publish, data[: last.end - n]) for n, log, publish, data in held if n < last.end)
            write_raw()
            attach_hello(writer, hello)
            writer.finish()  # type: ignore[no-untyped-call]
            stream.flush()
            os.fsync(stream.fileno())
    return counts


def attach_hello(writer: Any, hello: bytes) -> None:
    """Keep a HELLO beside the chunks."""
    writer.add_attachment(
        create_time=0, log_time=0, name=HELLO_ATTACHMENT, media_type="application/x-protobuf", data=hello
    )


@contextlib.contextmanager
def _full_disk_named(path: Path) -> Iterator[None]:
    """A medium that fails becomes an InputError with the number of frames that are on it."""
    try:
        yield
    except OSError as error:
        try:
            n_saved = sum(1 for _ in Recording(path).frames())
        except InputError:
            n_saved = 0
        raise InputError(f"{path}: {error.strerror or error}: {n_saved} frames are saved in it; make room") from error


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """The file, emptied, and locked against a second recording. Raises InputError."""
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    with contextlib.ExitStack() as stack:
        stream = stack.enter_context(os.fdopen(number, "wb"))
        lock_alone(stream, f"{path}: another program records to it now: choose another name")
        stream.truncate(0)
        yield stream


def utc_ns(sensor_us: int, frame: Frame) -> int:
    """When the picture was taken on the wall's clock; the sensor's own clock where that is not known."""
    if frame.host_time_ns is None:
        return 1000 * sensor_us
    return time.time_ns() - time.monotonic_ns() + frame.host_time_ns


def clock_words(sensor_us: int, frame: Frame) -> dict[str, str]:
    """One time on the sensor's clock, on the host's monotonic one and on the wall's, which somebody may set."""
    return {"sensor_us": str(sensor_us), "host_monotonic_ns": str(frame.host_time_ns),
            "host_utc_ns": str(utc_ns(sensor_us, frame)),
            "error_ns": str(frame.host_time_error_ns)}  # fmt: skip


def register_messages(writer: Any, name: str, schema: bytes) -> int:
    """The channel /ruffini/<name> for the protobuf messages of a type."""
    schema_id = writer.register_schema(name=f"ruffini.{name.title()}", encoding="protobuf", data=schema)
    return int(
        writer.register_channel(topic=f"/ruffini/{name.lower()}", message_encoding="protobuf", schema_id=schema_id)
    )
