"""A camera on USB for tests: what a UVC device answers, on a socket that the kernel's vhci-hcd takes for a cable.

    python3 usb_camera.py STATE

As root, with vhci-hcd there. It is plugged in at the start and unplugged at the end of stdin. Its picture is
eight colour bars, as bright as its exposure and gain make them. STATE, a JSON file, says what the host has set.
A line NAME NUMBER on stdin changes a control by itself, as a bad camera does.

From the public specifications: USB/IP (Documentation/usb/usbip_protocol.rst of Linux), USB Video Class 1.1.
Bulk, as UVC allows: isochronous packets are not there. No time stamps of its own; the kernel's are used.
"""

from __future__ import annotations

import itertools
import json
import socket
import struct
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

WIDTH, HEIGHT = 160, 120
FRAME_BYTES = 2 * WIDTH * HEIGHT  # YUY2
INTERVALS = (1_000_000, 2_000_000)  # of frames, in 100 ns; the first where nobody asks
PAYLOAD_BYTES = 16_384  # of one transfer, with its header
VENDOR, PRODUCT = 0x1D6B, 0x0102  # the Linux Foundation's webcam gadget
NAMED = f"{VENDOR:04x}:{PRODUCT:04x}"  # the end of libcamera's id of it
TEXTS = ("", "ruffini tests", "emulated UVC camera", "UVC-0001")
BARS = [(1, 1, 1), (1, 1, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 0)]  # red, green, blue
FULL_LEVEL = 200  # of a bar that is 1, at FULL_TIME and gain 1
FULL_TIME = 100  # 100 us: 10 ms
GAIN_1 = 20
EPIPE, ECONNRESET = 32, 104
CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
PORT = 0  # of it
HIGH_SPEED = 3  # enum usb_device_speed

CAMERA, PROCESSING, OUTPUT = 1, 2, 3  # units
SET_CUR, GET_CUR, GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, GET_DEF = 1, 0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
MANUAL, APERTURE_PRIORITY = 1, 8  # exposure modes: bits


@dataclass
class Control:
    """A number that the host may set. `by_itself`: the device may change it, so the kernel asks each time."""

    name: str
    n_bytes: int
    minimum: int
    maximum: int
    step: int
    default: int
    by_itself: bool = True
    now: int = 0

    def __post_init__(self) -> None:
        self.now = self.default

    def answer(self, request: int) -> bytes:
        if request == GET_INFO:
            return bytes([0x0B if self.by_itself else 0x03])  # get, set; autoupdate
        if request == GET_LEN:
            return self.n_bytes.to_bytes(2, "little")
        number = {GET_CUR: self.now, GET_MIN: self.minimum, GET_MAX: self.maximum, GET_RES: self.step}
        return number.get(request, self.default).to_bytes(self.n_bytes, "little")


def block(kind: int, *fields: bytes | int) -> bytes:
    """A descriptor: its length, its kind, and bytes."""
    rest = b"".join(bytes([field]) if isinstance(field, int) else field for field in fields)
    return bytes([2 + len(rest), kind]) + rest


def u16(*numbers: int) -> bytes:
    return struct.pack(f"<{len(numbers)}H", *numbers)


def u32(*numbers: int) -> bytes:
    return struct.pack(f"<{len(numbers)}I", *numbers)


