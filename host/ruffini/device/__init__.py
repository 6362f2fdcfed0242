"""A sensor on a serial line."""

from ruffini.device.connection import Connection, connect
from ruffini.device.results import Field, Wrench

__all__ = ["Connection", "Field", "Wrench", "connect"]
