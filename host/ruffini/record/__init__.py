"""Recordings of the stream as MCAP."""

from ruffini.record.mcap_file import record_stream
from ruffini.record.recording import Recording

__all__ = ["Recording", "record_stream"]
