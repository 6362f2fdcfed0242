"""The device-tree overlay, compiled and put on a tree that has what it refers to."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from ruffini.boards import parse_board

ROOT = Path(__file__).parents[2]
OVERLAY = ROOT / "firmware" / "deploy" / "overlays" / "ruffini-pi.dts"
# The part of a Raspberry Pi's tree that the overlay changes, with its names.
BASE = """/dts-v1/;
/ { compatible = "raspberrypi,model-zero-2-w", "brcm,bcm2837";
    soc { #address-cells = <1>; #size-cells = <1>;
        i2c1: i2c@7e804000 { compatible = "brcm,bcm2835-i2c"; reg = <0x7e804000 0x1000>; #address-cells = <1>;
                             #size-cells = <0>; status = "disabled"; clock-frequency = <400000>; }; }; };
"""
BUS = "/soc/i2c@7e804000"


def run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def compile_tree(source: Path, out: Path) -> Path:
    done = subprocess.run(
        ["dtc", "-@", "-I", "dts", "-O", "dtb", "-o", str(out), str(source)], capture_output=True, text=True, check=True
    )
    assert done.stderr == "", "dtc warns"
    return out


@pytest.fixture
def base(tmp_path: Path) -> Path:
    assert shutil.which("dtc"), "device-tree-compiler is not installed (make setup)"
    (tmp_path / "base.dts").write_text(BASE)
    return compile_tree(tmp_path / "base.dts", tmp_path / "base.dtb")


def test_the_overlay_puts_the_thermometer_on_the_bus(base: Path, tmp_path: Path) -> None:
    assert run("fdtget", str(base), BUS, "status") == "disabled"
    overlay = compile_tree(OVERLAY, tmp_path / "ruffini-pi.dtbo")
    both = str(tmp_path / "both.dtb")
    run("fdtoverlay", "-i", str(base), "-o", both, str(overlay))
    assert run("fdtget", both, BUS, "status") == "okay"
    assert run("fdtget", "-t", "u", both, BUS, "clock-frequency") == "100000"
    assert run("fdtget", both, f"{BUS}/thermometer@48", "compatible") == "ti,tmp102"
    assert run("fdtget", "-t", "x", both, f"{BUS}/thermometer@48", "reg") == "48"
    assert run("fdtget", "-l", both, BUS) == "thermometer@48", "a driver on an EEPROM keeps ruffinid out"
    assert run("fdtget", both, "/", "compatible").split()[0] == "raspberrypi,model-zero-2-w", (
        "the board's own name stays"
    )


def test_a_tree_without_the_bus_refuses_it(base: Path, tmp_path: Path) -> None:
    (tmp_path / "bare.dts").write_text(BASE.replace("i2c1: ", ""))
    bare = compile_tree(tmp_path / "bare.dts", tmp_path / "bare.dtb")
    overlay = compile_tree(OVERLAY, tmp_path / "ruffini-pi.dtbo")
    done = subprocess.run(
        ["fdtoverlay", "-i", str(bare), "-o", str(tmp_path / "x.dtb"), str(overlay)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0


def test_the_wiring_of_the_readme_is_a_board_on_the_overlays_bus_and_pins() -> None:
    text = (ROOT / "boards" / "README.md").read_text().split("## Wiring one")[1].split("\n## ")[0]
    config = re.findall(r"^```ini\n(.*?)```", text, re.M | re.S)[0]
    toml = re.findall(r"^```toml\n(.*?)```", text, re.M | re.S)[0]
    board = parse_board((ROOT / "tests" / "data" / "boards" / "base.toml").read_text() + "\n" + toml, "README")
    assert board.light is not None
    assert board.reflex is not None
    assert board.eeprom is not None
    pins = re.search(r"^gpio=([\d,]+)=op,dl$", config, re.M)
    assert pins, "the lines are not off before ruffinid starts"
    assert {board.light.line, board.reflex.line} == {f"GPIO{n}" for n in pins[1].split(",")}
    assert f"dtoverlay={OVERLAY.stem}\n" in config
    assert {board.eeprom.board_address, board.eeprom.gel_address} == {0x50, 0x51}, "where the overlay has no driver"