def configuration() -> bytes:
    """USB 2.0, 9.6; UVC 1.1, 3.5 to 3.9; frame based on 'Uncompressed Payload', 3.1."""
    units = (
        block(0x24, 2, CAMERA, u16(0x0201), 0, 0, u16(0, 0, 0), 3, bytes([0x0A, 0, 0]))  # exposure mode, time
        + block(0x24, 5, PROCESSING, CAMERA, u16(0), 2, u16(1 << 0 | 1 << 6 | 1 << 9 | 1 << 12), 0, 0)
        + block(0x24, 3, OUTPUT, u16(0x0101), 0, PROCESSING, 0)
    )
    head = block(0x24, 1, u16(0x0110, 13 + len(units)), u32(48_000_000), 1, 1)
    yuy2 = b"YUY2" + bytes.fromhex("00001000800000aa00389b71")
    rate = [8 * FRAME_BYTES * 10_000_000 // interval for interval in INTERVALS]
    formats = (
        block(0x24, 4, 1, 1, yuy2, 16, 1, 0, 0, 0, 0)
        + block(0x24, 5, 1, 0, u16(WIDTH, HEIGHT), u32(min(rate), max(rate), FRAME_BYTES, INTERVALS[0]),
                len(INTERVALS), u32(*INTERVALS))
        + block(0x24, 13, 1, 1, 4)  # BT.709's primaries and transfer, BT.601's matrix
    )  # fmt: skip
    stream = block(0x24, 1, 1, u16(14 + len(formats)), 0x81, 0, OUTPUT, 0, 0, 0, 1, 0)
    all_of_it = (
        block(0x0B, 0, 2, 0x0E, 3, 0, 2)
        + block(4, 0, 0, 0, 0x0E, 1, 0, 2) + head + units
        + block(4, 1, 0, 1, 0x0E, 2, 0, 0) + stream + formats + block(5, 0x81, 2, u16(512), 0)
    )  # fmt: skip
    return block(2, u16(9 + len(all_of_it)), 2, 1, 0, 0x80, 250) + all_of_it


def descriptor(kind: int, index: int) -> bytes | None:
    if kind == 1:
        return block(1, u16(0x0200), 0xEF, 2, 1, 64, u16(VENDOR, PRODUCT, 0x0100), 1, 2, 3, 1)
    if kind == 2:
        return configuration()
    if kind == 3 and index < len(TEXTS):
        return block(3, TEXTS[index].encode("utf-16le") if index else u16(0x0409))
    return None


def row(level: float) -> bytes:
    """A row of the picture, YUY2, BT.601 limited."""
    out = bytearray()
    for bar in BARS:
        r, g, b = (min(255.0, level * part) / 255 for part in bar)
        y = 16 + 219 * (0.299 * r + 0.587 * g + 0.114 * b)
        u, v = 128 + 224 * (-0.168736 * r - 0.331264 * g + 0.5 * b), 128 + 224 * (0.5 * r - 0.418688 * g - 0.081312 * b)
        out += bytes([round(y), round(u), round(y), round(v)]) * (WIDTH // len(BARS) // 2)
    return bytes(out)


class UsbCamera:
    """The device: answers on `line`, from one thread; makes frames in another."""

    def __init__(self, line: socket.socket, state: Path) -> None:
        self.line, self.state = line, state
        self.sending = threading.Lock()
        self.changed = threading.Condition()  # of `waiting` and `n_starts`
        self.waiting: deque[int] = deque()  # transfers of pictures, by number
        self.n_starts = 0
        self.frame_interval = INTERVALS[0]
        self.controls = {
            (CAMERA, 0x02): Control("exposure_mode", 1, 1, 15, MANUAL | APERTURE_PRIORITY, APERTURE_PRIORITY, False),
            (CAMERA, 0x04): Control("exposure", 4, 1, 10_000, 1, 156),  # in 100 us
            (PROCESSING, 0x02): Control("brightness", 2, 0, 255, 1, 128, False),
            (PROCESSING, 0x04): Control("gain", 2, 10, 80, 1, GAIN_1),
            (PROCESSING, 0x0A): Control("white_temperature", 2, 2_800, 6_500, 10, 4_600),
            (PROCESSING, 0x0B): Control("white_auto", 1, 0, 1, 1, 1, False),
        }
        self.by_name = {control.name: control for control in self.controls.values()}

    def tell(self) -> None:
        new = self.state.with_suffix(".new")
        new.write_text(json.dumps({control.name: control.now for control in self.controls.values()}))
        new.rename(self.state)

    def probe(self) -> bytes:
        return (u16(1) + bytes([1, 1]) + u32(self.frame_interval) + u16(0, 0, 0, 0, 0)
                + u32(FRAME_BYTES, PAYLOAD_BYTES, 48_000_000) + bytes(4))  # fmt: skip

    def of_interface(self, request: int, value: int, index: int, data: bytes) -> bytes | None:
        """Requests of the video class; None: the device cannot."""
        interface, unit, selector = index & 0xFF, index >> 8, value >> 8
        if interface == 1 and selector in (1, 2):  # probe, commit
            if request == SET_CUR:
                asked = struct.unpack_from("<I", data, 4)[0]
                self.frame_interval = min(INTERVALS, key=lambda interval: abs(interval - asked))
                if selector == 2:
                    self.restart()
                return b""
            return {GET_LEN: u16(34), GET_INFO: b"\x03"}.get(request, self.probe())
        control = self.controls.get((unit, selector))
        if interface != 0 or control is None:
            return None
        if request != SET_CUR:
            return control.answer(request)
        asked = int.from_bytes(data[: control.n_bytes], "little")
        is_automatic = (control.name == "exposure" and self.by_name["exposure_mode"].now != MANUAL) or (
            control.name == "white_temperature" and self.by_name["white_auto"].now == 1
        )
        if is_automatic or not control.minimum <= asked <= control.maximum:
            return None
        control.now = asked
        self.tell()
        return b""

    def restart(self) -> None:
        with self.changed:
            self.n_starts += 1
            self.changed.notify()

    def of_control(self, setup: bytes, data: bytes) -> bytes | None:
        kind, request, value, index, n_bytes = struct.unpack("<BBHHH", setup)
        if kind & 0x60 == 0x20:
            answer = self.of_interface(request, value, index, data)
        elif request == 6:
            answer = descriptor(value >> 8, value & 0xFF)
        elif request in (0, 8, 10):  # status, configuration, interface
            answer = {0: bytes(2), 8: b"\x01", 10: b"\x00"}[request]
        else:
            answer = b""  # set configuration, interface; clear halt
        return None if answer is None else answer[:n_bytes]

    def send(self, number: int, status: int, data: bytes = b"", n_bytes: int | None = None, kind: int = 3) -> None:
        head = struct.pack(">IIIII", kind, number, 0, 0, 0)
        rest = struct.pack(">iiiii8x", status, len(data) if n_bytes is None else n_bytes, 0, 0, 0)
        with self.sending:
            self.line.sendall(head + rest + data)

    def receive(self, n: int) -> bytes:
        got = self.line.recv(n, socket.MSG_WAITALL) if n else b""
        if len(got) < n:
            raise EOFError
        return got

    def serve(self) -> None:
        while True:
            command, number, _, is_in, endpoint = struct.unpack(">IIIII", self.receive(20))
            rest = self.receive(28)
            if command == 2:
                self.unlink(number, struct.unpack_from(">I", rest)[0])
                continue
            _, n_bytes = struct.unpack_from(">Ii", rest)
            data = b"" if is_in else self.receive(n_bytes)
            if endpoint == 0:
                answer = self.of_control(rest[20:], data)
                if answer is None:
                    self.send(number, -EPIPE)
                else:
                    self.send(number, 0, answer if is_in else b"", None if is_in else n_bytes)
            else:
                with self.changed:
                    self.waiting.append(number)
                    self.changed.notify()

    def unlink(self, number: int, which: int) -> None:
        with self.changed:
            is_there = which in self.waiting
            if is_there:
                self.waiting.remove(which)
        self.send(number, -ECONNRESET if is_there else 0, kind=4)

    def picture(self) -> bytes:
        time_100us = self.by_name["exposure"].now
        return row(FULL_LEVEL * time_100us / FULL_TIME * self.by_name["gain"].now / GAIN_1) * HEIGHT

    def next_transfer(self, start: int) -> int | None:
        """Number of a transfer that waits; None: the host has started again."""
        with self.changed:
            self.changed.wait_for(lambda: self.waiting or self.n_starts != start)
            return self.waiting.popleft() if self.n_starts == start else None

    def make_frames(self) -> None:
        room = PAYLOAD_BYTES - 2
        due = time.monotonic()
        for frame in itertools.count():
            due = max(due + self.frame_interval / 1e7, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            with self.changed:
                self.changed.wait_for(lambda: self.waiting)
                start = self.n_starts
            pixels = self.picture()
            for at in range(0, len(pixels), room):
                number = self.next_transfer(start)
                if number is None:
                    break
                is_last = at + room >= len(pixels)
                flags = 0x80 | (0x02 if is_last else 0) | frame & 1  # end of header, end of frame, the frame's bit
                self.send(number, 0, bytes([2, flags]) + pixels[at : at + room])


def main() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    camera = UsbCamera(ours, Path(sys.argv[1]))
    camera.tell()
    threading.Thread(target=camera.make_frames, daemon=True).start()
    threading.Thread(target=camera.serve, daemon=True).start()
    (CONTROLLER / "attach").write_text(f"{PORT} {theirs.fileno()} 1 {HIGH_SPEED}")
    theirs.close()
    for text in sys.stdin:
        name, number = text.split()
        camera.by_name[name].now = int(number)
        camera.tell()
    (CONTROLLER / "detach").write_text(str(PORT))


if __name__ == "__main__":
    main()
