"""What it costs to read a FIELD of 1,209 nodes: from the line to typed results, in C++, Python, the page.

The peer is Protocol Buffers itself (upb, C) on the same force, displacement and sigma as packed `sint32`, as it would
be without our packing: parsing alone, and parsing with the numbers as numpy arrays; no framing, no CRC. The API is
`ruffini.SensorFrame` with force, displacement, slip and sigma read, beside a
WRENCH. `noisy`: every node has some force; `dead zone`: one contact.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from ruffini.api.frame import Assembler
from ruffini.device.results import Field
from ruffini.wire import Decoder, Schema, encode_message
from ruffini.wire.dense import encode_dense

PAGE = Path(__file__).with_name("page_decode.mjs")
N_X, N_Y, N_RUNS = 39, 31, 1000
Values = npt.NDArray[np.int32]


def make_values(is_noisy: bool) -> tuple[Values, Values, Values]:
    """Force, displacement and sigma, (nodes, 3) each."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:N_Y, :N_X]
    inside = np.maximum(1 - ((x - 15) ** 2 + (y - 12) ** 2) / 36, 0).ravel()
    force = np.round(inside[:, None] * [60, -40, -500]).astype(np.int32)
    noise = rng.normal(0, 5, force.shape)
    force += np.round(noise if is_noisy else noise * (inside > 0)[:, None]).astype(np.int32)
    moved = np.round(force * 90 + rng.normal(0, 300, force.shape)).astype(np.int32)
    return force, moved, np.full(force.shape, 12, np.int32)


def field_message(schema: Schema, values: tuple[Values, Values, Values]) -> bytes:
    """A serialised FIELD."""

    def dense(part: Values) -> dict[str, Any]:
        codec, data = encode_dense(part, 3)
        return {"codec": codec, "n_x": N_X, "n_y": N_Y, "n_components": 3, "data": data}

    force, moved, sigma = map(dense, values)
    stamp = {"capture_us": 1_000_000, "frame": 60}
    message = schema.new("Field", stamp=stamp, force_lsb_un=20, force=force, displacement_lsb_nm=10, displacement=moved,
                         validity=[1, 1, 1], sigma=sigma, sigma_validity=1)  # fmt: skip
    return bytes(message.SerializeToString())


def peer_class() -> Any:
    """message Peer { repeated sint32 force = 1; repeated sint32 displacement = 2; repeated sint32 sigma = 3; }"""
    file = descriptor_pb2.FileDescriptorProto(name="peer.proto", package="peer", syntax="proto3")
    message = file.message_type.add(name="Peer")
    for i, name in enumerate(("force", "displacement", "sigma")):
        message.field.add(name=name, number=i + 1, type=17, label=3)  # repeated sint32
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("peer.Peer"))


def median_us(run: Callable[[], object]) -> float:
    """Of one run."""
    times = []
    for _ in range(N_RUNS):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return statistics.median(times) * 1e6


def python_reads(schema: Schema, data: bytes, number: int) -> None:
    """Line to typed result, as a host does."""
    (frame,) = Decoder().feed(data)
    assert frame.type == number
    Field.from_message(schema.decode(frame.type, frame.payload))


def api_reads(assembler: Assembler, schema: Schema, data: bytes) -> None:
    """Line to a frame of the API, all of its field read."""
    for packet in Decoder().feed(data):
        for frame in assembler.put(packet, schema.decode(packet.type, packet.payload)):
            assert frame.field is not None
            assert frame.field.force.size == 3 * N_X * N_Y


def frames_of(schema: Schema, field: bytes) -> Iterator[bytes]:
    """WRENCH and FIELD of one frame after the other, as they come over the line."""
    for number in itertools.count(1):
        stamp = {"capture_us": number, "frame": number}
        message = schema.new("Field")
        message.ParseFromString(field)
        message.stamp.CopyFrom(schema.new("Stamp", **stamp))
        wrench = schema.new("Wrench", stamp=stamp, force_z_un=-5, validity=[1] * 6)
        yield b"".join(
            encode_message(schema.type_numbers[name], m.SerializeToString(), sensor=0, sequence=number, flags=2)
            for name, m in (("WRENCH", wrench), ("FIELD", message))
        )


def as_arrays(message: Any) -> list[Values]:
    """The peer's numbers as numpy has them."""
    return [np.fromiter(part, np.int32, len(part)) for part in (message.force, message.displacement, message.sigma)]


def told_us(*command: str | Path) -> float:
    """What a program prints in nanoseconds."""
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout) / 1e3


def rows(build: Path) -> list[tuple[str, int, float, float, float, float, float, float]]:
    """(what, bytes on the line, then microseconds: C++, page, Python, API, peer, peer with arrays)."""
    schema, peer, out = Schema.own(), peer_class(), []
    number = schema.type_numbers["FIELD"]
    for what, is_noisy in (("noisy", True), ("dead zone", False)):
        values = make_values(is_noisy)
        data = encode_message(number, field_message(schema, values), sensor=0, sequence=0, flags=2)
        with tempfile.NamedTemporaryFile() as file:
            Path(file.name).write_bytes(data)
            cpp_us = told_us(build / "ruffini_client_decode", file.name, str(N_RUNS))
            page_us = told_us("node", PAGE, build / "native" / "ruffini.desc", file.name, str(N_RUNS))
        flat = [part.ravel().tolist() for part in values]
        theirs = peer(force=flat[0], displacement=flat[1], sigma=flat[2]).SerializeToString()
        python_us = median_us(lambda data=data: python_reads(schema, data, number))  # type: ignore[misc]
        peer_us = median_us(lambda theirs=theirs: peer.FromString(theirs))  # type: ignore[misc]
        arrays_us = median_us(lambda theirs=theirs: as_arrays(peer.FromString(theirs)))  # type: ignore[misc]
        assembler = Assembler(schema, "bench", {})
        stream = list(itertools.islice(frames_of(schema, field_message(schema, values)), N_RUNS))
        lines = iter(stream)
        api_us = median_us(lambda a=assembler, lines=lines: api_reads(a, schema, next(lines)))  # type: ignore[misc]
        out.append((what, len(data), cpp_us, page_us, python_us, api_us, peer_us, arrays_us))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, required=True)
    print(f"a FIELD of {N_X * N_Y} nodes with displacement and sigma, us to read it (medians)")
    print(f"{'':10} {'bytes':>6} {'C++':>7} {'page':>7} {'Python':>7} {'API':>7} {'API, 1/s':>9} "
          f"{'protobuf alone':>15} {'with numpy':>11} {'API : that':>11}")  # fmt: skip
    for what, n_bytes, cpp_us, page_us, python_us, api_us, peer_us, arrays_us in rows(parser.parse_args().build):
        print(f"{what:10} {n_bytes:6d} {cpp_us:7.1f} {page_us:7.1f} {python_us:7.1f} {api_us:7.1f} {1e6 / api_us:9.0f} "
              f"{peer_us:15.1f} {arrays_us:11.1f} {api_us / arrays_us:11.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
