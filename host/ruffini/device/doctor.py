"""Checks of everything this computer needs for a sensor on USB, each with its remedy.

The computer inside the sensor has its own checks: `ruffinid --doctor`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ruffini.device import udev
from ruffini.device.connection import Connection
from ruffini.device.ports import candidate_ports
from ruffini.errors import RuffiniError

State = Literal["ok", "warning", "failed"]


@dataclass(frozen=True)
class Check:
    """The result of one check, and the remedy if it failed."""

    name: str
    state: State
    found: str
    remedy: str = ""


def greet(port: str) -> str:
    """The serial number and boards of the device on a port. Raises RuffiniError if none answers."""
    with Connection(port) as sensor:
        boards = ", ".join(s.board for s in sensor.hello.sensors)
        return f"{port}: {sensor.serial_number}, {boards}"


def examine(
    ports: Iterable[str] | None = None,
    *,
    root: Path = Path("/"),
    meet: Callable[[str], str] = greet,
) -> list[Check]:
    """Check the library, the udev rules, ModemManager, and for each port its permission and the sensor on it.

    Parameters
    ----------
    ports : iterable of str, optional
        Serial ports to check; by default those whose USB description contains "ruffini".
    root : Path
        Replaces / in tests.
    meet : callable
        Returns the identity of the device on a port, or raises.
    """
    found = list(candidate_ports() if ports is None else ports)
    checks = [_library(), _rules(root), _modem_manager(root)]
    if not found:
        checks.append(Check("sensor", "failed", "none on USB",
                            "plug one in: its port in device mode, a cable that carries data"))  # fmt: skip
    for port in found:
        checks += _port(port, meet)
    return checks


def _library() -> Check:
    from ruffini.native import native_folder

    try:
        return Check("library", "ok", str(native_folder() / "libruffini.so"))
    except RuffiniError as error:
        return Check("library", "failed", str(error), "run `make build`, or install the package again")


def _rules(root: Path) -> Check:
    found = udev.installed(root)
    if found is None:
        return Check("udev rules", "failed", "not installed", "sudo ruffini udev install")
    if not found.is_ours:
        return Check("udev rules", "warning", f"{found.path} is of another version", "sudo ruffini udev install")
    return Check("udev rules", "ok", str(found.path))


def _modem_manager(root: Path) -> Check:
    names = []
    for comm in (root / "proc").glob("[0-9]*/comm"):
        try:
            names.append(comm.read_text().strip())
        except OSError:  # it has just ended
            continue
    if "ModemManager" not in names:
        return Check("ModemManager", "ok", "not running")
    if udev.installed(root) is not None:
        return Check("ModemManager", "ok", "running; the udev rules keep it off")
    return Check("ModemManager", "failed", "running: it sends AT commands to new serial ports",
                 "sudo ruffini udev install")  # fmt: skip


def _port(port: str, meet: Callable[[str], str]) -> list[Check]:
    if not Path(port).exists():
        return [Check("port", "failed", f"{port} is missing", "plug the sensor in, and see `ruffini devices`")]
    if not os.access(port, os.R_OK | os.W_OK):
        remedy = "sudo ruffini udev install, then plug it in again; by ssh: sudo usermod -aG dialout USER, log in again"
        return [Check("port", "failed", f"{port} may not be opened", remedy)]
    fine = Check("port", "ok", port)
    try:
        return [fine, Check("sensor", "ok", meet(port))]
    except RuffiniError as error:
        return [fine, Check("sensor", "failed", str(error), "is ruffinid running there? On it: sudo ruffini-doctor")]
