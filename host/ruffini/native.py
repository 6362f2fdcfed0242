"""Where the compiled library and the compiled schema are, and the library itself."""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path

from ruffini.errors import RuffiniError


def native_folder() -> Path:
    """Where libruffini and the schema are: RUFFINI_NATIVE_DIR, the package, or the build tree."""
    here = Path(__file__).resolve()
    candidates = [Path(p) for p in (os.environ.get("RUFFINI_NATIVE_DIR"),) if p]
    candidates += [here.parent / "_native", here.parents[2] / "build" / "native"]
    for folder in candidates:
        if (folder / "libruffini.so").is_file():
            return folder
    raise RuffiniError("libruffini.so was not found: run `make build`, or set RUFFINI_NATIVE_DIR to its folder")


@cache
def library() -> ctypes.CDLL:
    """libruffini, loaded at its first use; its functions: firmware/capi/ruffini_core.h.

    Raises
    ------
    RuffiniError
        It is missing, made for another machine, or older than this package.
    """
    path = native_folder() / "libruffini.so"
    try:
        loaded = ctypes.CDLL(str(path))
        for name in ("error", "version", "board_json", "stage_name", "stage_writes"):
            getattr(loaded, f"ruffini_{name}").restype = ctypes.c_char_p
        loaded.ruffini_open.restype = loaded.ruffini_wrench_open.restype = ctypes.c_void_p
    except (OSError, AttributeError) as error:
        raise RuffiniError(f"{path} cannot be used on this machine: {error}: run `make build`") from error
    return loaded


@cache
def stage_slots() -> dict[str, frozenset[str]]:
    """The stages that a board may list, in their order, and the slots that each writes."""
    core = library()
    return {
        core.ruffini_stage_name(i).decode(): frozenset(core.ruffini_stage_writes(i).decode().split())
        for i in range(core.ruffini_stage_count())
    }
