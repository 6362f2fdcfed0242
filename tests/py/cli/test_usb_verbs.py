"""ruffini udev and ruffini doctor as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_board import Run

from ruffini.device import udev


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "etc/udev").mkdir(parents=True)
    return tmp_path


def test_install_and_show(run: Run, root: Path) -> None:
    code, out, err = run("udev", "install", "--root", root, "--dry-run", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["dry_run"] is True
    assert run("udev", "install", "--root", root)[0] == 0
    assert run("udev", "install", "--root", root)[1] == "70-ruffini.rules is installed already\n"
    assert run("udev", "show")[1] == udev.rules()


def test_a_computer_without_udev(run: Run, tmp_path: Path) -> None:
    code, _, err = run("udev", "install", "--root", tmp_path)
    assert code == 2
    assert "no udev" in err


def test_a_folder_that_cannot_be_written(run: Run, root: Path) -> None:
    (root / "etc/udev/rules.d").write_text("a file where the folder should be")
    code, _, err = run("udev", "install", "--root", root)
    assert code == 2
    assert "sudo" in err


def test_doctor_fails_with_one_of_its_checks(run: Run, tmp_path: Path) -> None:
    code, out, _ = run("--port", tmp_path / "gone", "doctor", "--json")
    report = json.loads(out)
    assert code == 1
    assert report["ok"] is False
    assert {c["name"] for c in report["checks"]} >= {"library", "udev rules", "port"}
    code, out, _ = run("--port", tmp_path / "gone", "doctor")
    assert code == 1
    assert f"failed  port: {tmp_path / 'gone'} is missing\n    plug" in out
