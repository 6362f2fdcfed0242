"""ruffini doctor on a folder that stands for /: each fault is found, with its remedy."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ruffini.device import doctor, udev
from ruffini.errors import NoDeviceError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "etc/udev").mkdir(parents=True)
    (tmp_path / "proc/42").mkdir(parents=True)
    (tmp_path / "proc/42/comm").write_text("bash\n")
    udev.install(tmp_path)
    return tmp_path


@pytest.fixture
def port(tmp_path: Path) -> str:
    path = tmp_path / "ttyACM0"
    path.write_text("")
    return str(path)


def by_name(checks: list[doctor.Check]) -> dict[str, doctor.Check]:
    return {check.name: check for check in checks}


def meet(port: str) -> str:
    return f"{port}: A-0042, softpad"


def test_all_is_well(root, port):
    checks = doctor.examine([port], root=root, meet=meet)
    assert [c.name for c in checks] == ["library", "udev rules", "ModemManager", "port", "sensor"]
    assert all(c.state == "ok" and c.remedy == "" for c in checks)
    assert "A-0042" in checks[-1].found


def test_missing_rules(root, port):
    (root / "etc/udev/rules.d/70-ruffini.rules").unlink()
    check = by_name(doctor.examine([port], root=root, meet=meet))["udev rules"]
    assert (check.state, check.remedy) == ("failed", "sudo ruffini udev install")


def test_rules_of_another_version(root, port):
    (root / "etc/udev/rules.d/70-ruffini.rules").write_text("old")
    assert by_name(doctor.examine([port], root=root, meet=meet))["udev rules"].state == "warning"


def test_modem_manager(root, port):
    (root / "proc/42/comm").write_text("ModemManager\n")
    assert by_name(doctor.examine([port], root=root, meet=meet))["ModemManager"].state == "ok"
    (root / "etc/udev/rules.d/70-ruffini.rules").unlink()
    assert by_name(doctor.examine([port], root=root, meet=meet))["ModemManager"].state == "failed"


def test_no_sensor(root):
    check = doctor.examine([], root=root, meet=meet)[-1]
    assert (check.name, check.state) == ("sensor", "failed")
    assert "cable" in check.remedy


def test_port_that_is_gone(root, tmp_path):
    assert doctor.examine([str(tmp_path / "gone")], root=root, meet=meet)[-1].found.endswith("is missing")


def test_port_that_may_not_be_opened(root, port, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    check = doctor.examine([port], root=root, meet=meet)[-1]
    assert (check.name, check.state) == ("port", "failed")
    assert "udev install" in check.remedy
    assert "dialout" in check.remedy


def test_sensor_that_does_not_answer(root, port):
    def silence(port: str) -> str:
        raise NoDeviceError(f"{port} does not answer")

    check = doctor.examine([port], root=root, meet=silence)[-1]
    assert (check.name, check.state) == ("sensor", "failed")
    assert "does not answer" in check.found
