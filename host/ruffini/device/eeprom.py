"""The EEPROM of a board or of a gel cartridge: which one it is. The bytes are described in firmware/hw/identity.h."""

from __future__ import annotations

import re
import struct
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import google_crc32c

from ruffini.errors import InputError, NoDeviceError, VerifyError

Kind = Literal["board", "gel"]
KINDS: dict[Kind, int] = {"board": 1, "gel": 2}
MAGIC, VERSION = b"RFID", 1
HEADER, CRC = struct.Struct("<4sBBH"), struct.Struct("<I")
TAGS = {"serial": 1, "name": 2, "revision": 3, "made": 4}
MAX_BYTES = 256
CHUNK_BYTES = 32  # of one transfer: some adapters take no more
PAGE_BYTES = 8  # of the smallest EEPROM: a longer write would wrap round inside a page
WRITE_S = 0.01  # an EEPROM does not answer while it writes, 5 ms as a rule
TRIES = 3
SERIAL = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,22}")


@dataclass(frozen=True)
class Identity:
    """Which board, or which gel."""

    serial: str
    name: str = ""
    revision: str = ""
    made: str = ""


def encode(identity: Identity, kind: Kind) -> bytes:
    """The bytes of an identity. Raises InputError where it is none."""
    if SERIAL.fullmatch(identity.serial) is None:
        raise InputError(f"serial {identity.serial!r}: give 1 to 23 letters, digits, - _ . (none of them a . in front)")
    entries = b""
    for name, text in asdict(identity).items():
        if not text:
            continue
        if not re.fullmatch(r"[ -~]{1,64}", text):
            raise InputError(f"{name} {text!r}: give at most 64 printable ASCII characters")
        entries += bytes([TAGS[name], len(text)]) + text.encode()
    data = HEADER.pack(MAGIC, VERSION, KINDS[kind], len(entries)) + entries
    return data + CRC.pack(google_crc32c.value(data))


def decode(data: bytes, kind: Kind) -> Identity:
    """The identity at the start of `data`. Raises InputError where there is none of this kind, or it is damaged."""
    n = _whole_bytes(data)
    if n is None or len(data) < n:
        raise InputError("holds no identity")
    body, (crc,) = data[: n - CRC.size], CRC.unpack(data[n - CRC.size : n])
    if google_crc32c.value(body) != crc:
        raise InputError("holds a damaged identity (its checksum is wrong)")
    if body[4] != VERSION:
        raise InputError("holds an identity of a version that is not known")
    if body[5] != KINDS[kind]:
        raise InputError("holds an identity of another kind")
    texts, rest = dict.fromkeys(TAGS, ""), body[HEADER.size :]
    names = {tag: name for name, tag in TAGS.items()}
    while rest:
        if len(rest) < 2 or len(rest) - 2 < rest[1]:
            raise InputError("holds an identity whose entries are cut short")
        text = rest[2 : 2 + rest[1]]
        if rest[0] in names:
            if not all(0x20 <= byte <= 0x7E for byte in text):
                raise InputError("holds an identity that is no printable text")
            texts[names[rest[0]]] = text.decode("ascii")
        rest = rest[2 + rest[1] :]
    if SERIAL.fullmatch(texts["serial"]) is None:
        raise InputError("holds an identity without a proper serial number")
    return Identity(**texts)


def _whole_bytes(data: bytes) -> int | None:
    if len(data) < HEADER.size or data[:4] != MAGIC:
        return None
    n = HEADER.size + int(HEADER.unpack_from(data)[3]) + CRC.size
    return n if n <= MAX_BYTES else None


class Eeprom:
    """One EEPROM on an I2C bus.

    Parameters
    ----------
    bus : object
        An open bus with `i2c_rdwr`, such as smbus2.SMBus.
    address : int
        Of the EEPROM, 8 to 0x77.
    address_bytes : int
        Of a place in it: 1 up to 24C02, 2 from 24C32 on.
    """

    def __init__(
        self, bus: Any, address: int, address_bytes: int, *, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._bus, self.address, self._address_bytes, self._sleep = bus, address, address_bytes, sleep

    def read(self, n: int) -> bytes:
        """The first n bytes. Raises NoDeviceError where nobody answers."""
        from smbus2 import i2c_msg

        data = b""
        while len(data) < n:
            ask = i2c_msg.write(self.address, self._place(len(data)))
            answer = i2c_msg.read(self.address, min(CHUNK_BYTES, n - len(data)))
            self._transfer(ask, answer)
            data += bytes(answer)
        return data

    def identity(self, kind: Kind) -> Identity:
        """What it says. Raises NoDeviceError, or InputError where it says nothing of this kind."""
        head = self.read(HEADER.size)
        n = _whole_bytes(head)
        try:
            return decode(self.read(n) if n is not None else head, kind)
        except InputError as error:
            raise InputError(
                f"EEPROM at 0x{self.address:02x} {error}: `ruffini board eeprom write` writes one"
            ) from error

    def write(self, data: bytes) -> None:
        """Write from the first byte on, and read it back. Raises NoDeviceError, VerifyError."""
        from smbus2 import i2c_msg

        for start in range(0, len(data), PAGE_BYTES):
            self._transfer(i2c_msg.write(self.address, self._place(start) + list(data[start : start + PAGE_BYTES])))
            self._sleep(WRITE_S)
        if self.read(len(data)) != data:
            raise VerifyError(f"EEPROM at 0x{self.address:02x} does not hold what was written: is its write protection "
                              "on (pin WP), or does it need another --address-bytes?")  # fmt: skip

    def _place(self, at: int) -> list[int]:
        return list(at.to_bytes(self._address_bytes, "big"))

    def _transfer(self, *messages: Any) -> None:
        for n in range(TRIES):
            try:
                self._bus.i2c_rdwr(*messages)
                return
            except OSError as error:
                if n == TRIES - 1:
                    why = error.strerror or error
                    raise NoDeviceError(
                        f"EEPROM at 0x{self.address:02x} does not answer ({why}): is it plugged in, and is this its "
                        "address (i2cdetect -y)?"
                    ) from error


def open_bus(path: Path) -> Any:
    """The I2C bus at a path such as /dev/i2c-1. Raises NoDeviceError."""
    from smbus2 import SMBus

    try:
        return SMBus(str(path))
    except OSError as error:
        raise NoDeviceError(f"{path} cannot be opened ({error.strerror}): is I2C switched on (dtparam=i2c_arm=on, "
                            "modprobe i2c-dev), and are you in the group i2c?") from error  # fmt: skip
