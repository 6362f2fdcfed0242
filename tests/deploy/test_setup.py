"""`.ci/setup` on systems that are made up: what it installs follows from what is there and what apt offers."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEBIAN = 'ID=debian\nVERSION_ID="13"\nPRETTY_NAME="Debian GNU/Linux 13 (trixie)"\n'
UBUNTU = 'ID=ubuntu\nVERSION_ID="24.04"\nPRETTY_NAME="Ubuntu 24.04 LTS"\n'
FAKES = {
    "apt-cache": 'grep -qx "$2" "$FAKE/offered"',
    "apt-get": 'echo "$*" >> "$FAKE/log"',
    "dpkg-query": 'grep -qx "${@: -1}" "$FAKE/installed" && echo installed',
    "id": "echo 0",
}
STAMP = "cat host/pyproject.toml .ci/setup <(pwd) | sha256sum > .venv/.stamp"  # as after make_environment


class Machine:
    """A checkout with a made environment, and commands that act as apt's and dpkg's from lists in files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT / ".ci" / "apt", folder / ".ci" / "apt")
        shutil.copy(ROOT / ".ci" / "setup", folder / ".ci")
        (folder / "host").mkdir()
        shutil.copy(ROOT / "host" / "pyproject.toml", folder / "host")
        (folder / ".venv").mkdir()
        subprocess.run(["bash", "-c", STAMP], cwd=folder, check=True)
        (folder / "bin").mkdir()
        for name, body in FAKES.items():
            command = folder / "bin" / name
            command.write_text(f"#!/usr/bin/env bash\n{body}\n")
            command.chmod(0o755)
        self.list("offered", [])
        self.list("installed", [])

    def list(self, name: str, packages: list[str]) -> None:
        (self.folder / name).write_text("".join(f"{package}\n" for package in packages))

    def wanted(self) -> list[str]:
        lines = (self.folder / ".ci/apt/build.txt").read_text().splitlines()
        return [line for line in lines if line and not line.startswith("#")]

    def setup(self, release: str) -> subprocess.CompletedProcess[str]:
        (self.folder / "os-release").write_text(release)
        environment = {
            "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}", "FAKE": str(self.folder),
            "RUFFINI_OS_RELEASE": str(self.folder / "os-release"),
        }  # fmt: skip
        return subprocess.run(
            [".ci/setup"], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )

    @property
    def log(self) -> str:
        path = self.folder / "log"
        return path.read_text() if path.exists() else ""


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_what_is_installed_needs_neither_root_nor_network(machine: Machine) -> None:
    machine.list("installed", machine.wanted())
    done = machine.setup(DEBIAN)
    assert (done.returncode, done.stderr, machine.log) == (0, "", "")


def test_ubuntu_gets_the_same_names_and_is_said_to_be_untried(machine: Machine) -> None:
    machine.list("offered", machine.wanted())
    machine.list("installed", [name for name in machine.wanted() if name != "libfmt-dev"])
    done = machine.setup(UBUNTU)
    assert done.returncode == 0, done.stderr
    assert "Ubuntu 24.04 LTS is untried" in done.stderr
    assert machine.log.splitlines() == ["update -qq", "install -y -qq --no-install-recommends libfmt-dev"]


def test_the_first_name_that_apt_offers_is_taken(machine: Machine) -> None:
    with (machine.folder / ".ci/apt/build.txt").open("a") as names:
        names.write("libnew-dev|libold-dev\nlibother-dev|libthere-dev\n")
    machine.list("installed", [*machine.wanted()[:-2], "libthere-dev"])
    machine.list("offered", ["libold-dev", "libother-dev"])
    done = machine.setup(DEBIAN)
    assert done.returncode == 0, done.stderr
    assert machine.log.splitlines()[1:] == ["install -y -qq --no-install-recommends libold-dev"]


def test_what_apt_does_not_offer_is_named(machine: Machine) -> None:
    machine.list("installed", [name for name in machine.wanted() if name not in ("libfmt-dev", "libsimde-dev")])
    machine.list("offered", ["libfmt-dev"])
    done = machine.setup(UBUNTU)
    assert done.returncode == 2
    assert "apt on Ubuntu 24.04 LTS offers no libsimde-dev: on Ubuntu add its universe" in done.stderr
    assert "install" not in machine.log.split("update -qq")[1]
