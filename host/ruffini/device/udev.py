"""The udev rules of this computer: who may open a sensor, and the link /dev/ruffini/SERIAL to it."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from ruffini.errors import InputError
from ruffini.files import write_whole

NAME = "70-ruffini.rules"
RULES_FOLDERS = ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")  # the first one wins
# What makes udev read them, and apply them to what is plugged in already.
COMMANDS = (
    ["udevadm", "control", "--reload"],
    ["udevadm", "trigger", "--subsystem-match=usb", "--subsystem-match=tty"],
)


@dataclass(frozen=True)
class Installed:
    """The rules file that udev reads."""

    path: Path
    is_ours: bool  # the same bytes as this package's


def rules() -> str:
    """Text of the rules file."""
    return (resources.files("ruffini.device") / NAME).read_text()


def installed(root: Path = Path("/")) -> Installed | None:
    """The file that is in force, if there is one."""
    for folder in RULES_FOLDERS:
        path = root / folder / NAME
        if path.is_file():
            return Installed(path, path.read_text(errors="replace") == rules())
    return None


def install(root: Path = Path("/"), *, is_dry_run: bool = False) -> list[str]:
    """Write the rules and have udev read them.

    Returns
    -------
    list of str
        What was done, or would be; empty where the rules were there already.

    Raises
    ------
    InputError
        There is no udev on this computer, or its folder may not be written.
    """
    found = installed(root)
    if found is not None and found.is_ours:
        return []
    target = root / RULES_FOLDERS[0] / NAME
    if not target.parent.parent.is_dir():
        raise InputError(f"{target.parent.parent} is missing: this computer has no udev")
    steps = [f"write {target}", *(" ".join(command) for command in COMMANDS)]
    if is_dry_run:
        return steps
    remedy = "run it with sudo, or put the text of `ruffini udev show` there"
    write_whole(target, rules().encode(), remedy=remedy)
    target.chmod(0o644)  # udev reads it as root, people may look
    # Another root is an image that is being made: its udev is not this one.
    if root == Path("/") and shutil.which("udevadm"):
        for command in COMMANDS:
            subprocess.run(command, check=False, capture_output=True)
    else:
        steps = steps[:1]
    return steps
