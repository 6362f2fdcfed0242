"""Runs inside the emulated Raspberry Pi as its only program (.ci/pi): the Pi's own I2C and GPIO drivers.

QEMU's SDA and SCL carry a TMP105 at 0x48 and two EEPROMs of 4 KiB at 0x50 and 0x51.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

from checks import check, content, run, run_all, tool, until

BOARD = Path("/vm/pipad")
BUS = Path("/sys/bus/i2c/devices/i2c-1")
EEPROM = ["--bus", "/dev/i2c-1", "--address-bytes", "2"]
RUFFINID = ["ruffinid", "--board", str(BOARD), "--camera", "replay:/vm/frames", "--loop", "--link", "pty",
            "--store", "/run/store"]  # fmt: skip
MILLI_CELSIUS = 25_500  # as .ci/pi sets the chip
NOBODY = "nobody answers: is it plugged in, and is this its address"


@check
def identities() -> str:
    """EEPROMs: both written by the host tool and read back; an address at which nobody is"""
    none = tool("board", "eeprom", "read", *EEPROM, "--address", "0x51", code=2)
    assert "holds no identity" in none, none
    for kind, address, words in (
        ("board", "0x50", ["--serial", "PI-0001", "--name", "pipad"]),
        ("gel", "0x51", ["--serial", "G-7", "--name", "soft", "--made", "2026-11"]),
    ):
        tool("board", "eeprom", "write", *EEPROM, "--kind", kind, "--address", address, *words)
        assert words[1] in tool("board", "eeprom", "read", *EEPROM, "--kind", kind, "--address", address)
    nobody = tool("board", "eeprom", "read", *EEPROM, "--address", "0x57", code=3)
    assert "does not answer" in nobody, nobody
    return f"{content(BUS / 'name')}, driver {(BUS.resolve().parent / 'driver').resolve().name}; {nobody.strip()}"


@check
def thermometer() -> str:
    """Thermometer: put on the bus by our overlay, its file there, as the board's file says"""
    (name,) = (path for path in Path("/sys/class/hwmon").glob("*/name") if content(path) == "tmp105")
    path = name.with_name("temp1_input")
    text = (BOARD / "board.toml").read_text()
    (BOARD / "board.toml").write_text(re.sub(r"/sys/class/hwmon/hwmon\d+/temp1_input", str(path), text))
    assert int.from_bytes((BUS.resolve().parent / "of_node/clock-frequency").read_bytes()) == 100_000
    assert content(path) == str(MILLI_CELSIUS), content(path)
    return str(path)


@check
def doctor() -> str:
    """Doctor: the board's file, GPIO, I2C, clock and store are well"""
    Path("/run/store").mkdir()
    printed = subprocess.run(
        [*RUFFINID, "--doctor", "--json"], capture_output=True, text=True, timeout=120, check=False
    )
    report = {c["name"]: c for c in json.loads(printed.stdout)["checks"]}
    for name in ("board", "gpio", "i2c", "clock", "store", "frames"):
        assert report[name]["state"] == "ok", report[name]
    return ", ".join(f"{c['name']} {c['state']}" for c in report.values())


@check
def daemon() -> str:
    """ruffinid reads both EEPROMs and the thermometer, and has lamps and reflex at the header's pins"""
    log = Path("/run/ruffinid.log")
    with log.open("w") as out, subprocess.Popen(RUFFINID, stdout=out, stderr=out) as process:
        try:
            seconds = until("the line", lambda: "link: " in log.read_text() or process.poll() is not None, 200)
            assert process.poll() is None, log.read_text()
            port = log.read_text().split("link: ")[1].split()[0]
            facts = json.loads(tool("--port", port, "--quiet", "info", "--json"))
            assert facts["serial"] == "PI-0001", facts
            celsius = temperature(port)
            assert Path("/run/store/gel-G-7").is_dir()
            lines = content("/sys/kernel/debug/gpio")
            for pin, level in (("GPIO17", "hi"), ("GPIO27", "(lo|hi)")):
                assert re.search(rf"\({pin} +\|ruffinid[^)]*\) out +{level}", lines), lines
        finally:
            process.terminate()
            process.wait(60)
    return f"link after {seconds:.1f} s; serial {facts['serial']}, gel G-7, {celsius} thousandths of a degree"


def temperature(port: str) -> int:
    from ruffini.device import Connection

    with Connection(port) as sensor:
        until("a temperature", lambda: len(sensor.status().temperatures) == 1, 60)
        (found,) = sensor.status().temperatures
    assert (found.place, found.milli_celsius) == ("gel", MILLI_CELSIUS)
    return int(found.milli_celsius)


@check
def nobody() -> str:
    """Nobody at the gel's address: ruffinid does not start, and says where it looked"""
    text = (BOARD / "board.toml").read_text()
    (BOARD / "board.toml").write_text(text.replace("gel_address = 0x51", "gel_address = 0x57"))
    said = run(*RUFFINID, code=3, timeout=200)
    assert f"/dev/i2c-1, address 0x57: {NOBODY}" in said, said
    return said.strip()


def set_up() -> str:
    """The Pi's tree, bus and pins"""
    until("/dev/i2c-1", Path("/dev/i2c-1").exists)
    return content("/proc/device-tree/model").rstrip("\0")


if __name__ == "__main__":
    run_all(set_up)
