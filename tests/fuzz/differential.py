"""The same bytes through the firmware's decoders and through the host's: they must say the same of each.

python tests/fuzz/differential.py [N [SEED]]

N inputs (a million), mutated from the golden vectors: half of them bytes on the line, a quarter payloads of messages, a
quarter node values. Of a line all frames, their fields and the counters are compared; of node values all numbers. Of
a message both must make the same of it, but for what only the firmware refuses: it has limits (ruffini.options),
takes no number that its field cannot hold, where Python's protobuf cuts it off, and no field of another wire type,
which Python passes over as unknown (and no group).
"""

from __future__ import annotations

import ctypes
import random
import struct
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from ruffini.errors import InputError
from ruffini.native import native_folder
from ruffini.wire.dense import decode_dense
from ruffini.wire.framing import Decoder, cobs_decode, cobs_encode, crc32c
from ruffini.wire.messages import Schema

VECTORS = Path(__file__).parents[2] / "proto" / "vectors"
MESSAGES = {1: "Hello", 3: "Status", 4: "Wrench", 7: "Contacts", 10: "Event", 11: "Command", 12: "Reply", 13: "Learned"}
TYPE_AT, PAYLOAD_AT, CRC_BYTES = 2, 12, 4
LIMITS = (
    "array overflow",
    "string overflow",
    "bytes overflow",
    "bytes size exceeded",
    "wrong size",
    "incorrect fixed length",
)
STRICTER = ("integer too large", "varint overflow", "wrong wire type", "invalid wire_type")


class Frames(Decoder):
    """Frames before they are put together to messages."""

    def hear(self, data: bytes) -> bytes:
        """What the door says of the same bytes."""
        self.said = bytearray()
        for _ in self.feed(data):
            pass
        c = self.counters
        return bytes(self.said) + struct.pack("<4H", c.bad_crc, c.malformed, c.oversize, c.echo)

    def _assemble(self, key: tuple[int, ...], fragment: int, payload: bytes, end: int) -> None:
        type_, sensor, sequence, flags, n_fragments = key
        self.said += struct.pack("<5BIH", type_, sensor, flags, fragment, n_fragments, sequence, len(payload)) + payload


