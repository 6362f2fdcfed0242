"""Recordings that a disk spoilt: all that is whole is read, the loss is reported, `recover` writes a whole file."""

from __future__ import annotations

import fcntl
import os
import random
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from tiny_sensor import N_FRAMES, Sensor, start

from ruffini.api import SensorFrame
from ruffini.device import Connection
from ruffini.errors import InputError
from ruffini.native import native_folder
from ruffini.record import Recording, record_stream
from ruffini.record.mcap_file import CHUNK_BYTES
from ruffini.record.recover import recover

CHUNKS = 6


@pytest.fixture(scope="module")
def run(sensor: Sensor, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of several chunks; they are smaller than usual."""
    folder = tmp_path_factory.mktemp("spoilt")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ruffini.record.mcap_file.CHUNK_BYTES", CHUNK_BYTES // 8)
        with (
            start(sensor, folder / "store", "--lockstep", "--wait-for-host") as daemon,
            Connection(daemon.port) as host,
        ):
            host.flash(sensor.calibration)
            record_stream(host, folder / "run.mcap")
    assert len(chunks(folder / "run.mcap")) >= CHUNKS
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def good(run: Path) -> dict[int, dict[str, bytes]]:
    return {f.number: contents(f) for f in Recording(run).frames()}


def contents(frame: SensorFrame) -> dict[str, bytes]:
    return {name: message.SerializeToString() for name, message in frame.messages.items()}


def chunks(path: Path) -> list[int]:
    """Where the chunks begin, by their index in the summary."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return [chunk.chunk_start_offset for chunk in summary.chunk_indexes]


def frames_by_chunk(path: Path) -> list[set[int]]:
    """Numbers of the frames that have a message in each chunk: all messages of a frame have its time of capture."""
    number_at = {
        message.stamp.capture_us * 1000: frame.number
        for frame in Recording(path).frames() for message in frame.messages.values()
    }  # fmt: skip
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    ends = [(chunk.message_start_time, chunk.message_end_time) for chunk in summary.chunk_indexes]
    return [{n for time_ns, n in number_at.items() if first <= time_ns <= last} for first, last in ends]


def spoilt(run: Path, folder: Path, at: int, data: bytes) -> Path:
    path = folder / "spoilt.mcap"
    whole = bytearray(run.read_bytes())
    whole[at : at + len(data)] = data
    path.write_bytes(whole)
    return path


def frames_of(path: Path, good: dict[int, dict[str, bytes]]) -> tuple[set[int], list[str]]:
    """Numbers of the frames, none of which is wrong, and the problems."""
    recording = Recording(path)
    got = list(recording.frames())
    for frame in got:
        assert contents(frame).items() <= good[frame.number].items()
    return {frame.number for frame in got}, recording.problems


@pytest.mark.parametrize("seed", range(4))
def test_a_flipped_bit_in_the_first_chunk_costs_a_part_of_that_chunk(
    run: Path, good: dict[int, dict[str, bytes]], tmp_path: Path, seed: int
) -> None:
    data, first, chances = run.read_bytes(), chunks(run)[0], random.Random(seed)
    end = first + 9 + int.from_bytes(data[first + 1 : first + 9], "little")
    at = chances.randrange(first + 60, end)
    path = spoilt(run, tmp_path, at, bytes([data[at] ^ 1 << chances.randrange(8)]))
    kept, problems = frames_of(path, good)
    assert len(kept) >= N_FRAMES - 2
    assert problems
    assert Recording(path).hello.device_serial == "0001"


@pytest.mark.parametrize("where", ["over a chunk's head", "within a chunk", "over two chunks"])
def test_zeros_cost_what_they_cover(run: Path, good: dict[int, dict[str, bytes]], tmp_path: Path, where: str) -> None:
    """At every chunk but the first and the last two. Only frames of the chunks that are touched may be missing."""
    starts, holds, lost = chunks(run), frames_by_chunk(run), []
    for i in range(1, len(starts) - 2):
        begin, end, n_touched = {
            "over a chunk's head": (starts[i] - 5, starts[i] + 40, 1),
            "within a chunk": (starts[i] + 100, starts[i] + 300, 1),
            "over two chunks": (starts[i] - 10, starts[i + 2] + 10, 3),
        }[where]
        kept, problems = frames_of(spoilt(run, tmp_path, begin, bytes(end - begin)), good)
        missing = good.keys() - kept
        assert missing <= set().union(*holds[i : i + n_touched])
        assert any("lost" in p or "spoilt" in p or "holds" in p or "make no sense" in p for p in problems), problems
        lost.append(len(missing))
    assert max(lost) > 0


def test_zeros_from_the_first_byte_cost_what_they_cover(
    run: Path, good: dict[int, dict[str, bytes]], tmp_path: Path
) -> None:
    """The magic, HELLO's attachment and the first chunk: who the sensor is stands at the end again."""
    for begin in (0, 9):
        path = spoilt(run, tmp_path, begin, bytes(chunks(run)[1] + 50 - begin))
        kept, problems = frames_of(path, good)
        assert len(kept) >= N_FRAMES - 8
        assert problems
        assert Recording(path).hello.device_serial == "0001"
        assert recover(Recording(path), tmp_path / "out.mcap")["frames"] >= len(kept)


def test_a_schema_spoilt_in_the_summary_is_passed_over(
    run: Path, good: dict[int, dict[str, bytes]], tmp_path: Path
) -> None:
    data = run.read_bytes()
    at = data.rindex(b"uptime_us")
    assert at > chunks(run)[-1], "it is in the summary"
    path = spoilt(run, tmp_path, at, b"\xff")
    assert frames_of(path, good)[0] == good.keys()


@pytest.mark.parametrize(
    ("name", "flipped"),
    [(b"device_serial", b"devicf_serial"), (b"HELLO", b"HELMO"), (b"Hello", b"Helmo")],
)
def test_a_schema_of_other_names_is_passed_over(run: Path, name: bytes, flipped: bytes) -> None:
    recording = Recording(run)
    data = (native_folder() / "ruffini.desc").read_bytes()
    assert recording._schema_of(data) is not None
    assert name in data
    assert recording._schema_of(data.replace(name, flipped)) is None
    assert "a damaged schema was skipped: it has no HELLO with a device_serial" in recording.problems[-1]


def test_without_a_schema_that_names_hello_a_recording_is_refused(run: Path, tmp_path: Path) -> None:
    """The first chunk, which has the schema, is gone; the summary has it again, without a checksum."""
    starts, data = chunks(run), run.read_bytes()
    cut = data[: starts[0]] + bytes(starts[1] - starts[0]) + data[starts[1] :]
    path = tmp_path / "flipped.mcap"
    path.write_bytes(cut)
    assert Recording(path).hello.device_serial == "0001"
    assert b"HELLO" in cut
    path.write_bytes(cut.replace(b"HELLO", b"HELMO"))
    with pytest.raises(InputError, match="is not a recording of a sensor"):
        Recording(path)


def test_recover_writes_a_whole_file(run: Path, good: dict[int, dict[str, bytes]], tmp_path: Path) -> None:
    starts = chunks(run)
    path = spoilt(run, tmp_path, starts[2] - 5, bytes(starts[3] - starts[2]))
    out, kept = tmp_path / "recovered.mcap", frames_of(path, good)[0]
    counts = recover(Recording(path), out)
    assert counts["messages"] > len(kept) > 0
    assert frames_of(out, good) == (kept, [])
    before, after = list(Recording(path).frames()), list(Recording(out).frames())
    for a, b in zip(before, after, strict=True):
        assert (a.number, a.flags, a.is_simulated, a.is_replay, a.host_time_ns) == (
            b.number, b.flags, b.is_simulated, b.is_replay, b.host_time_ns,
        )  # fmt: skip
        assert contents(a) == contents(b)
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.attachment_count == 2  # HELLO, first and last


def test_a_whole_file_recovered_is_as_it_was(run: Path, good: dict[int, dict[str, bytes]], tmp_path: Path) -> None:
    counts = recover(Recording(run), tmp_path / "same.mcap")
    assert counts["frames"] == N_FRAMES
    assert frames_of(tmp_path / "same.mcap", good) == (set(good), [])


def test_a_topic_holds_the_messages_of_the_raw_bytes_and_no_older_ones(sensor: Sensor, tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    with start(sensor, tmp_path / "store", "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        host.subscribe(wrench=1, markers=1)
        for _ in zip(range(6), host.stream(), strict=False):
            pass
        while not len(host.messages):  # what arrives before the answer is kept: some precede the recording
            host.status()
        counts = record_stream(host, path)
    recording = Recording(path)
    in_raw = Counter(recording.schema.type_name(frame.type) for frame, _ in recording.packets())
    assert counts["WRENCH"] == in_raw["WRENCH"] > 0
    assert counts["MARKERS"] == in_raw["MARKERS"] > 0


def test_chunk_heads_are_found_where_the_index_has_them(run: Path) -> None:
    recording, size = Recording(run), run.stat().st_size
    for at in chunks(run):
        assert recording._next_chunk(at - 3, size) == at


def test_a_recording_is_not_replaced_while_it_is_made(sensor: Sensor, run: Path, tmp_path: Path) -> None:
    from ruffini.record.mcap_file import _opened

    path = tmp_path / "busy.mcap"
    path.write_bytes(run.read_bytes())
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(InputError, match=r"busy\.mcap: another program records to it"), _opened(path):
            pass
    assert path.read_bytes() == run.read_bytes()


def test_a_full_disk_is_named_with_the_frames_that_are_saved(sensor: Sensor, tmp_path: Path) -> None:
    """A limit of the file's size stands for a full disk: the same calls fail."""
    import resource
    import signal

    path = tmp_path / "full.mcap"
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    with start(sensor, tmp_path / "store", "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("ruffini.record.mcap_file.CHUNK_BYTES", CHUNK_BYTES // 8)
            resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
            try:
                with pytest.raises(InputError, match=r"full\.mcap: File too large: (\d+) frames are saved") as error:
                    record_stream(host, path)
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, before)
                signal.signal(signal.SIGXFSZ, handler)
    n = int(str(error.value).split("large: ")[1].split()[0])
    assert 0 < n < N_FRAMES
    assert sum(1 for _ in Recording(path).frames()) == n
    assert os.path.getsize(path) <= 200_000
