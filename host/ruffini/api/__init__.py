"""What programs import as `ruffini`: sensors, frames, several of them together."""

from ruffini.api.frame import SensorFrame
from ruffini.api.in_asyncio import AsyncSensor, connect_async
from ruffini.api.sensor import Sensor, connect
from ruffini.api.together import FrameGroup, synchronized, synchronized_async

__all__ = [
    "AsyncSensor",
    "FrameGroup",
    "Sensor",
    "SensorFrame",
    "connect",
    "connect_async",
    "synchronized",
    "synchronized_async",
]
