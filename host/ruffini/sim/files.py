"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from ruffini.errors import InputError


def write_whole(path: Path, data: bytes, *, remedy: str) -> None:
    """Write a file in one step; what was there and beside it before stays valid.

    Raises
    ------
    InputError
        It cannot be written; `remedy` is what to do then.
    """
    temporary = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(
            f"{path} cannot be written ({error.strerror}): the files before it are whole; {remedy}"
        ) from error
