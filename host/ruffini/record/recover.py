"""Rewrites a damaged or truncated recording as a valid file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruffini.errors import InputError
from ruffini.record.mcap_file import CHUNK_BYTES, attach_hello, register_messages
from ruffini.record.recording import RAW_TOPIC, Recording
from ruffini.wire import encode_message

DEVICE_NAMES = ("HELLO", "SCHEMA", "REPLY")  # answers to a host, not results


def recover(recording: Recording, out: Path) -> dict[str, int]:
    """Write every message of `recording` with a correct checksum, and its records of clock and gaps.

    Returns
    -------
    dict
        messages : number of messages written; frames : number of WRENCH messages among them.

    Raises
    ------
    InputError
        `out` cannot be written.
    """
    from mcap.writer import Writer

    temporary = out.with_name(out.name + ".part")
    try:
        with temporary.open("wb") as stream:
            writer = Writer(stream, chunk_size=CHUNK_BYTES)
            writer.start(profile="ruffini", library="ruffini")
            counts = _write(recording, writer)
            writer.finish()  # type: ignore[no-untyped-call]
        temporary.replace(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return counts


def _write(recording: Recording, writer: Any) -> dict[str, int]:
    schema, hello = recording.schema, recording.hello.SerializeToString()
    raw = writer.register_channel(topic=RAW_TOPIC, message_encoding="application/octet-stream", schema_id=0)
    channels = {"HELLO": register_messages(writer, "HELLO", schema.bytes)}
    attach_hello(writer, hello)
    writer.add_message(channels["HELLO"], log_time=0, data=hello, publish_time=0)
    for point in recording.clock:
        writer.add_metadata("clock", point.words())
    for gap in recording.gaps:
        writer.add_metadata("gap", gap.words())
    counts, clock_ns = {"messages": 0, "frames": 0}, 0
    for frame, message in recording.packets():
        name = schema.type_name(frame.type)
        data = encode_message(
            frame.type, frame.payload, sensor=frame.sensor, sequence=frame.sequence, flags=frame.flags
        )
        read_ns = recording.read_ns
        writer.add_message(raw, log_time=clock_ns, data=data, publish_time=clock_ns if read_ns is None else read_ns)
        if name is None or name in DEVICE_NAMES:
            continue
        if (stamp := getattr(message, "stamp", None)) is not None:
            clock_ns = 1000 * stamp.capture_us
        if name not in channels:
            channels[name] = register_messages(writer, name, schema.bytes)
        writer.add_message(
            channels[name], log_time=clock_ns, data=frame.payload, publish_time=clock_ns, sequence=frame.sequence
        )
        counts["messages"] += 1
        counts["frames"] += name == "WRENCH"
    attach_hello(writer, hello)
    return counts
