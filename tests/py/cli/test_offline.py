"""track, depth and field: what is wrong with a file is one sentence and a code, and nothing is written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal_in
from small_board import SHAPE, Files, Run

from ruffini.calibrate import container


def assert_refused(result: tuple[int, str, str], code: int, *words: object) -> None:
    got, out, err = result
    assert got == code, err
    assert out == ""
    for word in words:
        assert str(word) in refusal_in(err)


def dent(frames: int = 2) -> np.ndarray:
    u = np.zeros((frames, *SHAPE))
    u[:, 3:6, 4:7, 2] = -0.2
    return u


# ---- field -----------------------------------------------------------------------------------------


@pytest.fixture
def field(files: Files, run: Run, tmp_path: Path):
    """`ruffini field` on an array or on the bytes of a file; results go to f.npy."""

    def run_field(displacement: np.ndarray | bytes, *words: object, calibration: Path = files.operator):
        path = tmp_path / "u.npy"
        if isinstance(displacement, bytes):
            path.write_bytes(displacement)
        else:
            np.save(path, displacement)
        return run(
            "offline", "field", "--calibration", calibration, "--board", files.folder, "--displacement", path,
            "--out", tmp_path / "f.npy", *words,
        )  # fmt: skip

    return run_field


def npy(header: str) -> bytes:
    """A .npy file that ends after its header."""
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def npz(tmp_path: Path) -> bytes:
    np.savez(tmp_path / "archive.npz", u=dent())
    return (tmp_path / "archive.npz").read_bytes()


def pickled(tmp_path: Path) -> bytes:
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], object), allow_pickle=True)
    return (tmp_path / "objects.npy").read_bytes()


@pytest.mark.parametrize(
    "make",
    [
        lambda p: b"",
        lambda p: b"\x93NUMPY",
        lambda p: b"no array",
        npz,
        pickled,
        lambda p: npy("{'descr': '<f8', 'fortran_order': False, 'shape': (10, 9, 11, 3)}"),
        lambda p: npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 9, 11, 3)}"),
        lambda p: npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 9, 11, 3)}"),
        lambda p: npy("[" * 5000),
    ],
    ids=["empty", "cut off", "text", "npz", "pickle", "no data", "endless", "negative", "deep"],
)
def test_field_of_what_is_no_array(make, field, tmp_path: Path) -> None:
    assert_refused(field(make(tmp_path)), 2, tmp_path / "u.npy")
    assert not (tmp_path / "f.npy").exists()


@pytest.mark.parametrize(
    ("array", "word"),
    [
        (np.zeros((2, 9, 11, 2)), "needs float"),
        (np.zeros(SHAPE), "needs float"),
        (np.zeros((1, 11, 9, 3)), "(frames, 9, 11, 3)"),
        (np.zeros((1, *SHAPE), complex), "complex128"),
        (np.zeros((1, *SHAPE), np.int64), "int64"),
        (np.full((1, *SHAPE), np.inf), "infinity"),
        (np.full((1, *SHAPE), -4.2), "4.096 mm"),
        (np.full((1, *SHAPE), 1e300), "4.096 mm"),
    ],
    ids=["two axes", "no frames", "turned", "complex", "integers", "infinity", "far", "very far"],
)
def test_field_of_a_wrong_array(array: np.ndarray, word: str, field, tmp_path: Path) -> None:
    assert_refused(field(array), 2, tmp_path / "u.npy", word)
    assert not (tmp_path / "f.npy").exists()


def test_field_does_not_depend_on_how_the_array_lies_in_memory(field, tmp_path: Path) -> None:
    results = []
    for u in (dent(), np.asfortranarray(dent()), dent().astype(">f8")):
        code, out, err = field(u, "--json")
        assert code == 0, err
        assert json.loads(out)["frames"] == 2
        results.append((tmp_path / "f.npy").read_bytes())
    assert results[0] == results[1] == results[2]


def test_field_of_no_frames_is_no_frames(field, tmp_path: Path) -> None:
    code, out, err = field(dent(0), "--json")
    assert code == 0, err
    assert json.loads(out) == {"file": str(tmp_path / "f.npy"), "frames": 0, "resultant_n": []}
    assert np.load(tmp_path / "f.npy").shape == (0, *SHAPE)


def test_field_writes_the_file_that_it_names(files: Files, run: Run, tmp_path: Path) -> None:
    np.save(tmp_path / "u.npy", dent())
    out = tmp_path / "new" / "force"  # neither an ending nor a folder
    code, text, err = run(
        "offline", "field", "--calibration", files.operator, "--board", files.folder, "--displacement",
        tmp_path / "u.npy", "--out", out, "--json",
    )  # fmt: skip
    assert code == 0, err
    assert json.loads(text)["file"] == str(out)
    assert np.load(out).shape == (2, *SHAPE)


def test_field_where_nothing_can_be_written(files: Files, run: Run, tmp_path: Path) -> None:
    np.save(tmp_path / "u.npy", dent())
    (tmp_path / "file").write_text("")
    result = run(
        "offline", "field", "--calibration", files.operator, "--board", files.folder, "--displacement",
        tmp_path / "u.npy", "--out", tmp_path / "file" / "f.npy",
    )  # fmt: skip
    assert_refused(result, 2, tmp_path / "file")


@pytest.mark.parametrize("verb", ["field", "depth"])
def test_a_calibration_that_names_no_board(verb: str, files: Files, run: Run, tmp_path: Path) -> None:
    file = container.read(files.calibration)
    metadata = {k: v for k, v in file.metadata.items() if k != "board"}
    path = tmp_path / "c.safetensors"
    container.write(path, container.pack(file.tensors, metadata))
    np.save(tmp_path / "u.npy", dent())
    words = {
        "field": ("--displacement", tmp_path / "u.npy", "--out", tmp_path / "f.npy"),
        "depth": (tmp_path / "u.npy",),
    }[verb]
    assert_refused(run("offline", verb, "--calibration", path, *words), 2, path, "board")


def test_field_and_depth_say_which_table_is_missing(files: Files, run: Run, field, tmp_path: Path) -> None:
    file = container.read(files.calibration)
    path = tmp_path / "colours.safetensors"
    colours = {k: v for k, v in file.tensors.items() if k.startswith("photometric.")}
    container.write(path, container.pack(colours, file.metadata))
    assert_refused(field(dent(), calibration=path), 2, "no operator", path)
    image = picture(tmp_path / "a.png")
    assert_refused(
        run("offline", "depth", "--calibration", files.operator, "--board", files.folder, image, "--reference", image),
        2, "no photometric table", files.operator,
    )  # fmt: skip


# ---- depth and track -------------------------------------------------------------------------------


def picture(path: Path, size: tuple[int, int] = (240, 320), level: int = 120) -> Path:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.full((*size, 3), level, np.uint8))
    return path


@pytest.fixture
def depth(files: Files, run: Run):
    return lambda *words: run("offline", "depth", "--calibration", files.calibration, "--board", files.folder, *words)


def test_depth_names_each_picture_that_does_not_fit(depth, tmp_path: Path) -> None:
    good, small = picture(tmp_path / "good.png"), picture(tmp_path / "small.png", (100, 320))
    text = tmp_path / "text.png"
    text.write_text("no picture")
    assert_refused(depth(small, "--reference", good), 2, small, "320x100")
    assert_refused(depth(good, "--reference", small), 2, small, "320x100")
    assert_refused(depth(text, "--reference", good), 2, text)
    assert_refused(depth(good, "--reference", tmp_path / "none.png"), 2, "none.png")


def test_depth_does_not_average_references_of_two_sizes(depth, tmp_path: Path) -> None:
    picture(tmp_path / "reference_0.png")
    other = picture(tmp_path / "reference_1.png", (100, 100))
    assert_refused(depth(picture(tmp_path / "a.png")), 2, other, "100x100")


def test_depth_does_not_write_two_pictures_to_one_file(depth, tmp_path: Path) -> None:
    one, two = picture(tmp_path / "1" / "a.png"), picture(tmp_path / "2" / "a.png")
    assert_refused(depth(one, two, "--reference", one, "--out", tmp_path / "out"), 2, "a.npy")
    assert not (tmp_path / "out").exists()


def test_depth_where_nothing_can_be_written(depth, tmp_path: Path) -> None:
    image = picture(tmp_path / "a.png")
    assert_refused(depth(image, "--reference", image, "--out", image), 2, image)


def test_track_of_a_pad_without_dots(files: Files, run: Run, tmp_path: Path) -> None:
    for i in range(12):
        picture(tmp_path / "video" / f"{i:02d}.png")
    out = tmp_path / "t.npz"
    result = run("offline", "track", tmp_path / "video", "--board", files.folder, "--out", out)
    assert_refused(result, 2, tmp_path / "video", "no markers")
    assert not out.exists()


def test_track_of_a_frame_of_another_size(files: Files, run: Run, tmp_path: Path) -> None:
    picture(tmp_path / "video" / "0.png", (100, 100))
    assert_refused(run("offline", "track", tmp_path / "video", "--board", files.folder), 2, "100x100")
