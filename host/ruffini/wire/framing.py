"""Frames: header, payload, CRC-32C, COBS, 0x00; messages split into fragments."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import google_crc32c

PROTOCOL_VERSION = 1
MAX_FRAME_BYTES = 4096
MAX_PAYLOAD_BYTES = 4048
MAX_MESSAGE_BYTES = 255 * MAX_PAYLOAD_BYTES
FROM_HOST, SIMULATED, REPLAY = 1, 2, 4
KNOWN_FLAGS = 7
RESTART_GAP = 1 << 31  # a sequence that goes back: the device was started again, nothing was lost
_HEADER = struct.Struct("<BBBBIBBH")


def crc32c(data: bytes) -> int:
    """CRC-32C (Castagnoli); of b"123456789" it is 0xE3069283.

    Examples
    --------
    >>> hex(crc32c(b"123456789"))
    '0xe3069283'
    """
    return int(google_crc32c.value(data))


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing, without the delimiter.

    Examples
    --------
    >>> cobs_encode(b"\\x11\\x00\\x22").hex()
    '02110222'
    """
    out = bytearray()
    for part in data.split(b"\0"):
        while len(part) >= 254:
            out += b"\xff" + part[:254]
            part = part[254:]
        out += bytes([len(part) + 1]) + part
    return bytes(out)


def cobs_decode(data: bytes) -> bytes | None:
    """The inverse; None where `data` is no COBS."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        end = at + code
        if code == 0 or end > len(data) or 0 in data[at + 1 : end]:
            return None
        out += data[at + 1 : end]
        at = end
        if code != 0xFF and at < len(data):
            out.append(0)
    return bytes(out)


@dataclass(frozen=True)
class Frame:
    """One whole message, its fragments put together."""

    type: int
    sensor: int
    sequence: int
    flags: int
    payload: bytes
    # Of what was captured: when, on the host's monotonic clock, and how far off that may be. None: not known.
    host_time_ns: int | None = None
    host_time_error_ns: int | None = None
    read_ns: int | None = None  # when its last byte was read, on that clock
    end: int = field(default=0, compare=False)  # how many bytes the decoder was fed up to its end

    @property
    def is_simulated(self) -> bool:
        return bool(self.flags & SIMULATED)

    @property
    def is_replay(self) -> bool:
        return bool(self.flags & REPLAY)


def encode_message(type_: int, payload: bytes, *, sensor: int, sequence: int, flags: int = FROM_HOST) -> bytes:
    """All frames of a message, ready to be written.

    Raises
    ------
    ValueError
        The payload needs more than 255 fragments.
    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message of {len(payload)} bytes needs more than 255 fragments")
    parts = [payload[i : i + MAX_PAYLOAD_BYTES] for i in range(0, len(payload), MAX_PAYLOAD_BYTES)] or [b""]
    out = bytearray()
    for i, part in enumerate(parts):
        header = _HEADER.pack(PROTOCOL_VERSION, flags, type_, sensor, sequence & 0xFFFFFFFF, i, len(parts), len(part))
        body = header + part
        out += cobs_encode(body + struct.pack("<I", crc32c(body))) + b"\0"
    return bytes(out)


@dataclass
class Counters:
    """Why received bytes were thrown away, and how many messages the device sent that never came."""

    bad_crc: int = 0
    malformed: int = 0
    oversize: int = 0
    incomplete: int = 0
    lost: int = 0
    echo: int = 0

    @property
    def damaged(self) -> int:
        """Frames that the line spoilt."""
        return self.bad_crc + self.malformed + self.oversize


@dataclass
class Decoder:
    """Byte stream -> messages. Holds at most one frame and one unfinished message.

    Parameters
    ----------
    from_host : bool
        Which direction to listen to; frames of the other one are an echo, counted and passed over.
    """

    from_host: bool = False

    n_fed: int = 0  # bytes, of all calls
    counters: Counters = field(default_factory=Counters)
    _buffer: bytearray = field(default_factory=bytearray)
    _is_oversize: bool = False
    _parts: list[bytes] = field(default_factory=list)
    _open: tuple[int, ...] | None = None
    _last: dict[int, int] = field(default_factory=dict)

    @property
    def is_midway(self) -> bool:
        """True if bytes of a message have been fed, but not its end."""
        return bool(self._buffer) or self._open is not None

    def feed(self, data: bytes) -> Iterator[Frame]:
        """The messages that `data` completes."""
        start, n_before = 0, self.n_fed
        self.n_fed += len(data)
        while True:
            end = data.find(b"\0", start)
            chunk = data[start : end if end >= 0 else len(data)]
            if not self._is_oversize:
                if len(self._buffer) + len(chunk) > MAX_FRAME_BYTES - 1:
                    self._is_oversize = True
                    self._buffer.clear()
                    self.counters.oversize += 1
                else:
                    self._buffer += chunk
            if end < 0:
                return
            start = end + 1
            encoded, self._buffer = bytes(self._buffer), bytearray()
            if self._is_oversize:
                self._is_oversize = False
            elif encoded:
                frame = self._finish(encoded, n_before + start)
                if frame is not None:
                    yield frame

    def _finish(self, encoded: bytes, end: int) -> Frame | None:
        raw = cobs_decode(encoded)
        if raw is None or len(raw) < _HEADER.size + 4:
            self.counters.malformed += 1
            return None
        body = raw[:-4]
        if crc32c(body) != struct.unpack("<I", raw[-4:])[0]:
            self.counters.bad_crc += 1
            return None
        version, flags, type_, sensor, sequence, fragment, n_fragments, size = _HEADER.unpack_from(body)
        payload = body[_HEADER.size :]
        if (
            version != PROTOCOL_VERSION
            or flags & ~KNOWN_FLAGS
            or size != len(payload)
            or size > MAX_PAYLOAD_BYTES
            or n_fragments == 0
            or fragment >= n_fragments
        ):
            self.counters.malformed += 1
            return None
        if bool(flags & FROM_HOST) is not self.from_host:
            self.counters.echo += 1
            return None
        return self._assemble((type_, sensor, sequence, flags, n_fragments), fragment, payload, end)

    def _assemble(self, key: tuple[int, ...], fragment: int, payload: bytes, end: int) -> Frame | None:
        if fragment == 0:
            if self._open is not None:
                self.counters.incomplete += 1
            self._parts, self._open = [payload], key
        elif self._open == key and fragment == len(self._parts):
            self._parts.append(payload)
        else:
            self.counters.incomplete += self._open is not None
            self._open = None
            return None
        type_, sensor, sequence, flags, n_fragments = key
        if len(self._parts) < n_fragments:
            return None
        self._open = None
        missing = (sequence - self._last.get(sensor, sequence - 1) - 1) & 0xFFFFFFFF
        if missing < RESTART_GAP:
            self.counters.lost += missing
        self._last[sensor] = sequence
        return Frame(type_, sensor, sequence, flags, b"".join(self._parts), end=end)
