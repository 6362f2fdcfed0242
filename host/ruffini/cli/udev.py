"""ruffini udev: this computer's rules for sensors on USB."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit


def install(
    root: Annotated[Path, typer.Option("--root", help="Root of a system image.")] = Path("/"),
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done.")] = False,
    json_: JsonFlag = False,
) -> None:
    """Install the rules (as root): no sudo for sensors, no ModemManager, a link by serial number."""
    from ruffini.device import udev

    steps = udev.install(root, is_dry_run=dry_run)
    emit({"steps": steps, "dry_run": dry_run}, json_,
         "\n".join(steps) or f"{udev.NAME} is installed already")  # fmt: skip


def show(json_: JsonFlag = False) -> None:
    """Print the rules."""
    from ruffini.device import udev

    found = udev.installed()
    emit({"name": udev.NAME, "rules": udev.rules(), "installed": str(found.path) if found else None}, json_,
         udev.rules().rstrip())  # fmt: skip
