"""atheris: any bytes as what a device says, through the host's decoder, schema, node values and results.

A hostile device may make the host say InputError, and no more: no other exception, no memory beyond what one message
and one backlog may hold.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["ruffini.wire", "ruffini.device.results"]):
    from ruffini.device.results import RESULTS
    from ruffini.wire import Decoder, Schema, encode_message

from ruffini.errors import InputError

MAX_MEMORY_BYTES = 2 << 30  # of address space beyond what the start took
SCHEMA = Schema.own()
TYPES = sorted(SCHEMA.type_numbers.values())


def look_at(type_number: int, payload: bytes) -> None:
    """Decode one message, and what a program would read of it."""
    try:
        message = SCHEMA.decode(type_number, payload)
        name = SCHEMA.type_name(type_number)
        if message is not None and name in RESULTS:
            RESULTS[name].from_message(message)
        if name == "SCHEMA" and message is not None:
            Schema(message.file_descriptor_set)
    except InputError:
        pass


def one_input(data: bytes) -> None:
    """The first byte says how the rest reaches the host."""
    if not data:
        return
    how, rest = data[0], data[1:]
    if how == 0:  # bytes on the line
        stream = rest
    elif how < 128:  # a message in frames that are right
        stream = encode_message(TYPES[how % len(TYPES)], rest, sensor=0, sequence=how, flags=how & 6)
    else:  # as it is
        look_at(TYPES[how % len(TYPES)], rest)
        return
    decoder = Decoder()
    for start in range(0, len(stream), 1 + how):
        for frame in decoder.feed(stream[start : start + 1 + how]):
            look_at(frame.type, frame.payload)


def main() -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MAX_MEMORY_BYTES, resource.RLIM_INFINITY))
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
