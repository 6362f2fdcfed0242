"""How much longer than usual the host waits for devices, on a computer that is far too busy."""

from __future__ import annotations

import os

MOST = 1e3


def _patience() -> float:
    """RUFFINI_PATIENCE, 1 or more: a factor on waits for answers and frames; never on how fast a bench stops."""
    try:
        told = float(os.environ.get("RUFFINI_PATIENCE", "1"))
    except ValueError:
        return 1.0
    return told if 1 <= told <= MOST else 1.0


PATIENCE = _patience()
