"""Where the compiled library and the compiled schema are."""

from __future__ import annotations

import os
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
