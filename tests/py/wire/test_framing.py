"""Frames on the wire against the golden bytes of proto/vectors, and against hostile ones."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from golden import FOLDER, read_vectors
from hypothesis import given, settings
from hypothesis import strategies as st

from ruffini.wire.dense import decode_dense
from ruffini.wire.framing import (
    MAX_MESSAGE_BYTES,
    REPLAY,
    Decoder,
    Frame,
    cobs_decode,
    cobs_encode,
    crc32c,
    encode_message,
)

FRAMES = read_vectors("frames.txt")


def text_of(frame: Frame) -> str:
    """A whole message as the vectors write it."""
    return (
        f"frame type={frame.type} flags={frame.flags} sensor={frame.sensor} sequence={frame.sequence} "
        f"fragment=0 fragments=1 payload={frame.payload.hex()}"
    )


def test_there_are_enough_vectors() -> None:
    good = [v for v in FRAMES if v[2].startswith("frame")]
    assert len(good) >= 15
    assert len(FRAMES) - len(good) >= 25


@pytest.mark.parametrize(("name", "data", "outcome"), FRAMES, ids=[v[0] for v in FRAMES])
def test_says_of_the_golden_bytes_what_the_specification_says(name: str, data: str, outcome: str) -> None:
    # A decoder hears one direction: that of the vector's frames, where it has any.
    decoder = Decoder(from_host="flags=1 " in outcome)
    said = [text_of(f) for f in decoder.feed(bytes.fromhex(data))]
    events = outcome.split("; ")
    # A fragment of several is no message yet; the first opens one, a later one alone is incomplete.
    whole = [e for e in events if e.startswith("frame") and "fragments=1 " in e]
    assert said == whole
    for what in ("bad_crc", "malformed", "oversize"):
        assert asdict(decoder.counters)[what] == events.count(what)


def test_encodes_the_golden_frames_byte_for_byte() -> None:
    for name, data, outcome in FRAMES:
        if not outcome.startswith("frame") or ";" in outcome or "fragments=1 " not in outcome:
            continue
        (frame,) = Decoder(from_host="flags=1 " in outcome).feed(bytes.fromhex(data))
        again = encode_message(
            frame.type, frame.payload, sensor=frame.sensor, sequence=frame.sequence, flags=frame.flags
        )
        assert again.hex() == data, name


def test_the_generator_makes_what_is_committed(tmp_path: Path) -> None:
    subprocess.run([sys.executable, FOLDER / "make_vectors.py", tmp_path], check=True)
    for name in ("frames.txt", "dense.txt"):
        assert (tmp_path / name).read_text() == (FOLDER / name).read_text()


def test_a_long_message_travels_in_fragments() -> None:
    payload = bytes(i % 256 for i in range(10_000))
    data = encode_message(6, payload, sensor=2, sequence=7, flags=2)
    assert data.count(b"\0") == 3
    decoder = Decoder()
    frames = [f for i in range(0, len(data), 100) for f in decoder.feed(data[i : i + 100])]
    assert [(f.type, f.sensor, f.sequence, f.payload) for f in frames] == [(6, 2, 7, payload)]
    assert frames[0].is_simulated


def test_a_lost_fragment_loses_its_message_alone() -> None:
    long = encode_message(6, bytes(10_000), sensor=0, sequence=1, flags=0).split(b"\0")
    after = encode_message(4, b"x", sensor=0, sequence=2, flags=0)
    decoder = Decoder()
    frames = list(decoder.feed(long[0] + b"\0" + long[2] + b"\0" + after))
    assert [f.sequence for f in frames] == [2]
    assert decoder.counters.incomplete == 1


@pytest.mark.parametrize("size", [1, 7, 4000, 1 << 20])
def test_a_message_says_where_it_ended(size: int) -> None:
    sent = [encode_message(3, bytes(5000), sensor=1, sequence=i) for i in range(3)]
    stream, decoder = b"\x05\0" + b"".join(sent), Decoder(from_host=True)
    ends = [f.end for i in range(0, len(stream), size) for f in decoder.feed(stream[i : i + size])]
    assert ends == [2 + len(b"".join(sent[: i + 1])) for i in range(3)]
    assert decoder.n_fed == len(stream)


def test_it_is_midway_from_the_first_byte_of_a_message_to_its_last() -> None:
    sent, decoder = encode_message(6, bytes(5_000), sensor=0, sequence=1, flags=0), Decoder()
    assert len(sent.split(b"\0")) > 2, "it comes in fragments"
    assert not decoder.is_midway
    for at in range(len(sent) - 1):
        assert not list(decoder.feed(sent[at : at + 1]))
        assert decoder.is_midway
    assert len(list(decoder.feed(sent[-1:]))) == 1
    assert not decoder.is_midway


def test_lost_messages_are_counted_by_sensor() -> None:
    decoder = Decoder()
    for sensor, sequence in ((0, 0xFFFFFFFD), (1, 9), (0, 0), (1, 10), (0, 1)):
        list(decoder.feed(encode_message(4, b"", sensor=sensor, sequence=sequence, flags=0)))
    assert decoder.counters.lost == 2


def test_a_restart_of_the_device_is_no_loss() -> None:
    decoder = Decoder()
    for sequence in (70_000, 0, 1, 3):
        list(decoder.feed(encode_message(4, b"", sensor=0, sequence=sequence, flags=0)))
    assert decoder.counters.lost == 1


def test_an_echo_neither_opens_nor_breaks_a_message() -> None:
    first, second, _ = encode_message(6, bytes(5_000), sensor=0, sequence=1, flags=0).split(b"\0")
    echo = encode_message(1, b"", sensor=0, sequence=77)
    decoder = Decoder()
    frames = list(decoder.feed(first + b"\0" + echo + second + b"\0"))
    assert [(f.sequence, len(f.payload)) for f in frames] == [(1, 5_000)]
    assert (decoder.counters.echo, decoder.counters.lost, decoder.counters.incomplete) == (1, 0, 0)


def test_fragments_that_disagree_on_their_number_are_no_message() -> None:
    def fragment(index: int, count: int) -> bytes:
        body = bytes([1, 0, 6, 0, 5, 0, 0, 0, index, count, 1, 0, 0x41])
        return cobs_encode(body + crc32c(body).to_bytes(4, "little")) + b"\0"

    decoder = Decoder()
    assert list(decoder.feed(fragment(0, 3) + fragment(1, 2))) == []
    assert decoder.counters.incomplete == 1
    assert [f.payload for f in decoder.feed(fragment(0, 2) + fragment(1, 2))] == [b"AA"]


def test_a_message_beyond_255_fragments_is_refused() -> None:
    with pytest.raises(ValueError, match="255 fragments"):
        encode_message(9, bytes(MAX_MESSAGE_BYTES + 1), sensor=0, sequence=0)


def test_crc_check_value() -> None:
    assert crc32c(b"123456789") == 0xE3069283


@given(st.binary(max_size=2000))
def test_cobs_round_trip(data: bytes) -> None:
    stuffed = cobs_encode(data)
    assert 0 not in stuffed
    assert len(stuffed) <= len(data) + len(data) // 254 + 1
    assert cobs_decode(stuffed) == data


@settings(max_examples=300)
@given(st.lists(st.binary(max_size=6000), max_size=4))
def test_hostile_bytes_neither_crash_nor_pile_up(chunks: list[bytes]) -> None:
    decoder = Decoder()
    for chunk in chunks:
        list(decoder.feed(chunk))
    assert len(decoder._buffer) < 4096
    assert sum(map(len, decoder._parts)) <= MAX_MESSAGE_BYTES
    valid = encode_message(1, b"", sensor=255, sequence=0, flags=0)
    assert [f.type for f in decoder.feed(b"\0" + valid)] == [1]


@settings(max_examples=300)
@given(st.data())
def test_a_spoilt_stream_yields_what_was_sent_or_nothing(data: st.DataObject) -> None:
    sizes = data.draw(st.lists(st.integers(0, 9000), min_size=1, max_size=4))
    sent = [(i, bytes(k % 251 for k in range(n))) for i, n in enumerate(sizes)]
    stream = bytearray(b"".join(encode_message(9, p, sensor=0, sequence=i, flags=REPLAY) for i, p in sent))
    for at in data.draw(st.lists(st.integers(0, len(stream) - 1), max_size=6)):
        match data.draw(st.sampled_from(["flip", "drop", "add"])):
            case "flip":
                stream[min(at, len(stream) - 1)] ^= data.draw(st.integers(1, 255))
            case "drop":
                del stream[at : at + data.draw(st.integers(1, 300))]
                stream = stream or bytearray(b"\0")
            case _:
                stream[at:at] = data.draw(st.binary(max_size=20))
    decoder = Decoder()
    cut = data.draw(st.integers(0, len(stream)))
    got = [f for part in (stream[:cut], stream[cut:]) for f in decoder.feed(bytes(part))]
    assert {(f.sequence, f.payload) for f in got} <= set(sent)
    assert all(f.is_replay and not f.is_simulated for f in got)


def test_the_examples_of_the_specification_are_right() -> None:
    text = " ".join((FOLDER.parent / "README.md").read_text().split())
    example = next(line for line in (FOLDER / "frames.txt").read_text().splitlines() if not line.startswith("#"))
    assert encode_message(1, b"", sensor=255, sequence=0).hex() in example.replace(" ", ""), "the README points there"
    packed, sparse = "03 88 58" + 10 * " 00", "04 04 0a 0d" + 14 * " 00"
    assert packed in text
    assert sparse in text
    np.testing.assert_array_equal(decode_dense(0, 5, 1, 1, bytes.fromhex(packed)).ravel(), [0, -1, 1, 2, -3])
    np.testing.assert_array_equal(decode_dense(1, 4, 1, 3, bytes.fromhex(sparse))[0, 2], [5, 0, -7])
    assert cobs_encode(b"\x11\x00\x22").hex(" ") in text


def test_one_endless_frame_is_counted_once() -> None:
    decoder = Decoder()
    for _ in range(20):
        assert list(decoder.feed(bytes([2]) * 1_000)) == []
    assert list(decoder.feed(b"\0")) == []
    assert decoder.counters.oversize == 1


def test_a_message_that_another_one_cuts_off_is_counted() -> None:
    first = encode_message(6, bytes(5_000), sensor=0, sequence=1, flags=0).split(b"\0")[0] + b"\0"
    decoder = Decoder()
    assert list(decoder.feed(first + first)) == []
    assert decoder.counters.incomplete == 1


def test_a_zero_within_cobs_is_refused() -> None:
    assert cobs_decode(b"\x03\x11\x00") is None
