"""ruffini board eeprom as typed, on a bus in memory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from small_board import Run

from ruffini.device import eeprom


class FakeBus:
    def __init__(self) -> None:
        self.memory = bytearray(b"\xff" * 256)

    def i2c_rdwr(self, *messages: Any) -> None:
        place = 0
        for message in messages:
            if message.addr != 0x51:
                raise OSError(6, "No such device or address")
            if message.flags & 1:
                for i in range(message.len):
                    message.buf[i] = self.memory[place + i]
            else:
                place, *data = bytes(message)
                self.memory[place : place + len(data)] = data

    def close(self) -> None:
        pass


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> FakeBus:
    opened = FakeBus()
    monkeypatch.setattr(eeprom, "open_bus", lambda path: opened)
    monkeypatch.setattr(eeprom, "WRITE_S", 0)
    return opened


WORDS = ("board", "eeprom")


def test_written_read_and_kept(run: Run, bus: FakeBus) -> None:
    write = (*WORDS, "write", "--address", "0x51", "--serial")
    assert run(*write, "G-1", "--name", "soft")[0] == 0
    code, out, _ = run(*WORDS, "read", "--address", "0x51", "--json")
    assert code == 0
    assert json.loads(out) == {"kind": "gel", "serial": "G-1", "name": "soft", "revision": "", "made": ""}
    before = bytes(bus.memory)
    code, _, err = run(*write, "G-2")
    assert code == 4
    assert "serial G-1" in err
    assert "--yes" in err
    assert run(*write, "G-2", "--yes", "--dry-run")[0] == 0
    assert bytes(bus.memory) == before
    assert run(*write, "G-2", "--yes")[0] == 0
    assert run(*WORDS, "read", "--address", "0x51")[1] == "serial G-2\n"


def test_what_is_wrong_is_said(run: Run, bus: FakeBus) -> None:
    code, _, err = run(*WORDS, "read", "--address", "0x51")
    assert code == 2
    assert "holds no identity" in err
    code, _, err = run(*WORDS, "read", "--address", "0x50")
    assert code == 3
    assert "does not answer" in err
    assert run(*WORDS, "read", "--address", "0x78")[0] == 2
    assert run(*WORDS, "write", "--address", "0x51", "--serial", "a/b")[0] == 2


def test_a_bus_that_is_missing(run: Run, tmp_path: Path) -> None:
    code, _, err = run(*WORDS, "read", "--bus", tmp_path / "i2c-9")
    assert code == 3
    assert "dtparam=i2c_arm=on" in err
