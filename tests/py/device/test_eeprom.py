"""EEPROMs of boards and gels: the bytes that the firmware reads, and a bus that fails."""

from __future__ import annotations

from typing import Any

import pytest
from smbus2 import i2c_msg

from ruffini.device import eeprom
from ruffini.errors import InputError, NoDeviceError, VerifyError

GEL = eeprom.Identity("G-0007", "soft", "", "2026-11")
# The same bytes are in tests/cpp/hw/identity_test.cpp.
BYTES = b"RFID\x01\x02\x17\x00\x01\x06G-0007\x02\x04soft\x04\x072026-11\xf4\xe9\x60\x5f"


class FakeBus:
    """EEPROMs with pages of eight bytes, as the smallest have."""

    def __init__(self, address_bytes: int = 1) -> None:
        self.memories: dict[int, bytearray] = {0x50: bytearray(b"\xff" * 512)}
        self.address_bytes = address_bytes
        self.errors: list[OSError] = []
        self.is_protected = False

    def i2c_rdwr(self, *messages: Any) -> None:
        if self.errors:
            raise self.errors.pop(0)
        place = 0
        for message in messages:
            if message.addr not in self.memories:
                raise OSError(6, "No such device or address")
            memory = self.memories[message.addr]
            if message.flags & 1:
                for i in range(message.len):
                    message.buf[i] = memory[place + i]
                continue
            data = bytes(message)
            place = int.from_bytes(data[: self.address_bytes], "big")
            for i, byte in enumerate(data[self.address_bytes :]):
                if not self.is_protected:
                    memory[place - place % 8 + (place + i) % 8] = byte


def memory(bus: FakeBus, address: int = 0x50) -> eeprom.Eeprom:
    return eeprom.Eeprom(bus, address, bus.address_bytes, sleep=lambda _: None)


def test_bytes_are_those_of_the_firmware():
    assert eeprom.encode(GEL, "gel") == BYTES
    assert eeprom.decode(BYTES, "gel") == GEL
    assert eeprom.decode(BYTES + b"\xff" * 20, "gel") == GEL


def test_every_flipped_bit_and_every_length_is_refused():
    for bit in range(8 * len(BYTES)):
        flipped = bytearray(BYTES)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(InputError):
            eeprom.decode(bytes(flipped), "gel")
    for n in range(len(BYTES)):
        with pytest.raises(InputError):
            eeprom.decode(BYTES[:n], "gel")


@pytest.mark.parametrize("serial", ["", "a/b", "..", ".a", "a b", "x" * 24, "ä"])
def test_odd_serials_are_refused(serial):
    with pytest.raises(InputError, match="serial"):
        eeprom.encode(eeprom.Identity(serial), "gel")


def test_another_kind_is_refused():
    with pytest.raises(InputError, match="another kind"):
        eeprom.decode(BYTES, "board")


@pytest.mark.parametrize("address_bytes", [1, 2])
def test_written_and_read_over_the_bus(address_bytes):
    bus = FakeBus(address_bytes)
    memory(bus).write(eeprom.encode(GEL, "gel"))
    assert memory(bus).identity("gel") == GEL


def test_an_empty_one_says_what_to_do():
    with pytest.raises(InputError, match=r"0x50 holds no identity.*eeprom write"):
        memory(FakeBus()).identity("gel")


def test_two_faults_are_over_a_third_is_not():
    bus = FakeBus()
    memory(bus).write(BYTES)
    fault = OSError(5, "Input/output error")
    bus.errors = [fault, fault]
    assert memory(bus).identity("gel") == GEL
    bus.errors = [fault, fault, fault]
    with pytest.raises(NoDeviceError, match="Input/output error"):
        memory(bus).identity("gel")


def test_nobody_at_the_address():
    with pytest.raises(NoDeviceError, match="0x51 does not answer"):
        memory(FakeBus(), 0x51).identity("gel")


def test_write_protection_is_seen():
    bus = FakeBus()
    bus.is_protected = True
    with pytest.raises(VerifyError, match="WP"):
        memory(bus).write(BYTES)


def test_smbus_messages_are_what_the_fake_takes():
    """The fake stands for smbus2: reads carry the flag that it looks at."""
    assert i2c_msg.read(0x50, 4).flags & 1 == 1
    assert i2c_msg.write(0x50, [0]).flags & 1 == 0
