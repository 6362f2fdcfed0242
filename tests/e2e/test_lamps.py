"""Lamps that the computer cannot switch: said, told in STATUS, and no reason not to run."""

from __future__ import annotations

from pathlib import Path

import pytest
from hang import HANG_S
from test_bad_input import is_one_sentence, run_daemon
from tiny_sensor import Sensor, start, write_board

from ruffini.boards import find_board
from ruffini.device import Connection
from ruffini.device.health import health_words

LINE = '\n[light]\nchip = "gpiochip-none"\nline = "LAMPS"\n'
DRIVER = (
    '\n[led_driver]\nbus = "/dev/i2c-none"\naddress = 21\nresistor_ohm = 1000\ncurrents_ua = [20000]\nramp_ms = 200\n'
)


def with_lamps(sensor: Sensor, folder: Path, section: str) -> Sensor:
    board = write_board(folder / "tiny", {})
    with (board / "board.toml").open("a") as file:
        file.write(section)
    return Sensor(find_board(board), board, sensor.recording, b"")


def health(sensor: Sensor, store: Path) -> tuple[set[str], str]:
    """Bits of the first STATUS, and what the daemon said before it."""
    with start(sensor, store, "--loop") as daemon, Connection(daemon.port) as host:
        host.subscribe(status=1)
        status = next(m for f, m in host.stream(timeout_s=HANG_S) if host.schema.type_name(f.type) == "STATUS")
        bits = set(host.schema.enum_names("HealthBit", status.health))
        assert daemon.process.stderr is not None
        return bits, daemon.process.stderr.readline() if "HEALTH_LIGHT" in bits else ""


@pytest.mark.parametrize(("section", "words"), [(LINE, "gpiochip-none"), (DRIVER, "/dev/i2c-none")])
def test_dark_lamps_are_told_while_it_runs(sensor: Sensor, tmp_path: Path, section: str, words: str) -> None:
    bits, said = health(with_lamps(sensor, tmp_path, section), tmp_path / "store")
    assert "HEALTH_LIGHT" in bits
    assert said.startswith("ruffinid: the lamps stay dark: ")
    assert words in said
    assert health_words(["HEALTH_LIGHT"])[0].startswith("the lamps are not as the board asks")


def test_a_board_without_lamps_has_no_fault_of_them(sensor: Sensor, tmp_path: Path) -> None:
    bits, _ = health(sensor, tmp_path / "store")
    assert "HEALTH_LIGHT" not in bits


def test_lights_off_switches_and_ends(sensor: Sensor, tmp_path: Path) -> None:
    """What the service runs after a daemon that the watchdog ended."""
    code, said = run_daemon(sensor.folder, "libcamera:", tmp_path / "store", "--lights-off")
    assert (code, said) == (0, "")
    assert not (tmp_path / "store").exists()
    both = with_lamps(sensor, tmp_path, LINE + DRIVER)
    code, said = run_daemon(both.folder, "libcamera:", tmp_path / "store", "--lights-off")
    assert code == 3
    assert is_one_sentence(said)
    assert "gpiochip-none" in said
    assert "/dev/i2c-none" in said
