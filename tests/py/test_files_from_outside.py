"""Files that nobody should have given: pipes, devices, huge and spoilt ones. Each is refused in one true sentence."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from command_line import refusal_in, run_ruffini
from touch_log_file import Spoil, write_log

from ruffini.calibrate.log.columns import Columns, read_column_logs
from ruffini.calibrate.log.reference import read_wrench_csv
from ruffini.errors import InputError
from ruffini.estimators.material.fit import log_of_touches
from ruffini.files import readable
from ruffini.frames import read_frames
from ruffini.rig.convert import convert
from ruffini.rig.csv_log import read_csv_log
from ruffini.rig.log_file import read_log

N = 5


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe.h5")
    return tmp_path / "pipe.h5"


@pytest.mark.parametrize(
    "words",
    [
        ("cal", "file", "show", "{}"), ("cal", "file", "verify", "{}"),
         ("cal", "file", "merge", "{}", "{}", "--out", "{}.out"),
        ("cal", "flash", "{}"), ("export", "{}", "--out", "{}.csv"), ("plot", "{}"), ("recover", "{}", "{}.mcap"),
        ("replay", "--text", "{}"),
        ("cal", "fit", "--only", "operator", "--board", "gelslim", "--material", "{}", "--out", "{}.out"),
        ("cal", "fit", "--board", "gelslim", "{}", "--out", "{}.out"),
        ("cal", "report", "{}", "--log", "{}", "--out", "{}.html"),
        ("cal", "convert", "{}", "--out", "{}.h5"),
    ],
)  # fmt: skip
def test_a_pipe_is_not_waited_for(pipe: Path, words: tuple[str, ...]) -> None:
    done = run_ruffini(*(word.format(pipe) for word in words))
    assert done.code == 2
    assert "is a pipe, a socket or a device" in done.err


def test_what_is_read_whole_has_a_limit(tmp_path: Path) -> None:
    huge = tmp_path / "huge.safetensors"
    with huge.open("wb") as file:
        file.truncate(200 << 30)  # sparse: takes no room
    done = run_ruffini("cal", "file", "show", huge)
    assert (done.code, refusal_in(done.err)) == (
        2, f"ruffini: {huge} has 200.0 GiB, more than 1 GiB: is it the right file?",
    )  # fmt: skip
    assert readable(huge, None) == huge
    with pytest.raises(InputError, match="is a pipe, a socket or a device"):
        readable(Path("/dev/zero"))


def put(name: str, **how: Any) -> Spoil:
    """A dataset in the place of an array."""

    def spoil(_: h5py.File, touch: h5py.Group) -> None:
        touch.pop(name, None)
        touch.create_dataset(name, **how)

    return spoil


def link(name: str, to: Any) -> Spoil:
    def spoil(_: h5py.File, touch: h5py.Group) -> None:
        del touch[name]
        touch[name] = to

    return spoil


def touches(to: Any) -> Spoil:
    def spoil(file: h5py.File, _: h5py.Group) -> None:
        del file["touch"]
        file["touch"] = to

    return spoil


def attribute(name: str, value: Any) -> Spoil:
    return lambda file, _: file.attrs.__setitem__(name, value)


SPOILT: dict[str, Spoil] = {
    "2^40 rows": put("stream_s", shape=(1 << 40,), chunks=(1 << 20,), dtype="f8"),
    "2^40 rows of six": put("stream_wrench", shape=(1 << 40, 6), chunks=(1 << 18, 6), dtype="f8"),
    "a group for an array": link("stream_s", h5py.SoftLink("/touch")),
    "a link that leads nowhere": link("stage_s", h5py.SoftLink("/nothing")),
    "a link to itself": link("stage_s", h5py.SoftLink("/touch/00000/stage_s")),
    "a link to a file that is not there": link("reference_s", h5py.ExternalLink("/nothing.h5", "/x")),
    "text": put("stream_s", data=[b"a"] * N),
    "one number": put("stream_s", data=1.0),
    "nothing": put("stream_s", data=h5py.Empty("f8")),
    "complex numbers": put("reference_s", data=np.zeros(N, complex)),
    "an empty reference": lambda file, touch: [
        put(name, shape=(0, 6)[: 1 + (name == "reference_wrench")], dtype="f8")(file, touch)
        for name in ("reference_s", "reference_wrench")
    ],
    "an array for the touches": touches(np.zeros(3)),
    "a touch that is the whole file": touches(h5py.SoftLink("/")),
    "facts that are a list": attribute("facts", "[1]"),
    "facts that are a number": attribute("facts", 5),
    "facts that are deep": attribute("facts", "[" * 100_000),
    "found that is a list": attribute("found", "[]"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_log_is_refused(tmp_path: Path, name: str) -> None:
    path = write_log(tmp_path / "log.h5", N, SPOILT[name])
    with pytest.raises(InputError, match=r"log\.h5"):
        read_log(path)


def test_a_whole_log_is_read_whatever_else_is_in_it(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log.h5", N, put("others", shape=(1 << 40,), chunks=(1 << 20,), dtype="f8"))
    assert len(read_log(path).touches) == 1


def test_columns_of_hdf5_have_a_limit(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("t", shape=(1 << 40,), chunks=(1 << 20,), dtype="f8")
    columns = Columns(time="t", features=("t",), wrench=("t",) * 6)
    with pytest.raises(InputError, match=r"log\.h5: t has 1\.1e\+12 values, more than 4 GiB"):
        read_column_logs([tmp_path / "log.h5"], columns)


HEADER = "time_s,fz_N,m0_dx_px,m0_dy_px"
ROWS = [f"{0.1 * i:.1f},{-i % 3},0.1,0.2" for i in range(9)]


def csv_of(path: Path, text: str) -> Path:
    path.write_bytes(text.encode("utf-8"))
    return path


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    plain = read_csv_log(csv_of(tmp_path / "a.csv", "\n".join([HEADER, *ROWS])))
    marked = read_csv_log(csv_of(tmp_path / "b.csv", "\ufeff" + "\r\n".join([HEADER, *ROWS, ""])))
    np.testing.assert_array_equal(marked.time_s, plain.time_s)
    np.testing.assert_array_equal(marked.wrench, plain.wrench)
    wrench = read_wrench_csv(csv_of(tmp_path / "c.csv", "\ufefffx,fy,fz,tx,ty,tz\n1,2,3,4,5,nan\n"))
    np.testing.assert_array_equal(wrench, [[1, 2, 3, 4e-3, 5e-3, np.nan]])


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (["0,1,-1,0.1,0.2", "0,2,-1,0.1,0.2"], "row 2 has 5 cells, the header 4: is a comma the decimal mark"),
        (["0.1,-1,0.1"], "row 2 has 3 cells, the header 4: complete or delete it"),
        ([], "has 0 rows of numbers"),
    ],
)
def test_rows_of_another_length_are_named(tmp_path: Path, rows: list[str], words: str) -> None:
    path = csv_of(tmp_path / "log.csv", "\n".join([HEADER, *rows]))
    with pytest.raises(InputError, match=words):
        read_csv_log(path)
    if rows:
        with pytest.raises(InputError, match=words):
            read_column_logs([path], Columns(time="time_s", features=("m0_dx_px",), wrench=("fz_N",) * 6))


@pytest.mark.parametrize(
    ("text", "words"),
    [("", "is empty"), ("\n\n", "is empty"), ("fx,fy,fz,tx,ty,tz\n", "has no row of numbers"),
     ("fx,fy,fz,tx,ty,tz\n1;2;3;4;5;6\n", "row 2 has 1 cells"), ("fx,fy,fz,tx,ty,tz\n1,2,x,4,5,6\n", "fz: a cell"),
     ("fx,fy,fz\n1,2,3\n", "lacks the columns tx, ty, tz")],
)  # fmt: skip
def test_an_empty_or_odd_reference_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_wrench_csv(csv_of(tmp_path / "wrench.csv", text))


def test_numbers_of_markers_are_not_believed(tmp_path: Path) -> None:
    log = csv_of(tmp_path / "log.csv", "\n".join([HEADER, *ROWS]))
    for said in ("n_markers = 1000000000", "n_markers = -1", 'n_markers = "3"', "n_markers = 2.5", 'first = "x"'):
        columns = csv_of(tmp_path / "columns.toml", f'{said}\n[columns]\n"m{{i}}_dx_px" = "dx{{i}}"\n')
        with pytest.raises(InputError, match="n_markers and first are whole numbers, n_markers at most 100000"):
            convert(log, columns)
    far = csv_of(tmp_path / "far.csv", "\n".join([HEADER.replace("m0", "m999999999"), *ROWS]))
    with pytest.raises(InputError, match="marker 0 has no column m0_dx"):
        convert(far)


def test_half_a_video_is_not_a_shorter_one(tmp_path: Path) -> None:
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (64, 48))
    for i in range(40):
        writer.write(np.random.default_rng(i).integers(0, 255, (48, 64, 3), np.uint8))
    writer.release()
    whole = path.read_bytes()
    assert sum(1 for _ in read_frames(path)) == 40
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"video\.avi: (ends after \d+ of 40 frames|cannot be read as a video)"):
        list(read_frames(path))


def test_too_few_pictures_for_rest_are_counted(tmp_path: Path) -> None:
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((240, 320, 3), 120, np.uint8))
    done = run_ruffini("offline", "track", tmp_path, "--board", "gelslim")
    assert done.code == 2
    assert f"{tmp_path} has 3 pictures, rest is learned from" in refusal_in(done.err)


def test_a_touch_with_nan_is_named() -> None:
    wrench = np.tile([0.0, 0, -1, 0, 0, 0], (6, 1))
    displacement = np.zeros((6, 4, 3))
    displacement[3] = np.nan
    with pytest.raises(InputError, match="1 frames of touch 1 hold NaN or infinity"):
        log_of_touches(displacement, wrench, np.arange(6) // 2)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000])
def test_brackets_without_end(tmp_path: Path, text: str) -> None:
    path = csv_of(tmp_path / "deep.json", text)
    for option in ("--material", "--relaxation"):
        done = run_ruffini(
            "cal", "fit", "--only", "operator", "--board", "gelslim", option, path, "--out", tmp_path / "o"
        )
        assert done.code == 2, done.err
        refusal_in(done.err)


def test_json_of_a_refusal_is_one_object(pipe: Path) -> None:
    done = run_ruffini("cal", "file", "show", pipe, "--json")
    assert json.loads(done.out)["exit_code"] == 2
