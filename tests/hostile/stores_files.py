"""Hostile files, tables, presses of a calibration, keys and names."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("support", "e2e", "py/calibrate", "hostile")]

import cv2  # noqa: E402
import h5py  # noqa: E402
import numpy as np  # noqa: E402
from cases import group, refused  # noqa: E402
from command_line import refusal_in, run_ruffini  # noqa: E402
from touch_log_file import write_log  # noqa: E402

READERS = (
    ("cal", "file", "show", "{}"), ("cal", "file", "verify", "{}"),
     ("cal", "file", "merge", "{}", "--out", "{}.out"), ("cal", "flash", "{}"),
    ("export", "{}", "--out", "{}.csv"), ("plot", "{}", "--out", "{}.html"), ("recover", "{}", "{}.mcap"),
    ("replay", "--text", "{}"), ("cal", "convert", "{}", "--out", "{}.h5"),
    ("cal", "fit", "--board", "gelslim", "{}", "--out", "{}.o"),
    ("cal", "fit", "--only", "operator", "--board", "gelslim", "--material", "{}", "--out", "{}.out"),
    ("cal", "fit", "--only", "operator", "--board", "gelslim", "--relaxation", "{}", "--out", "{}.out"),
    ("cal", "report", "{}", "--log", "{}", "--out", "{}.html"),
    ("cal", "fit", "--only", "photometric", "{}", "--board", "gelslim", "--out", "{}.o"),
    ("cal", "fit", "--only", "wrench", "{}", "--time", "t", "--features", "f*",
     "--wrench", "a,b,c,d,e,g", "--out", "{}.o"),
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
    name = chance.choice(list(ARRAYS))

    def spoil(_: h5py.File, touch: h5py.Group) -> None:
        del touch[name]
        rows_there = 1 << chance.randrange(33, 50)
        ways: list[Callable[[], Any]] = [
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
        chance.choice(ways)()

    write_log(path, n, spoil)
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
    done = run_ruffini(
        "cal", "fit", "--only", "photometric", balls, "--board", "gelslim", "--foreign", *ball, "--out", out
    )
    assert done.code in (1, 2), f"{kind}: exit code {done.code}"
    if done.code == 1:
        flashed = run_ruffini("cal", "flash", out)
        assert (flashed.code, "gates" in refusal_in(flashed.err)) == (4, True), flashed.err


@group("gates: moduli that a wrong unit makes", 200, 50)
def _moduli(chance: random.Random, folder: Path) -> None:
    from ruffini.boards import find_board
    from ruffini.calibrate.gates import verdict
    from ruffini.estimators.material.judge import gates_of_modulus
    from ruffini.estimators.operator.fit import Material, board_slab

    board = find_board(chance.choice(["gelslim", "gelsight-mini"]))
    slab = board_slab(board)
    unit = chance.choice([1 / 4.448, 1 / 9.807, 4.448, 9.807, 1e3, 1e-3])
    far = gates_of_modulus(Material(unit * chance.uniform(0.85, 1.15) * slab.modulus_pa, 0.48, 0.003), board)
    near = gates_of_modulus(Material(chance.uniform(0.6, 1.6) * slab.modulus_pa, 0.48, 0.003), board)
    assert verdict(far) == "failed: modulus", far
    assert verdict(near) == "passed", near


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
        done = run_ruffini("cal", "file", "show", folder / "file", "--json")
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
        refused("offline", "track", path, "--board", "gelslim")
