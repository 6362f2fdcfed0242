"""What was in force on a sensor before it was flashed, as dated files on the host."""

from __future__ import annotations

import datetime
import hashlib
import os
import re
from pathlib import Path

from ruffini.errors import InputError
from ruffini.files import write_whole
from ruffini.older_python import UTC


def folder() -> Path:
    """Where they are kept unless another place is named."""
    return Path(os.environ.get("RUFFINI_BACKUPS") or Path.home() / ".local" / "share" / "ruffini" / "backups")


def keep(data: bytes, serial: str, into: Path) -> Path:
    """Write a calibration as SERIAL-TIME-HASH.safetensors; one that is there already is not written again.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    name = re.sub(r"[^A-Za-z0-9_-]", "_", serial)[:64] or "_"  # the device's word leads nowhere
    digest = hashlib.sha256(data).hexdigest()[:12]
    try:
        into.mkdir(parents=True, exist_ok=True)
        for there in sorted(into.glob(f"{name}-*-{digest}.safetensors")):
            if there.read_bytes() == data:
                return there
        now = datetime.datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        path = into / f"{name}-{now}-{digest}.safetensors"
        write_whole(path, data)
    except OSError as error:
        raise InputError(f"{into}: cannot be written: {error.strerror}: name another folder with --backup") from error
    return path
