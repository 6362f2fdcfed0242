"""ruffini udev: the rules file is written whole, once, and where udev reads it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from ruffini.device import udev


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "etc/udev").mkdir(parents=True)
    return tmp_path


def target(root: Path) -> Path:
    return root / "etc/udev/rules.d/70-ruffini.rules"


def test_installed_file_is_the_packages(root):
    assert udev.install(root) == [f"write {target(root)}"]
    assert target(root).read_text() == udev.rules()
    assert target(root).stat().st_mode & 0o777 == 0o644
    assert udev.install(root) == []


def test_dry_run_writes_nothing(root):
    steps = udev.install(root, is_dry_run=True)
    assert steps[0] == f"write {target(root)}"
    assert "udevadm control --reload" in steps
    assert not target(root).exists()


def test_another_version_is_replaced(root):
    target(root).parent.mkdir()
    target(root).write_text("old")
    assert udev.installed(root) == udev.Installed(target(root), False)
    udev.install(root)
    assert udev.installed(root) == udev.Installed(target(root), True)


def test_the_packages_own_rules_are_enough(root):
    packaged = root / "usr/lib/udev/rules.d/70-ruffini.rules"
    packaged.parent.mkdir(parents=True)
    packaged.write_text(udev.rules())
    assert udev.install(root) == []
    assert not target(root).exists()


def test_every_line_is_a_rule_that_udev_knows():
    """uaccess must come before 73-seat-late.rules, and a rule may match and set only what udev has."""
    assert int(udev.NAME[:2]) < 73
    known = {"ACTION", "GOTO", "LABEL", "SUBSYSTEM", "SUBSYSTEMS", "TAG", "SYMLINK", "ENV", "ATTR", "ATTRS"}
    for line in udev.rules().splitlines():
        if line.startswith("#"):
            continue
        for part in line.split(", "):
            key = part.split("=")[0].rstrip("+").split("{")[0]
            assert key in known, part
            assert part.endswith('"'), part


@pytest.mark.skipif(
    "verify" not in subprocess.run(["udevadm", "--help"], capture_output=True, text=True, check=False).stdout
    if Path("/usr/bin/udevadm").exists() or Path("/bin/udevadm").exists()
    else True,
    reason="udevadm of this Debian cannot verify rules",
)
def test_udev_itself_takes_the_rules(root):
    udev.install(root)
    subprocess.run(["udevadm", "verify", str(target(root))], check=True)
