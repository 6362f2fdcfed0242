"""The units as systemd reads them: no unknown setting, exposure at most 1.0."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[2] / "firmware" / "deploy"
UNITS = ["ruffinid.service", "ruffini-gadget.service"]
MAX_EXPOSURE = 1.0


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, check=False)


def exposure(unit: Path) -> float:
    printed = analyze("security", "--offline=true", "--no-pager", str(unit)).stdout
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", printed)
    assert found, printed
    return float(found[1])


def unit_with_programs(tmp_path: Path, name: str, extra: str = "") -> Path:
    """The unit with a program that is on this machine: systemd looks whether it is there."""
    text = re.sub(r"^(Exec\w+=)\S+", r"\g<1>/bin/true", (DEPLOY / name).read_text(), flags=re.M)
    path = tmp_path / name
    path.write_text(text.replace("[Service]\n", f"[Service]\n{extra}"))
    return path


@pytest.mark.parametrize("name", UNITS)
def test_systemd_knows_every_setting(name, tmp_path):
    checked = analyze("verify", "--man=no", str(unit_with_programs(tmp_path, name)))
    assert name not in checked.stderr


def test_a_misspelt_setting_is_seen(tmp_path):
    checked = analyze("verify", "--man=no", str(unit_with_programs(tmp_path, UNITS[0], "WatchdogSecs=2\n")))
    assert "WatchdogSecs" in checked.stderr


def test_exposure(capsys):
    measured = exposure(DEPLOY / UNITS[0])
    with capsys.disabled():
        print(f"\nexposure of {UNITS[0]}: {measured}")
    assert measured <= MAX_EXPOSURE


def test_a_second_pads_service_has_places_of_its_own(tmp_path):
    """The README's edit of the unit: its own settings, store and serial number; systemd knows all of it."""
    edit = re.search(r"sudo sed -i '(.*?)' /etc/systemd", (DEPLOY / "README.md").read_text(), re.S)
    assert edit
    unit = unit_with_programs(tmp_path, UNITS[0])
    first = unit.read_text()
    subprocess.run(["sed", "-i", edit[1], str(unit)], check=True)
    second = unit.read_text()
    assert "EnvironmentFile=/etc/ruffini/second.env" in second
    assert "identity.env" not in second
    assert "StateDirectory=ruffini-second\n" in second
    n_stores = first.count("/var/lib/ruffini")
    assert n_stores == second.count("/var/lib/ruffini-second") == 2
    assert UNITS[0] not in analyze("verify", "--man=no", str(unit)).stderr


def test_a_weaker_sandbox_is_seen(tmp_path):
    weaker = tmp_path / UNITS[0]
    weaker.write_text((DEPLOY / UNITS[0]).read_text().replace("CapabilityBoundingSet=\n", ""))
    assert exposure(weaker) > MAX_EXPOSURE


def test_the_service_may_open_what_the_rules_give():
    """Each device class of the udev rules is in the service's list, and the other way round."""
    rules = (DEPLOY / "60-ruffinid.rules").read_text()
    allowed = set(re.findall(r"^DeviceAllow=(\S+) rw", (DEPLOY / UNITS[0]).read_text(), re.M))
    given = {
        "gpiochip": "char-gpiochip",
        "i2c-dev": "char-i2c",
        "dma_heap": "char-dma_heap",
        "udmabuf": "/dev/udmabuf",
        "ttyGS": "char-ttyGS",
    }
    assert all(word in rules for word in given)
    assert allowed == {*given.values(), "char-video4linux", "char-media"}  # these two are the group video's anyway
