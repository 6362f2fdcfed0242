"""MCAP with the device's own protobuf schema: opens in Foxglove and the mcap tools as it is."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ruffini.device import Connection
from ruffini.device.connection import DEVICE, SILENCE_S
from ruffini.device.line_gap import LineGap
from ruffini.errors import InputError, NoDeviceError
from ruffini.record.ros_types import RosChannels
from ruffini.wire import Frame

RAW_TOPIC = "/ruffini/raw"
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
) -> dict[str, int]:
    """Record until `n_frames` frames came (0: until interrupted or the line is lost for `resume_s`).

    Every message goes to topic /ruffini/<type>, the sensor's HELLO first; all received bytes to /ruffini/raw, for
    bit-exact replay, with the host's monotonic time of their arrival as `publish_time`; with `has_ros` wrench and field
    also as ROS 2 messages; each time without line is a metadata record "gap". Times are the sensor's; a metadata record
    "clock" every ten seconds says what they are on the host's clocks, and how sure. The file is finished and valid
    whatever ends it.

    Returns
    -------
    dict
        Number of messages by type; results that the sensor repeats while its camera gives nothing are "REPEATED".

    Raises
    ------
    InputError
        The file cannot be written.
    NoDeviceError
        `n_frames` will not be reached: the line was lost, or no frame came for a while.
    """
    from mcap.writer import Writer

    counts: dict[str, int] = {}
    channels: dict[str, int] = {}
    try:
        stream = path.open("wb")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    with stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES)
        writer.start(profile="ruffini", library="ruffini")
        clock_us, said_us = 0, -CLOCK_EVERY_US
        raw_channel = writer.register_channel(topic=RAW_TOPIC, message_encoding="application/octet-stream", schema_id=0)

        def keep_raw(data: bytes) -> None:
            writer.add_message(raw_channel, log_time=clock_us * 1000, data=data, publish_time=time.monotonic_ns())

        def keep_gap(gap: LineGap) -> None:
            frames = "not known" if gap.n_frames is None else str(gap.n_frames)
            writer.add_metadata("gap", {"lost_s": f"{gap.lost_s:.3f}", "missing_frames": frames, "text": str(gap)})
            on_gap(gap)

        # First of all what sensor this is: a file must be readable without it.
        hello = sensor.hello.SerializeToString()
        writer.add_message(_channel(writer, "HELLO", sensor.schema.bytes), log_time=0, data=hello, publish_time=0)
        ros = RosChannels(writer, sensor.hello)
        sensor.raw_sink = keep_raw
        sensor.subscribe(
            wrench=1, field=1, depth=1, contacts=1, markers=1, learned=1, status=1, image=image_every,
            residual=residual_every,
        )  # fmt: skip
        frame_s = time.monotonic()
        try:
            # STATUS comes each second, whatever the camera does.
            for frame, message in sensor.stream(timeout_s=SILENCE_S, resume_s=resume_s, on_gap=keep_gap):
                name = sensor.schema.type_name(frame.type)
                if name is None or name in ("HELLO", "SCHEMA", "REPLY"):
                    continue
                if name not in channels:
                    channels[name] = _channel(writer, name, sensor.schema.bytes)
                stamp: Any = getattr(message, "stamp", None)
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
                    frame_s = time.monotonic()
                    if n_frames and counts.get("WRENCH", 0) >= n_frames:
                        break
                elif n_frames and time.monotonic() - frame_s > SILENCE_S:
                    raise NoDeviceError(f"{sensor.port}: no frame for {SILENCE_S:.0f} s: is the camera running?")
            else:
                raise NoDeviceError(f"{sensor.port}: nothing came for {SILENCE_S:.0f} s: is ruffinid running?")
        except KeyboardInterrupt:
            pass
        except NoDeviceError as error:
            # Without a number of frames the end of the line is the end of the recording.
            if n_frames or not counts:
                frames = counts.get("WRENCH", 0)
                raise NoDeviceError(f"{error} (after {frames} frames; {path} holds them)") from error
        finally:
            sensor.raw_sink = None
            writer.finish()  # type: ignore[no-untyped-call]
            stream.flush()
            os.fsync(stream.fileno())
    return counts


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


def _channel(writer: Any, name: str, schema: bytes) -> int:
    schema_id = writer.register_schema(name=f"ruffini.{name.title()}", encoding="protobuf", data=schema)
    return int(
        writer.register_channel(topic=f"/ruffini/{name.lower()}", message_encoding="protobuf", schema_id=schema_id)
    )