class Differential:
    """Both sides, the inputs to begin with, and what was found."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.door = ctypes.CDLL(str(native_folder() / "libruffini_decoders.so"))
        self.door.ruffini_judge_line.restype = self.door.ruffini_judge_message.restype = ctypes.c_int64
        self.schema = Schema.own()
        self.out = ctypes.create_string_buffer(1 << 16)
        self.why = ctypes.create_string_buffer(64)
        self.values = np.zeros(1 << 16, np.int32)
        self.seen: Counter[str] = Counter()
        lines = [x.split(" | ") for x in (VECTORS / "frames.txt").read_text().splitlines() if x and x[0] != "#"]
        self.lines = [bytes.fromhex(x[1]) for x in lines if len(x[1]) < 1200]
        self.payloads: dict[int, list[bytes]] = {type_: [b""] for type_ in MESSAGES}
        for line in self.lines:
            raw = cobs_decode(line[:-1]) if line.count(0) == 1 and line[-1] == 0 else None
            if raw and len(raw) >= PAYLOAD_AT + CRC_BYTES and raw[TYPE_AT] in MESSAGES:
                self.payloads[raw[TYPE_AT]].append(raw[PAYLOAD_AT:-CRC_BYTES])
        rows = [x.split(" | ") for x in (VECTORS / "dense.txt").read_text().splitlines() if x and x[0] != "#"]
        self.dense = [
            (int(x[1]), int(x[2]), int(x[3]), bytes.fromhex(x[4])) for x in rows if int(x[1]) < 2 and int(x[2]) > 0
        ]

    def mutated(self, data: bytes, others: list[bytes]) -> bytes:
        out, chance = bytearray(data), self.chance
        for _ in range(chance.randrange(4)):
            at = chance.randrange(len(out) + 1)
            match chance.randrange(6):
                case 0 if out:
                    out[at % len(out)] ^= 1 << chance.randrange(8)
                case 1 if out:
                    out[at % len(out)] = chance.choice((0, 1, 2, 0x7F, 0x80, 0xFF, chance.randrange(256)))
                case 2:
                    out[at:at] = chance.randbytes(1 + chance.randrange(3))
                case 3:
                    del out[at : at + 1 + chance.randrange(4)]
                case 4:
                    out[at:] = chance.choice(others)[-at:]
                case _:
                    out += out[at:]
        return bytes(out)

    def differs(self, what: str, data: bytes, ours: object, theirs: object) -> None:
        raise AssertionError(f"{what} {data.hex()}: the firmware says {ours!r}, the host {theirs!r}")

    def line(self) -> None:
        chance = self.chance
        data = self.mutated(chance.choice(self.lines), self.lines)
        if chance.randrange(2):  # a frame whose CRC is right, whatever its header says
            body = self.mutated((cobs_decode(data.split(b"\0")[0]) or data)[:-CRC_BYTES], self.lines)
            if chance.randrange(2) and len(body) >= PAYLOAD_AT:
                body = b"\1" + body[1:10] + struct.pack("<H", len(body) - PAYLOAD_AT) + body[PAYLOAD_AT:]
            data = cobs_encode(body + struct.pack("<I", crc32c(body))) + b"\0" + data
        from_host = chance.randrange(2)
        n = self.door.ruffini_judge_line(data, ctypes.c_int64(len(data)), from_host, self.out, ctypes.c_int64(1 << 16))
        ours, theirs = self.out.raw[:n], Frames(from_host=bool(from_host)).hear(data)
        self.seen["line, with frames" if n > 8 else "line, refused"] += 1
        if ours != theirs:
            self.differs("line", data, ours.hex(), theirs.hex())

    def nanopb(self, type_: int, data: bytes) -> bytes | str:
        n = self.door.ruffini_judge_message(
            type_, data, ctypes.c_int64(len(data)), self.out, ctypes.c_int64(1 << 16), self.why
        )
        return self.out.raw[:n] if n >= 0 else self.why.value.decode()

    def message(self) -> None:
        type_ = self.chance.choice(list(MESSAGES))
        data = self.mutated(self.chance.choice(self.payloads[type_]), [p for ps in self.payloads.values() for p in ps])
        ours, theirs = self.nanopb(type_, data), self.python(type_, data)
        if isinstance(ours, bytes) and theirs is not None:
            self.seen["message, accepted"] += 1
            if self.python(type_, ours) != theirs:
                self.differs(MESSAGES[type_], data, ours.hex(), theirs)
        elif isinstance(ours, bytes):  # a text that is no UTF-8, which nanopb does not look at
            self.seen["message, text of no UTF-8"] += 1
            if self.python(type_, ours) is not None:
                self.differs(MESSAGES[type_], data, "accepted", "refused")
        elif theirs is None:
            self.seen["message, refused"] += 1
        else:
            again = self.nanopb(type_, theirs.SerializeToString())
            self.seen[f"message, firmware alone: {ours}"] += 1
            if isinstance(again, str) and not again.startswith(LIMITS):
                self.differs(MESSAGES[type_], data, again, theirs)
            if isinstance(again, bytes) and not ours.startswith((*LIMITS, *STRICTER)):
                self.differs(MESSAGES[type_], data, ours, theirs)

    def python(self, type_: int, data: bytes) -> Any | None:
        message = self.schema.new(MESSAGES[type_])
        try:
            message.ParseFromString(data)
        except DecodeError:
            return None
        message.DiscardUnknownFields()
        if MESSAGES[type_] == "Hello" and not message.schema_sha256:
            message.schema_sha256 = bytes(32)  # of a fixed length in the firmware
        return message

    def node_values(self) -> None:
        chance = self.chance
        is_sparse, n_x, n_components, data = chance.choice(self.dense)
        data, n_y = self.mutated(data, [d[3] for d in self.dense]), 1
        if chance.randrange(4) == 0:
            is_sparse, n_x, n_y = chance.randrange(2), 1 + chance.randrange(9), 1 + chance.randrange(9)
        is_taken = self.door.ruffini_judge_dense(
            is_sparse, ctypes.c_int64(n_x * n_y), ctypes.c_int64(n_components), data, ctypes.c_int64(len(data)),
            self.values.ctypes.data_as(ctypes.c_void_p),
        )  # fmt: skip
        ours = self.values[: n_x * n_y * n_components].tolist() if is_taken else None
        try:
            theirs = decode_dense(is_sparse, n_x, n_y, n_components, data).ravel().tolist()
        except InputError:
            theirs = None
        self.seen["node values, accepted" if is_taken else "node values, refused"] += 1
        if ours != theirs:
            self.differs(f"{n_x} x {n_y} x {n_components}, sparse {is_sparse}", data, ours, theirs)

    def run(self, n: int) -> Counter[str]:
        """All inputs; AssertionError with the first that the two sides do not agree on."""
        for i in range(n):
            (self.line, self.message, self.line, self.node_values)[i % 4]()
        return self.seen


def main(arguments: list[str]) -> int:
    n = int(arguments[0]) if arguments else 1_000_000
    seen = Differential(int(arguments[1]) if len(arguments) > 1 else 1).run(n)
    print(f"differential: {n} inputs, the firmware's decoders and the host's agree")
    for what, times in sorted(seen.items()):
        print(f"  {times:8d} {what}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
