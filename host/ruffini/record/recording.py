"""Reader of recordings. It decodes the raw bytes of the line, so a program gets the same messages as from the sensor.

A truncated or damaged file is read as far as possible; `Recording.problems` lists what is missing.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from ruffini.api.frame import Assembler, SensorFrame
from ruffini.device.device_clock import MAX_DRIFT, WANDER
from ruffini.device.line import DEVICE
from ruffini.device.line_gap import LineGap
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.wire import Decoder, Frame, Schema

RAW_TOPIC = "/ruffini/raw"
HELLO_ATTACHMENT = "hello"
MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, ATTACHMENT, METADATA, FOOTER, LAST_KIND = 3, 4, 5, 6, 9, 12, 2, 15
# A chunk record: opcode, length; start, end, size, CRC; compression; length of the compressed data.
CHUNK_HEAD = re.compile(rb"\x06(.{8}).{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0)(.{8})", re.DOTALL)
HEAD = struct.Struct("<BQ")  # of a record: opcode, length
MAX_RECORD_BYTES = 1 << 28


@dataclass(frozen=True)
class ClockPoint:
    """One instant on the sensor's clock, the host's monotonic clock and UTC."""

    sensor_us: int
    monotonic_ns: int
    utc_ns: int
    error_ns: int

    def words(self) -> dict[str, str]:
        """The metadata record "clock"."""
        return {"sensor_us": str(self.sensor_us), "host_monotonic_ns": str(self.monotonic_ns),
                "host_utc_ns": str(self.utc_ns), "error_ns": str(self.error_ns)}  # fmt: skip


class Recording:
    """An MCAP file written by `ruffini record` or the page.

    Attributes
    ----------
    hello : the sensor's HELLO. schema : the schema of its messages.
    problems : messages about unreadable parts, complete once the file was read to its end.
    gaps : interruptions of the line during the recording.
    clock : the sensor's clock against the host's at the times at which it was recorded.
    read_ns : arrival of the bytes last read by `packets`, on the host's monotonic clock; None if unknown.
    arrival_ns : arrival of the last message of the frame last returned by `frames`, on the host's monotonic clock;
        None if unknown, as in recordings of the page.

    Raises
    ------
    InputError
        The file does not exist or is not a recording of a sensor.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.arrival_ns: int | None = None
        self.read_ns: int | None = None
        self.clock: list[ClockPoint] = []
        self._gaps: list[LineGap] = []
        schema = hello = hello_bytes = None
        self._has_raw = False
        self._topics: dict[int, str] = {}  # by channel; the summary repeats those of a damaged first chunk
        for kind, record in self._records(all_chunks=False):
            if kind == SCHEMA and record.name == "ruffini.Hello":  # use the first valid one
                schema = schema or self._schema_of(record.data)
            elif kind == MESSAGE and self._topics.get(record.channel_id) == "/ruffini/hello" and schema is not None:
                hello = schema.decode(schema.type_numbers["HELLO"], record.data)
            elif kind == ATTACHMENT and record.name == HELLO_ATTACHMENT and hello_bytes is None:
                hello_bytes = record.data
            elif kind == METADATA:
                self._note(record.name, record.metadata)
        if schema is not None and hello is None:
            hello = schema.decode(schema.type_numbers["HELLO"], hello_bytes) if hello_bytes else self._hello_of(schema)
        if schema is None or hello is None or not self._has_raw:
            raise InputError(f"{self.path} is not a recording of a sensor: make one with `ruffini record`")
        self.schema: Schema = schema
        self.hello: Any = hello
        self.gaps = tuple(self._gaps)

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def _schema_of(self, data: bytes) -> Schema | None:
        try:
            schema = Schema(data)
            # A flipped bit in a name leaves a readable schema with a wrong name.
            if "HELLO" not in schema.type_numbers or not schema.has_field("Hello", "device_serial"):
                raise InputError("it has no HELLO with a device_serial")
            return schema
        except InputError as error:
            self._problem(f"a damaged schema was skipped: {error}")
            return None

    def _hello_of(self, schema: Schema) -> Any:
        """HELLO among the bytes of the line, e.g. after a reconnection; None if there is none."""
        decoder = Decoder()
        for kind, record in self._records(all_chunks=True):
            if kind == MESSAGE and self._topics.get(record.channel_id) == RAW_TOPIC:
                for frame in decoder.feed(record.data):
                    if frame.type == schema.type_numbers["HELLO"]:
                        return schema.decode(frame.type, frame.payload)
        return None

    def packets(self) -> Iterator[tuple[Frame, Any]]:
        """Messages in the order of the line, with host times if the recording has them."""
        decoder = Decoder()
        for kind, record in self._records(all_chunks=True):
            if kind != MESSAGE or self._topics.get(record.channel_id) != RAW_TOPIC:
                continue
            self.read_ns = record.publish_time if record.publish_time != record.log_time else None
            for frame in decoder.feed(record.data):
                message: Any = self.schema.decode(frame.type, frame.payload)
                if message is None:
                    continue
                stamp = getattr(message, "stamp", None)
                if stamp is not None and (host := self._host_time(stamp.capture_us)) is not None:
                    frame = replace(frame, host_time_ns=host[0], host_time_error_ns=host[1])
                yield frame, message
        if decoder.counters.damaged:
            self._problem(f"{decoder.counters.damaged} frames or pieces that arrived damaged were skipped")

    def frames(self, sensor: int | None = None, *, partial: bool = False) -> Iterator[SensorFrame]:
        """Frames as those of `ruffini.connect`, from the first to the last.

        Parameters
        ----------
        sensor : only frames of this sensor, on a device with several.
        partial : also frames that lost a part on the line; that part is None.
        """
        before: dict[int, int] = {}
        gaps, gap = deque(self.gaps), None
        for frame in self._assembled():
            last = before.get(frame.sensor)
            if sensor not in (None, frame.sensor) and frame.sensor != DEVICE:
                continue
            missed = None if last is None or frame.number < last else max(frame.number - last - 1, 0)
            # A gap is recorded after the frame that ended it; that frame's `n_missed` includes the gap's frames.
            is_after = gaps and last is not None and (gaps[0].n_frames or 0) <= (missed or 0) > 0
            is_anew = gaps and last is not None and missed is None and gaps[0].n_frames is None
            gap = gaps.popleft() if is_after or is_anew else gap
            if frame.is_whole or frame.is_stale or partial:
                before[frame.sensor] = frame.number
                yield replace(frame, n_missed=missed, gap=gap)
                gap = None

    def _assembled(self) -> Iterator[SensorFrame]:
        assembler = Assembler(self.schema, self.hello.device_serial, None)
        arrived: dict[tuple[int, int], int | None] = {}
        for packet, message in self.packets():
            if (stamp := getattr(message, "stamp", None)) is not None:
                arrived[packet.sensor, stamp.frame] = self.read_ns
            for frame in assembler.put(packet, message):
                self.arrival_ns = arrived.get((frame.sensor, frame.number))
                arrived = {key: ns for key, ns in arrived.items() if key[1] >= frame.number}
                yield frame
        for frame in assembler.flush():
            self.arrival_ns = arrived.get((frame.sensor, frame.number))
            yield frame

    def utc_ns(self, capture_us: int) -> int | None:
        """A sensor time as UTC of the host, ns; None if unknown."""
        if not self.clock or (host := self._host_time(capture_us)) is None:
            return None
        point = self.clock[-1]
        return host[0] + point.utc_ns - point.monotonic_ns

    # ---- times --------------------------------------------------------------------------------

    def _note(self, name: str, fields: Mapping[str, str]) -> None:
        try:
            if name == "clock":
                self.clock.append(ClockPoint(int(fields["sensor_us"]), int(fields["host_monotonic_ns"]),
                                              int(fields["host_utc_ns"]), int(fields["error_ns"])))  # fmt: skip
            elif name == "gap":
                n = fields["missing_frames"]
                self._gaps.append(LineGap(float(fields["lost_s"]), int(n) if n.isdecimal() else None))
        except (KeyError, ValueError):
            self._problem(f"an invalid metadata record {name!r} was skipped")

    def _host_time(self, capture_us: int) -> tuple[int, int] | None:
        """Monotonic time and its error bound, interpolated between two clock records or from the nearest one."""
        clock = self.clock
        if not clock:
            return None
        i = bisect_left([p.sensor_us for p in clock], capture_us)
        if 0 < i < len(clock):
            a, b = clock[i - 1], clock[i]
            span_us = b.sensor_us - a.sensor_us
            way = (b.monotonic_ns - a.monotonic_ns) - 1000 * span_us
            offset = a.monotonic_ns - 1000 * a.sensor_us + round(way * (capture_us - a.sensor_us) / max(span_us, 1))
            return 1000 * capture_us + offset, max(a.error_ns, b.error_ns) + round(WANDER * 1000 * span_us)
        point = clock[min(i, len(clock) - 1)]
        away_us = capture_us - point.sensor_us
        return point.monotonic_ns + 1000 * away_us, point.error_ns + round(MAX_DRIFT * 1000 * abs(away_us))

    # ---- the file -----------------------------------------------------------------------------

    def _problem(self, text: str) -> None:
        text = f"{self.path}: {text}"
        if text not in self.problems:
            self.problems.append(text)

    def _records(self, *, all_chunks: bool) -> Iterator[tuple[int, Any]]:
        """Schemas, channels, messages and metadata; without `all_chunks` only chunks up to the first with HELLO."""
        try:
            with readable(self.path, None).open("rb") as stream:
                if stream.read(len(MAGIC)) != MAGIC:
                    if not self._ends_as_mcap(stream):
                        raise InputError(f"{self.path} is not an MCAP file: make one with `ruffini record`")
                    self._problem("its first bytes are invalid")
                for kind, record in self._top(stream):
                    if kind == CHUNK:
                        if all_chunks or "/ruffini/hello" not in self._topics.values() or not self._has_raw:
                            yield from self._inside(record)
                    else:
                        yield from self._read(kind, record)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _ends_as_mcap(self, stream: BinaryIO) -> bool:
        """True if the file ends as an MCAP file does; leaves the stream after its first bytes."""
        if self.path.stat().st_size < 2 * len(MAGIC):
            return False
        stream.seek(-len(MAGIC), 2)
        end = stream.read()
        stream.seek(len(MAGIC))
        return end == MAGIC

    def _top(self, stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
        """The records of the file, summary included; continues at the next chunk after invalid bytes."""
        size = self.path.stat().st_size
        while True:
            at = stream.tell()
            head = stream.read(HEAD.size)
            if len(head) < HEAD.size:
                self._problem(f"it was cut off after {size} bytes: the rest is missing")
                return
            kind, length = HEAD.unpack(head)
            if kind == FOOTER:
                return
            if at + HEAD.size + length <= size and 0 < kind <= LAST_KIND and length <= MAX_RECORD_BYTES:
                yield kind, stream.read(length)
                continue
            there = self._next_chunk(at + 1, size)
            if there is not None:
                self._problem(f"bytes {at} to {there} are invalid: their messages are lost")
                stream.seek(there)
                continue
            self._problem(
                f"it is cut off or damaged in a record at byte {at} of {size}: the extent of the loss is unknown"
            )
            if kind == CHUNK:
                yield kind, stream.read(min(length, MAX_RECORD_BYTES))
            return

    def _next_chunk(self, start: int, size: int) -> int | None:
        """Start of the next complete chunk: the two lengths in its header agree and it ends within the file."""
        with self.path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            while (found := CHUNK_HEAD.search(data, start)) is not None:
                length = int.from_bytes(found[1], "little")
                end = found.start() + HEAD.size + length
                if found.end() + int.from_bytes(found[2], "little") == end <= size:
                    return found.start()
                start = found.start() + 1
        return None

    def _inside(self, data: bytes) -> Iterator[tuple[int, Any]]:
        """The records of a chunk; of a truncated or damaged one those that are complete."""
        try:
            _, _, size, crc, n = struct.unpack_from("<QQQII", data)
            compression = data[32 : 32 + n].decode()
            body = data[40 + n :]
            inside = _decompressed(body, compression, min(size, MAX_RECORD_BYTES))
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            self._problem(f"an unreadable chunk of {len(data)} bytes was skipped: {error}")
            return
        is_damaged = len(inside) == size and crc != 0 and zlib.crc32(inside) != crc
        if is_damaged:
            self._problem(f"a chunk of {len(data)} bytes is damaged: only messages with a correct checksum are used")
        if len(inside) < size:
            self._problem(f"a chunk holds {len(inside)} of {size} bytes: the rest of it is lost")
        at = 0
        while at + HEAD.size <= len(inside):
            kind, length = HEAD.unpack_from(inside, at)
            at += HEAD.size
            if at + length > len(inside):
                return
            # The line's own bytes carry their checksums; nothing else of a spoilt chunk can be believed.
            if not is_damaged or kind == MESSAGE:
                for record in self._read(kind, inside[at : at + length]):
                    if not is_damaged or self._is_raw(*record):
                        yield record
            at += length

    def _is_raw(self, kind: int, record: Any) -> bool:
        return kind == MESSAGE and self._topics.get(record.channel_id) == RAW_TOPIC

    def _read(self, kind: int, data: bytes) -> Iterator[tuple[int, Any]]:
        from mcap import records
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError

        stream = ReadDataStream(BytesIO(data))
        try:
            if kind == SCHEMA:
                yield kind, records.Schema.read(stream)
            elif kind == CHANNEL:
                channel = records.Channel.read(stream)
                self._topics[channel.id] = channel.topic
                self._has_raw |= channel.topic == RAW_TOPIC
            elif kind == MESSAGE:
                yield kind, records.Message.read(stream, len(data))
            elif kind == ATTACHMENT:
                if zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
                    raise ValueError("its checksum does not fit")
                yield kind, records.Attachment.read(stream)
            elif kind == METADATA:
                yield kind, records.Metadata.read(stream)
        except (McapError, struct.error, UnicodeDecodeError, ValueError, EOFError) as error:
            self._problem(f"a record of {len(data)} bytes cannot be read and was passed over: {error}")


def _decompressed(data: bytes, compression: str, size: int) -> bytes:
    """As much of `size` bytes as can be had."""
    if compression == "":
        return data[:size]
    if compression != "zstd":
        raise ValueError(f"compressed with {compression!r}, which this host does not read")
    import zstandard

    out, decompressor = bytearray(), zstandard.ZstdDecompressor().decompressobj()
    try:
        for at in range(0, len(data), 4096):  # in pieces: what came before a spoilt one is kept
            out += decompressor.decompress(data[at : at + 4096])
            if len(out) >= size or decompressor.eof:
                break
    except zstandard.ZstdError:
        pass
    return bytes(out[:size])
