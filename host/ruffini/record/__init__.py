"""Recordings of the stream as MCAP."""

from ruffini.record.mcap_file import record_stream

__all__ = ["record_stream"]
