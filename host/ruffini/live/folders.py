"""Folders of a unit below XDG_STATE_HOME."""

from __future__ import annotations

import os
import re
from pathlib import Path

CALIBRATIONS = "calibrations"


def unit_folder(kind: str, board: str, unit: str) -> Path:
    """One folder for each board and unit, whose names may be a device's and lead nowhere else."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    names = [re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "unnamed" for name in (board, unit)]
    return state.joinpath("ruffini", kind, *names)
