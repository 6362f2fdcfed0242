"""A sensor on a serial line."""

from ruffini.device.connection import Connection, connect
from ruffini.device.results import Contacts, Field, Wrench

__all__ = ["Connection", "Contacts", "Field", "Wrench", "connect"]
