"""The serial stream: frames, messages, node values. Byte for byte in proto/README.md."""

from ruffini.wire.framing import Decoder, Frame, encode_message
from ruffini.wire.messages import Schema

__all__ = ["Decoder", "Frame", "Schema", "encode_message"]
