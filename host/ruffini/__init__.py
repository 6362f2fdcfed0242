"""ruffini: newtons from a camera that looks at a soft pad.

>>> import ruffini
>>> with ruffini.connect() as sensor:  # doctest: +SKIP
...     for frame in sensor.frames():
...         print(frame.wrench.force, frame.flags)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ruffini.version import __version__

if TYPE_CHECKING:
    from ruffini.api import (
        AsyncSensor,
        FrameGroup,
        Sensor,
        SensorFrame,
        connect,
        connect_async,
        synchronized,
        synchronized_async,
    )
    from ruffini.live.unit import local_camera
    from ruffini.record import Recording

__all__ = [
    "AsyncSensor",
    "FrameGroup",
    "Recording",
    "Sensor",
    "SensorFrame",
    "__version__",
    "connect",
    "connect_async",
    "local_camera",
    "synchronized",
    "synchronized_async",
]
HOMES = {"Recording": "ruffini.record", "local_camera": "ruffini.live.unit"}  # of all others: ruffini.api


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    """The API, when it is first asked for: `ruffini --help` needs none of it."""
    if name in __all__:
        return getattr(importlib.import_module(HOMES.get(name, "ruffini.api")), name)
    raise AttributeError(f"module 'ruffini' has no attribute {name!r}")
