"""ruffini-gadget on a folder that stands for /sys."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "firmware" / "deploy" / "ruffini-gadget"


class FakeSys:
    def __init__(self, root: Path) -> None:
        self.sys, self.run_folder = root / "sys", root / "run"
        self.udc = self.sys / "class" / "udc" / "fe980000.usb"
        self.udc.mkdir(parents=True)
        (self.udc / "function").write_text("")
        (self.udc / "state").write_text("configured\n")
        self.gadgets = self.sys / "kernel" / "config" / "usb_gadget"
        self.gadgets.mkdir(parents=True)
        self.gadget = self.gadgets / "ruffini"
        self.environment = {"BOARD": "softpad", "SERIAL": "A-0042"}

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        places = {"RUFFINI_SYS": str(self.sys), "RUFFINI_RUN": str(self.run_folder), "PATH": os.environ["PATH"]}
        return subprocess.run([SCRIPT, *arguments], capture_output=True, text=True, check=False,
                              env=places | self.environment)  # fmt: skip

    def content(self, name: str) -> str:
        return (self.gadget / name).read_text().strip()

    def files(self) -> dict[str, tuple[int, str]]:
        return {str(p): (p.stat().st_mtime_ns, p.read_text()) for p in self.sys.rglob("*") if p.is_file()}


@pytest.fixture
def fake(tmp_path) -> FakeSys:
    return FakeSys(tmp_path)


def test_up_describes_one_serial_line(fake):
    done = fake.run("up")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert fake.content("strings/0x409/manufacturer") == "ruffini"
    assert fake.content("strings/0x409/product") == "ruffini softpad"
    assert fake.content("strings/0x409/serialnumber") == "A-0042"
    assert (fake.content("idVendor"), fake.content("idProduct")) == ("0x1d6b", "0x0104")
    assert (fake.gadget / "configs/c.1/acm.usb0").resolve() == (fake.gadget / "functions/acm.usb0").resolve()
    assert fake.content("UDC") == "fe980000.usb"
    assert (fake.run_folder / "identity.env").read_text() == "SERIAL=A-0042\n"


def test_two_pads_are_two_lines_and_one_again_is_one(fake):
    fake.environment["PADS"] = "2"
    assert fake.run("up").returncode == 0
    lines = [fake.gadget / "configs/c.1" / name for name in ("acm.usb0", "acm.usb1")]
    assert [line.resolve().name for line in lines] == ["acm.usb0", "acm.usb1"]
    assert all((fake.gadget / "functions" / line.name).is_dir() for line in lines)
    before = fake.files()
    assert fake.run("up").returncode == 0
    assert fake.files() == before
    fake.environment["PADS"] = "1"
    assert fake.run("up").returncode == 0
    assert [line.exists() for line in lines] == [True, False]
    assert fake.content("UDC") == "fe980000.usb"
    fake.environment["PADS"] = "3"
    assert fake.run("up").returncode == 2


def test_up_again_writes_nothing(fake):
    fake.run("up")
    before = fake.files()
    assert fake.run("up").returncode == 0
    assert fake.files() == before


def test_up_goes_on_where_it_was_cut_short(fake):
    (fake.gadget / "strings/0x409").mkdir(parents=True)
    (fake.gadget / "strings/0x409/manufacturer").write_text("")
    assert fake.run("up").returncode == 0
    assert fake.content("UDC") == "fe980000.usb"


def test_a_new_serial_number_takes_the_gadget_down_first(fake):
    fake.run("up")
    fake.environment["SERIAL"] = "B-1"
    planned = fake.run("up", "--dry-run").stdout.splitlines()
    assert planned[0] == f"echo '' > {fake.gadget}/UDC"
    assert f"echo 'B-1' > {fake.gadget}/strings/0x409/serialnumber" in planned
    assert fake.run("up").returncode == 0
    assert fake.content("strings/0x409/serialnumber") == "B-1"
    assert fake.content("UDC") == "fe980000.usb"


def test_dry_run_changes_nothing_and_says_all(fake):
    before = fake.files()
    planned = fake.run("up", "--dry-run")
    assert planned.returncode == 0
    assert fake.files() == before
    assert not fake.gadget.exists()
    assert not fake.run_folder.exists()
    assert f"ln -s {fake.gadget}/functions/acm.usb0 {fake.gadget}/configs/c.1/acm.usb0" in planned.stdout
    assert f"echo 'fe980000.usb' > {fake.gadget}/UDC" in planned.stdout


def test_serial_number_of_the_computer(fake):
    fake.environment["SERIAL"] = ""
    tree = fake.sys / "firmware/devicetree/base"
    tree.mkdir(parents=True)
    (tree / "serial-number").write_bytes(b"10000000abcdef01\0")
    assert fake.run("up").returncode == 0
    assert fake.content("strings/0x409/serialnumber") == "10000000abcdef01"


def test_down_frees_the_port_and_up_takes_it_again(fake):
    fake.run("up")
    assert fake.run("down").returncode == 0
    assert fake.content("UDC") == ""
    assert fake.run("status").returncode == 3
    assert fake.run("up").returncode == 0
    status = fake.run("status")
    assert status.returncode == 0
    assert status.stdout == "ruffini softpad, serial A-0042, on fe980000.usb: configured\n"


def test_down_without_a_gadget(fake):
    assert fake.run("down").returncode == 0
    assert not fake.gadget.exists()


def other_gadget(fake: FakeSys) -> None:
    (fake.gadgets / "g1").mkdir()
    (fake.gadgets / "g1" / "UDC").write_text("fe980000.usb\n")


def network_gadget(fake: FakeSys) -> None:
    (fake.udc / "function").write_text("g_ether\n")


def unknown_gadget(fake: FakeSys) -> None:
    (fake.udc / "function").write_text("g_mass_storage\n")


def no_controller(fake: FakeSys) -> None:
    for file in fake.udc.iterdir():
        file.unlink()
    fake.udc.rmdir()


def no_serial(fake: FakeSys) -> None:
    fake.environment["SERIAL"] = ""


def odd_serial(fake: FakeSys) -> None:
    fake.environment["SERIAL"] = "a b/../c"


def long_serial(fake: FakeSys) -> None:
    fake.environment["SERIAL"] = "x" * 24


def no_gadget_support(fake: FakeSys) -> None:
    fake.gadgets.rmdir()


@pytest.mark.parametrize(
    ("spoil", "code", "words"),
    [
        (other_gadget, 4, ["usb_gadget/g1 has fe980000.usb", "echo ''"]),
        (network_gadget, 4, ["g_ether has fe980000.usb", "rpi-usb-gadget off"]),
        (unknown_gadget, 4, ["g_mass_storage", "modprobe -r g_mass_storage"]),
        (no_controller, 3, ["class/udc is empty", "dtoverlay=dwc2,dr_mode=peripheral"]),
        (no_serial, 2, ["no serial number", "ruffinid.env"]),
        (odd_serial, 2, ["SERIAL='a b/../c'", "letters"]),
        (long_serial, 2, ["at most 23"]),
        (no_gadget_support, 3, ["usb_gadget is missing", "libcomposite"]),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_is_in_the_way_is_said(fake, spoil, code, words):
    spoil(fake)
    done = fake.run("up")
    assert done.returncode == code
    assert done.stderr.startswith("ruffini-gadget: ")
    assert done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in words), done.stderr
    assert not fake.gadget.exists()


@pytest.mark.parametrize("arguments", [(), ("sideways",), ("up", "--force")])
def test_usage(fake, arguments):
    assert fake.run(*arguments).returncode == 2
