"""Hostile files, devices, stores and recordings: no traceback, no hang, nothing lost, nothing implausible unmarked.

Each case is drawn from the seed and ends as it must: refused in one sentence with its exit code, or with all that was
there.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("support", "e2e", "py/calibrate", "hostile")]

import cv2  # noqa: E402
import h5py  # noqa: E402
import hang  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from command_line import refusal_in, run_ruffini  # noqa: E402
from row import Row  # noqa: E402

LIMIT_S = 60.0  # of a case: it hangs
Case = Callable[[random.Random, Path], None]
GROUPS: dict[str, tuple[Case, int, int]] = {}  # cases in full, in quick


def group(name: str, n: int, n_quick: int) -> Callable[[Case], Case]:
    """Add a kind of case to the table."""

    def add(case: Case) -> Case:
        GROUPS[name] = case, n, n_quick
        return case

    return add


def rows(seed: int, quick: bool) -> Iterator[Row]:
    """One row a group."""
    hang.HANG_S = LIMIT_S
    for name, (case, n, n_quick) in GROUPS.items():
        n_wrong, note = 0, ""
        for i in range(n_quick if quick else n):
            with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
                try:
                    case(random.Random(f"{seed} {name} {i}"), Path(folder))
                except (Exception, AssertionError) as error:  # whatever it is, the case is wrong
                    n_wrong += 1
                    what = " ".join(str(error).split())[:160]
                    note = note or f"case {i}: {type(error).__name__}: {what}"
        n_tried = n_quick if quick else n
        yield Row(name, n_tried, n_tried - n_wrong, n_wrong, 0.0, note)


def refused(*words: object, codes: tuple[int, ...] = (2,), port: str | None = None) -> str:
    """The sentence of a verb that refuses."""
    done = run_ruffini(*words, port=port)
    assert done.code in codes, f"{words}: exit code {done.code}: {done.err[-200:]}"
    sentence = next(line for line in done.err.splitlines() if line.startswith("ruffini: "))
    assert "Traceback" not in done.err, done.err
    return sentence


# ---- files ---------------------------------------------------------------------------------------

READERS = (
    ("cal", "show", "{}"), ("cal", "verify", "{}"), ("cal", "merge", "{}", "--out", "{}.out"), ("cal", "flash", "{}"),
    ("export", "{}", "--out", "{}.csv"), ("plot", "{}", "--out", "{}.html"), ("recover", "{}", "{}.mcap"),
    ("replay", "--text", "{}"), ("cal", "convert", "{}", "--out", "{}.h5"),
    ("cal", "fit", "--board", "gelslim", "{}", "--out", "{}.o"),
    ("cal", "operator", "--board", "gelslim", "--material", "{}", "--out", "{}.out"),
    ("cal", "operator", "--board", "gelslim", "--relaxation", "{}", "--out", "{}.out"),
    ("cal", "report", "{}", "--log", "{}", "--out", "{}.html"),
    ("cal", "photometric", "{}", "--board", "gelslim", "--out", "{}.o"),
    ("cal", "wrench", "{}", "--time", "t", "--features", "f*", "--wrench", "a,b,c,d,e,g", "--out", "{}.o"),
)  # fmt: skip


def odd_file(chance: random.Random, path: Path) -> None:
    kind = chance.choice(["pipe", "sparse", "empty", "noise", "zeros", "folder", "text", "deep", "loop", "socket"])
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "sparse":
        with path.open("wb") as file:
            file.write(chance.randbytes(chance.randrange(64)))
            file.truncate(chance.randrange(2 << 30, 400 << 30))
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "socket":
        import socket

        with contextlib.closing(socket.socket(socket.AF_UNIX)) as bound, contextlib.chdir(path.parent):
            bound.bind(path.name)
    else:
        path.write_bytes({
            "empty": b"", "noise": chance.randbytes(chance.randrange(1, 5000)),
            "zeros": bytes(chance.randrange(1, 5000)),
            "text": chance.choice(["{}", "[]", "null", '{"board": 1}', "a,b\n1", "\ufeff", "nan\n", "=\n"]).encode(),
            "deep": chance.choice([b"[", b'{"a":', b"a.b."]) * chance.randrange(1000, 200_000),
        }[kind])  # fmt: skip


@group("files: pipes, sparse, noise, folders", 120, 15)
def _odd_files(chance: random.Random, folder: Path) -> None:
    path = folder / f"file{chance.choice(['', '.h5', '.csv', '.mcap', '.safetensors', '.avi', '.json'])}"
    odd_file(chance, path)
    words = chance.choice(READERS)
    refused(*(word.format(path) for word in words), codes=(2, 3, 4, 5))


@group("files: HDF5 of any shape, kind, link", 80, 10)
def _hdf5(chance: random.Random, folder: Path) -> None:
    from ruffini.errors import InputError
    from ruffini.rig.log_file import ARRAYS, read_log

    path, n = folder / "log.h5", chance.randrange(2, 9)
    with h5py.File(path, "w") as file:
        file.attrs.update(format="ruffini-calibration-log", format_version=1, facts="{}", found="{}")
        touch = file.create_group("touch/00000")
        touch.attrs["facts"] = "{}"
        for name, (columns, _) in ARRAYS.items():
            touch[name] = np.arange(float(n)) if columns is None else np.zeros((n, columns))
        name = chance.choice(list(ARRAYS))
        del touch[name]
        rows_there = 1 << chance.randrange(33, 50)
        spoil: list[Callable[[], Any]] = [
            lambda: touch.create_dataset(name, shape=(rows_there,), chunks=(1 << 16,), dtype="f8"),
            lambda: touch.create_dataset(name, shape=(rows_there, 6), chunks=(1 << 12, 6), dtype="f8"),
            lambda: touch.create_dataset(name, shape=(n,) * chance.choice([0, 3, 5]), dtype="f8"),
            lambda: touch.create_dataset(name, data=h5py.Empty("f8")),
            lambda: touch.create_dataset(name, data=[b"text"] * n),
            lambda: touch.create_dataset(name, data=np.zeros(n, chance.choice(["c16", "V4"]))),
            lambda: touch.create_group(name),
            lambda: touch.__setitem__(name, h5py.SoftLink(chance.choice(["/", "/touch", "/none"]))),
            lambda: touch.__setitem__(name, h5py.ExternalLink(chance.choice(["/none.h5", str(path)]), "/touch")),
            lambda: touch.__setitem__(name, h5py.SoftLink("/touch/00000/" + name)),
            lambda: None,
        ]  # fmt: skip
        chance.choice(spoil)()
    with contextlib.suppress(InputError):
        read_log(path)
        raise AssertionError(f"{name} is spoilt, and the log is read")


@group("files: tables with odd rows and names", 80, 10)
def _tables(chance: random.Random, folder: Path) -> None:
    path, n = folder / "log.csv", chance.randrange(3, 30)
    names = ["time_s", "fz_N", "m0_dx_px", "m0_dy_px", "touch"]
    cells = [[f"{0.1 * i:.2f}", f"{-chance.random():.3f}", "0.1", "0.2", str(i // 3)] for i in range(n)]
    row, column = chance.randrange(n), chance.randrange(5)
    kind = chance.choice(["longer", "shorter", "comma", "no number", "far marker", "no rows", "semicolons", "nan"])
    if kind == "longer":
        cells[row].append("1")
    elif kind == "shorter":
        del cells[row][column]
    elif kind == "comma":
        cells[row] = ",".join(cells[row]).replace(".", ",").split(",")
    elif kind in ("no number", "nan"):
        cells[row][chance.randrange(2)] = "x" if kind == "no number" else "nan"
    elif kind == "far marker":
        names[2:4] = [f"m{chance.randrange(10**6, 10**12)}_dx_px", "m0_dy_px"]
    elif kind == "no rows":
        cells = []
    text = "\n".join(",".join(line) for line in [names, *cells])
    text = text.replace(",", ";") if kind == "semicolons" else text
    path.write_text(chance.choice(["", "\ufeff"]) + text, encoding="utf-8")
    sentence = refused("cal", "convert", path, "--out", folder / "out.h5")
    assert "log.csv" in sentence, sentence


# ---- calibrations --------------------------------------------------------------------------------


@group("gates: marks, copies and units of presses", 14, 3)
def _presses(chance: random.Random, folder: Path) -> None:
    from test_gates_everywhere import BALL_MM, COLUMNS, PX_PER_MM, N, good, write

    seed = chance.randrange(1000)
    circles = good(seed)
    kind = chance.choice(["far", "twice", "copies", "one place", "ball"])
    marked = circles
    if kind == "far":
        marked = [(x, y, chance.choice([1.3, 10.0, 1e6, 1e300]) * BALL_MM / 2 * PX_PER_MM) for x, y, _ in circles]
    elif kind == "twice":
        marked = [(x, y, chance.uniform(1.7, 2.0) * r) for x, y, r in circles]
    elif kind == "one place":
        circles = marked = [circles[0]] * N
    balls = write(folder / "balls", circles, marked, seed)
    if kind == "copies":
        lines = [COLUMNS]
        for i in range(chance.randrange(3, 40)):
            shutil.copy(balls / "0.png", balls / f"c{i}.png")
            lines.append(f"c{i}.png," + ",".join(f"{v:.5g}" for v in circles[0]))
        (balls / "presses.csv").write_text("\n".join(lines))
    ball = ["--ball-mm", str(BALL_MM * chance.choice([0.001, 0.3, 1000]))] if kind == "ball" else []
    out = folder / "a.safetensors"
    done = run_ruffini("cal", "photometric", balls, "--board", "gelslim", "--foreign", *ball, "--out", out)
    assert done.code in (1, 2), f"{kind}: exit code {done.code}"
    if done.code == 1:
        flashed = run_ruffini("cal", "flash", out)
        assert (flashed.code, "gates" in refusal_in(flashed.err)) == (4, True), flashed.err


@group("gates: moduli that a wrong unit makes", 200, 50)
def _moduli(chance: random.Random, folder: Path) -> None:
    from ruffini.boards import find_board
    from ruffini.calibrate.gates import gates_of_modulus, verdict
    from ruffini.calibrate.operator import Material, board_slab

    board = find_board(chance.choice(["gelslim", "gelsight-mini"]))
    slab = board_slab(board)
    unit = chance.choice([1 / 4.448, 1 / 9.807, 4.448, 9.807, 1e3, 1e-3])
    far = gates_of_modulus(Material(unit * chance.uniform(0.85, 1.15) * slab.modulus_pa, 0.48, 0.003), board)
    near = gates_of_modulus(Material(chance.uniform(0.6, 1.6) * slab.modulus_pa, 0.48, 0.003), board)
    assert verdict(far) == "failed: modulus", far
    assert verdict(near) == "passed", near


# ---- the store and the daemon ------------------------------------------------------------------


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
    from ruffini.demo.daemon import find_daemon

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
    from ruffini.demo.daemon import find_daemon

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


# ---- devices -------------------------------------------------------------------------------------


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
        with pytest.raises(RuffiniError, match="answers in place of" if is_swapped else ""):
            host.flash(chance.randbytes(chance.randrange(1, 9000)))


# ---- recordings ----------------------------------------------------------------------------------


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


# ---- what is kept --------------------------------------------------------------------------------


@group("the twin's cache: flipped bits", 200, 20)
def _cache(chance: random.Random, folder: Path) -> None:
    from ruffini.sim import cache

    values = np.random.default_rng(chance.randrange(9999)).normal(size=chance.randrange(1, 400))
    with mock.patch.dict(os.environ, XDG_CACHE_HOME=str(folder)):
        cache.cached_state("key", lambda: {"u": values})
        (path,) = cache.cache_folder().glob("states/*.npz")
        data = bytearray(path.read_bytes())
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data[: chance.choice([len(data), chance.randrange(len(data))])])
        np.testing.assert_array_equal(cache.cached_state("key", lambda: {"u": values})["u"], values)


@group("names, keys and errors", 24, 6)
def _smaller(chance: random.Random, folder: Path) -> None:
    kind = chance.choice(["name", "key", "json", "video"])
    if kind == "name":
        from told_sensor import ToldSensor, info_of

        from ruffini.boards import find_board

        serial = "".join(chance.choice("ab\x1b[31m\x07\r\x9b\u202e\0") for _ in range(9)) + "z"
        with ToldSensor([info_of(find_board("gelslim"))], lambda *_: {}, serial=serial) as device:
            done = run_ruffini("devices", port=device.port)
        assert done.code == 0, done.err
        assert not set(done.out + done.err) & set("\x1b\x07\r\x9b\u202e\0"), ascii(done.out)
    elif kind == "key":
        with mock.patch.dict(os.environ, RUFFINI_KEYS=str(folder)):
            name, other = f"k{chance.randrange(99)}", folder / "other"
            (folder / f"{name}{chance.choice(['.key', '.pub'])}").symlink_to(other)
            refused("key", "new", name)
            assert not other.exists(), "a key was written through a link"
    elif kind == "json":
        odd_file(chance, folder / "file")
        done = run_ruffini("cal", "show", folder / "file", "--json")
        said = json.loads(done.out)
        assert (said["exit_code"], bool(said["error"])) == (done.code, True), done
    else:
        path = folder / "video.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (320, 240))
        for i in range(30):
            writer.write(np.random.default_rng(i).integers(0, 255, (240, 320, 3), np.uint8))
        writer.release()
        data = path.read_bytes()
        path.write_bytes(data[: int(chance.uniform(0.1, 0.8) * len(data))])
        refused("track", path, "--board", "gelslim")
