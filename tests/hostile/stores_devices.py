"""Hostile stores, replay folders, devices and recordings."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("support", "e2e", "py/calibrate", "hostile")]

import hang  # noqa: E402
import pytest  # noqa: E402
from cases import LIMIT_S, group, refused  # noqa: E402


def sensor() -> Any:
    """The tiny sensor of the end-to-end tests, made once."""
    from tiny_sensor import Sensor, make_sensor

    from ruffini.boards import find_board

    root = ROOT / "build" / "hostile" / "tiny-sensor"
    if not (root / "calibration").exists():
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        (root / "calibration").write_bytes(make_sensor(root).calibration)
    folder = root / "tiny"
    return Sensor(find_board(folder), folder, root / "recording", (root / "calibration").read_bytes())


def spoil(chance: random.Random, path: Path, good: bytes) -> None:
    """In the place of the newest calibration, what a medium or a person may leave."""
    kind = chance.choice(["empty", "cut", "bit", "noise", "pipe", "folder", "link", "zeros"])
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(chance.choice(["/dev/zero", "/none", str(path)]))
    else:
        flipped = bytearray(good)
        flipped[chance.randrange(len(good))] ^= 1 << chance.randrange(8)
        at = chance.randrange(len(good))
        zeros = good[:at] + bytes(min(4096, len(good) - at)) + good[at + 4096 :]
        path.write_bytes({"empty": b"", "cut": good[: chance.randrange(1, len(good))], "bit": bytes(flipped),
                          "noise": chance.randbytes(chance.randrange(1, 9999)), "zeros": zeros}[kind])  # fmt: skip


@group("store: the newest file is spoilt", 16, 2)
def _store(chance: random.Random, folder: Path) -> None:
    from tiny_sensor import start

    from ruffini.calibrate import container
    from ruffini.device import Connection

    tiny = sensor()
    good = tiny.calibration
    read = container.unpack(good)
    newer = container.pack(
        read.tensors, {**read.metadata, "created_utc": f"2031-01-01T00:00:{chance.randrange(60):02}Z"}
    )
    sha = container.unpack(good).sha256
    store, number = folder / "store", chance.randrange(1, 10**9)
    store.mkdir()
    (store / f"calibration-{number}.safetensors").write_bytes(good)
    while True:
        newest = store / f"calibration-{number + 1}.safetensors"
        spoil(chance, newest, newer.data)
        if not newest.is_file() or newest.is_symlink() or newest.read_bytes() != newer.data:
            break
        newest.unlink()
    for flashes in (True, False):
        with start(tiny, store, "--lockstep", "--wait-for-host", "--linger") as daemon, Connection(daemon.port) as host:
            if flashes:
                assert host.hello.sensors[0].calibration.sha256 == sha, "what was before measures"
                assert host.status().health & 16, "HEALTH_STORE_ERROR"
                host.flash(newer.data)
                assert host.hello.sensors[0].calibration.sha256 == newer.sha256
                host.undo_flash()
            assert host.hello.sensors[0].calibration.sha256 == sha, "an undo goes back to it, also after a restart"


@group("daemon: pictures of a replay", 16, 3)
def _replay(chance: random.Random, folder: Path) -> None:
    from ruffini.daemon import find_daemon

    tiny = sensor()
    recording = shutil.copytree(tiny.recording, folder / "recording")
    frames = sorted((recording / "frames").iterdir())
    for path in chance.sample(frames[1:], chance.randrange(1, 6)):
        whole = path.read_bytes()
        path.unlink()
        kind = chance.choice(["huge", "large", "pipe", "cut", "folder", "empty", "noise"])
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "folder":
            path.mkdir()
        elif kind in ("huge", "large"):
            size = chance.randrange(50_000, 2**31) if kind == "huge" else chance.randrange(500, 5000)
            head = b"IHDR" + struct.pack(">IIBBBBB", size, size, 8, 2, 0, 0, 0)
            crc = struct.pack(">I", zlib.crc32(head))
            path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\r" + head + crc + whole[33:])
        else:
            path.write_bytes({"cut": whole[: len(whole) // 2], "empty": b"", "noise": chance.randbytes(999)}[kind])
    command = [str(find_daemon()), "--board", str(tiny.folder), "--camera", f"replay:{recording}", "--link", "pty",
               "--store", str(folder / "store"), "--lockstep"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, f"{done.returncode}: {done.stderr}"


@group("daemon: pipes and spoilt files at its start", 8, 2)
def _start(chance: random.Random, folder: Path) -> None:
    from ruffini.daemon import find_daemon

    tiny = sensor()
    board, keys, camera = folder / "tiny", folder / "keys", folder / "camera"
    shutil.copytree(tiny.folder, board)
    keys.mkdir()
    odd = {"board": board / "board.toml", "keys": keys / "a.pub", "camera": camera}
    which = chance.choice(list(odd))
    odd[which].unlink(missing_ok=True)
    if chance.random() < 0.5:
        os.mkfifo(odd[which])
    else:
        odd[which].write_bytes(chance.choice([b"", b"\0" * 99, chance.randbytes(99), b"[" * 100_000]))
    replay = f"replay:{camera if which == 'camera' else tiny.recording}"
    command = [str(find_daemon()), "--board", str(board), "--camera", replay, "--link", "pty", "--lockstep",
               "--store", str(folder / "store"), "--keys", str(keys)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode in (2, 3), f"{which}: {done.returncode}: {done.stderr}"
    assert done.stderr.startswith("ruffinid: "), done.stderr


@group("daemon: a serial number of its own", 3, 1)
def _serial(_: random.Random, folder: Path) -> None:
    from tiny_sensor import start

    from ruffini.device import Connection

    tiny, seen = sensor(), list[str]()
    for store in ("a", "b", "a"):
        with start(tiny, folder / store, "--wait-for-host", serial="") as daemon, Connection(daemon.port) as host:
            seen.append(host.serial_number)
    assert seen[0] == seen[2] != seen[1], seen


@group("devices: trials without end, swapped sensors", 12, 3)
def _devices(chance: random.Random, folder: Path) -> None:
    from test_strange_devices import Flashed

    from ruffini.device import Connection, flashing
    from ruffini.errors import RuffiniError

    walk = [0]

    def trial(_: int) -> int:
        walk[0] = max(walk[0] + chance.choice([-1, 0, 1, 5, 60]), 0)
        return walk[0]

    with (
        mock.patch.object(flashing, "TRIAL_STALL_S", 0.05),
        mock.patch.object(flashing, "TRIAL_POLL_S", 0.0),
        Flashed(trial) as device,
        Connection(device.port) as host,
        hang.guard("a trial"),
    ):
        is_swapped, answer = chance.random() < 0.5, device._answer

        def swapped(frame: Any) -> None:
            answer(frame)
            if is_swapped and device.n_commands:
                device._hello.device_serial = f"other-{chance.randrange(9)}"

        device._answer = swapped  # type: ignore[method-assign]
        with pytest.raises(RuffiniError, match="answers in place of" if is_swapped else None):
            host.flash(chance.randbytes(chance.randrange(1, 9000)))


def recording(folder: Path) -> Path:
    """A recording of several chunks, made once."""
    path = ROOT / "build" / "hostile" / "recording.mcap"
    if not path.exists():
        from told_sensor import ToldSensor, info_of, told_field

        from ruffini.boards import find_board
        from ruffini.device import Connection
        from ruffini.record import record_stream

        board = find_board("gelslim")
        path.parent.mkdir(parents=True, exist_ok=True)
        field = told_field(board.grid.n_x, board.grid.n_y)
        with (
            mock.patch("ruffini.record.mcap_file.CHUNK_BYTES", 32 << 10),
            ToldSensor([info_of(board)], field, rate_hz=60.0) as device,
            Connection(device.port) as host,
        ):
            device.stop_after = 90
            with contextlib.suppress(Exception):
                record_stream(host, path.with_suffix(".part"), resume_s=1.0)
        path.with_suffix(".part").replace(path)
    return path


def contents(path: Path) -> tuple[dict[int, dict[str, bytes]], list[str]]:
    from ruffini.record import Recording

    read = Recording(path)
    frames = {
        f.number: {name: message.SerializeToString() for name, message in f.messages.items()}
        for f in read.frames(partial=True)
    }
    return frames, read.problems


@group("recordings: flipped bits, zeros, cuts", 60, 8)
def _recordings(chance: random.Random, folder: Path) -> None:
    from mcap.reader import make_reader

    from ruffini.record import Recording
    from ruffini.record.recover import recover

    whole = recording(folder)
    good, _ = contents(whole)
    data, path = bytearray(whole.read_bytes()), folder / "spoilt.mcap"
    with whole.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    sizes = [chunk.chunk_length for chunk in summary.chunk_indexes]
    kind = chance.choice(["bit", "zeros", "bits"])
    if kind == "zeros":
        n = chance.randrange(1, 3 * max(sizes))
        at = chance.randrange(8, len(data))
        data[at : at + n] = bytes(len(data[at : at + n]))
        n_spoilt = n // min(sizes[:-1]) + 2
    else:
        n_spoilt = 1 if kind == "bit" else chance.randrange(2, 5)
        for _ in range(n_spoilt):
            data[chance.randrange(8, len(data))] ^= 1 << chance.randrange(8)
    path.write_bytes(data)
    got, problems = contents(path)
    for number, messages in got.items():
        assert messages.items() <= good[number].items(), f"frame {number} is not what was recorded"
    per_chunk = len(good) // len(sizes) + 3  # a frame may begin in the chunk before
    assert len(got) >= len(good) - n_spoilt * per_chunk, f"{kind}: {len(got)} of {len(good)} frames"
    assert got.keys() == good.keys() or problems, "frames are lost, and nothing is said"
    recover(Recording(path), folder / "out.mcap")
    again, said = contents(folder / "out.mcap")
    assert again == got
    assert not said, said


@group("recordings: outputs that are inputs", 12, 3)
def _same_file(chance: random.Random, folder: Path) -> None:
    path = Path(shutil.copy(recording(folder), folder / "a.mcap"))
    before, out = path.read_bytes(), folder / "b.mcap"
    kind = chance.choice(["same", "link", "hard", "dots"])
    if kind == "link":
        out.symlink_to(path)
    elif kind == "hard":
        os.link(path, out)
    else:
        out = path if kind == "same" else folder / "." / "x" / ".." / "a.mcap"
        (folder / "x").mkdir()
    verb = chance.choice(["export", "plot", "recover"])
    words = [verb, path, out] if verb == "recover" else [verb, path, "--out", out]
    refused(*words, "--force")
    assert path.read_bytes() == before
