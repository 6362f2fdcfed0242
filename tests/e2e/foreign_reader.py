"""A recording as programs read it that know no ruffini: by the schemas that are in the file, and nothing else."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory

from ruffini.record import Recording

RAW = "/ruffini/raw"
VALID, SPARSE, BLOCK = 1, 1, 32


def read(path: Path) -> dict[str, list[Any]]:
    """Decoded messages of every topic but the line's bytes, as the decoders of MCAP's own packages make them."""
    out: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[ProtobufFactory(), Ros2Factory()])
        summary = reader.get_summary()
        assert summary is not None
        topics = {channel.topic for channel in summary.channels.values()} - {RAW}
        for _, channel, _, message in reader.iter_decoded_messages(topics=sorted(topics)):
            out.setdefault(channel.topic, []).append(message)
    assert out.keys() == topics
    return out


def node_values(m: Any) -> npt.NDArray[np.int64]:
    """Of a Dense message as proto/README.md states it, value by value: (n_y, n_x, n_components)."""
    n_nodes, data = m.n_x * m.n_y, m.data
    active = list(range(n_nodes))
    if m.codec == SPARSE:
        active = [node for node in active if data[node // 8] >> node % 8 & 1]
        data = data[-(-n_nodes // 8) :]
    values: list[int] = []
    while len(values) < len(active) * m.n_components:
        width = data[0]
        bits = int.from_bytes(data[1 : 1 + 4 * width], "little")
        coded = [bits >> width * i & (1 << width) - 1 for i in range(BLOCK)]
        values += [c >> 1 ^ -(c & 1) for c in coded]
        data = data[1 + 4 * width :]
    out = np.zeros((n_nodes, m.n_components), np.int64)
    out[active] = np.reshape(values[: len(active) * m.n_components], (-1, m.n_components))
    return out.reshape(m.n_y, m.n_x, m.n_components)


def compare(path: Path) -> dict[str, int]:
    """Every message of a file of one sensor against ruffini's own reading of the line's bytes; how many, by topic."""
    recording, by_topic = Recording(path), read(path)
    by_frame = {
        topic: {m.stamp.frame: m for m in messages if hasattr(m, "stamp")} for topic, messages in by_topic.items()
    }
    counts: dict[str, int] = defaultdict(int)
    assert [MessageToDict(m) for m in by_topic["/ruffini/hello"]] == [MessageToDict(recording.hello)]
    for frame in recording.frames():
        for name, ours in frame.messages.items():
            theirs = by_frame[f"/ruffini/{name.lower()}"].get(frame.number)
            if theirs is None:  # the file begins or ends within this frame
                continue
            assert MessageToDict(theirs) == MessageToDict(ours), (name, frame.number)
            counts[f"/ruffini/{name.lower()}"] += 1
            if name == "WRENCH":
                _same_wrench(theirs, frame)
            elif name == "FIELD":
                _same_field(theirs, frame)
    return counts


def _same_wrench(m: Any, frame: Any) -> None:
    forces = [1e-6 * getattr(m, f"force_{axis}_un") for axis in "xyz"]
    torques = [1e-12 * getattr(m, f"torque_{axis}_un_um") for axis in "xyz"]
    np.testing.assert_allclose(frame.wrench.values, [*forces, *torques], rtol=1e-12)
    safe = np.where(np.array(m.validity) == VALID, [*forces, *torques], np.nan)
    if frame.is_valid:
        np.testing.assert_allclose([*frame.wrench.force, *frame.wrench.torque], safe, rtol=1e-12)


def _same_field(m: Any, frame: Any) -> None:
    np.testing.assert_allclose(frame.field.raw_force, node_values(m.force) * (m.force_lsb_un * 1e-6), rtol=1e-12)
    if m.HasField("displacement"):
        moved = node_values(m.displacement) * (m.displacement_lsb_nm * 1e-9)
        np.testing.assert_allclose(frame.field.displacement, moved, rtol=1e-12)
