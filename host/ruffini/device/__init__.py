"""A sensor on a serial line."""

from ruffini.device.choice import connect
from ruffini.device.connection import Connection
from ruffini.device.results import Contacts, Field, Learned, NetworkState, Wrench

__all__ = ["Connection", "Contacts", "Field", "Learned", "NetworkState", "Wrench", "connect"]
