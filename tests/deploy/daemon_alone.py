"""ruffinid with no host tool beside it: a replay's force read from the line, with Python 3.9 and nothing else.

    python3 tests/deploy/daemon_alone.py FOLDER COMMAND...

FOLDER is what `installed.py frames FOLDER` makes; COMMAND is ruffinid with its --board, and an emulator
before it where it needs one.
The wire format is read as proto/README.md states it. Exit code 0: a frame in one piece brought the force.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import tty

FROM_HOST, WRENCH, COMMAND = 1, 4, 11
EACH_WRENCH = bytes([8, 1, 18, 6, 10, 4, 8, WRENCH, 16, 1])  # Command 1: subscribe to WRENCH, every = 1
POLYNOMIAL = 0x82F63B78
PUSHED_UN = 100_000
TIMEOUT_S = 60


def crc32c(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ POLYNOMIAL * (crc & 1)
    return crc ^ 0xFFFFFFFF


def on_the_wire(message_type: int, payload: bytes) -> bytes:
    frame = bytes([1, FROM_HOST, message_type, 0, 0, 0, 0, 0, 0, 1]) + len(payload).to_bytes(2, "little") + payload
    frame += crc32c(frame).to_bytes(4, "little")
    pieces = frame.split(b"\0")  # shorter than 254 bytes each
    return b"\0" + b"".join(bytes([len(piece) + 1]) + piece for piece in pieces) + b"\0"


def read_frame(coded: bytes) -> bytes | None:
    """Header and payload; None if it is damaged."""
    frame, at = b"", 0
    while at < len(coded):
        length = coded[at]
        frame += coded[at + 1 : at + length]
        at += length
        if length < 255 and at < len(coded):
            frame += b"\0"
    if len(frame) < 16 or crc32c(frame[:-4]) != int.from_bytes(frame[-4:], "little"):
        return None
    return frame[:-4]


def varint(data: bytes, at: int) -> tuple[int, int]:
    """Its value and where the next byte is."""
    value = shift = 0
    while True:
        value |= (data[at] & 127) << shift
        shift, at = shift + 7, at + 1
        if data[at - 1] < 128:
            return value, at


def force_x_un(message: bytes) -> int:
    """`force_x_un` of a Wrench, which stands behind its stamp alone."""
    at = 0
    while at < len(message):
        key, at = varint(message, at)
        value, at = varint(message, at)
        if key == 2 << 3:
            return value >> 1 ^ -(value & 1)
        if key & 7 == 2:
            at += value
    return 0


def main(folder: str, command: list[str]) -> int:
    with tempfile.TemporaryDirectory() as store:
        words = ["--camera", f"replay:{folder}", "--loop", "--link", "pty", "--store", store]
        words += ["--factory", f"{folder}/calibration.safetensors"]
        with subprocess.Popen([*command, *words], stdout=subprocess.PIPE, text=True) as daemon:
            try:
                assert daemon.stdout is not None
                first = daemon.stdout.readline()
                if not first.startswith("link: "):
                    sys.exit(f"daemon_alone: ruffinid said {first!r}")
                line = os.open(first.removeprefix("link: ").strip(), os.O_RDWR | os.O_NOCTTY)
                tty.setraw(line)
                os.write(line, on_the_wire(COMMAND, EACH_WRENCH))
                rest, end, n = b"", time.monotonic() + TIMEOUT_S, 0
                while time.monotonic() < end:
                    *frames, rest = (rest + os.read(line, 4096)).split(b"\0")
                    for frame in filter(None, map(read_frame, frames)):
                        n += frame[2] == WRENCH
                        if frame[2] == WRENCH and force_x_un(frame[12:]) > PUSHED_UN:
                            print(f"ruffinid alone: {force_x_un(frame[12:]) / 1e6:.2f} N along x, after {n} frames")
                            return 0
                sys.exit(f"daemon_alone: no force along x in {n} frames of {TIMEOUT_S} s")
            finally:
                daemon.terminate()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
