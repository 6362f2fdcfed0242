"""The calibration file: what is written is read, what is spoilt is refused with its reason."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load as load_with_library

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.errors import InputError, RefusedError, RuffiniError, VerifyError

TENSORS = {
    "operator.entry": np.arange(4 * 32, dtype=np.int16).reshape(4, 32),
    "operator.shift": np.zeros((4, 1), np.uint8),
    "support.scale": np.arange(4, dtype=np.int32),
}


@pytest.fixture
def file() -> container.CalibrationFile:
    return container.pack(TENSORS, {**container.base_metadata(find_board("gelslim")), "operator.out_shift": "4"})


def header_of(data: bytes) -> dict[str, object]:
    return json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])


def with_header(data: bytes, header: dict[str, object]) -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data[8 + int.from_bytes(data[:8], "little") :]


def test_round_trip_and_the_reference_reader_agrees(file: container.CalibrationFile) -> None:
    again = container.unpack(file.data)
    container.verify(again)
    assert again.metadata == file.metadata
    by_library = load_with_library(file.data)
    for name, values in TENSORS.items():
        np.testing.assert_array_equal(again.tensors[name], values)
        np.testing.assert_array_equal(by_library[name], values)


def test_the_same_input_gives_the_same_bytes() -> None:
    metadata = {**container.base_metadata(find_board("gelslim")), "created_utc": "2026-11-21T00:00:00Z"}
    assert container.pack(TENSORS, metadata).data == container.pack(dict(reversed(TENSORS.items())), metadata).data


def test_every_flipped_bit_is_refused(file: container.CalibrationFile) -> None:
    data = bytearray(file.data)
    for at in range(len(data)):
        data[at] ^= 1 << at % 8
        with pytest.raises((InputError, VerifyError)):
            container.verify(container.unpack(bytes(data)))
        data[at] ^= 1 << at % 8


def test_every_truncation_is_refused(file: container.CalibrationFile) -> None:
    for n in range(0, len(file.data), 7):
        with pytest.raises(InputError):
            container.unpack(file.data[:n])
    with pytest.raises(InputError):
        container.unpack(file.data + b"\0")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda h: h["operator.entry"].update(dtype="F32"), "F32"),
        (lambda h: h["operator.entry"].update(shape=[4, 31]), "operator.entry"),
        (lambda h: h["operator.entry"].update(shape=[-4, -32]), "operator.entry"),
        (lambda h: h["operator.entry"].update(data_offsets=[0, 10**30]), "operator.entry"),
        (lambda h: h["operator.entry"].update(shape=["4", "32"]), "operator.entry"),
        (lambda h: h["__metadata__"].update(kinds="magic,operator,support"), "magic"),
        (lambda h: h["__metadata__"].update(kinds="operator"), "support.scale"),
        (lambda h: h.pop("__metadata__"), "metadata"),
        (lambda h: h["__metadata__"].update(format="other"), "format"),
        (lambda h: h["__metadata__"].update(format_version="2"), "version"),
    ],
    ids=["float", "shape", "negative", "offset", "text", "kind", "stray", "no metadata", "format", "version"],
)
def test_what_the_format_does_not_have(file: container.CalibrationFile, change: object, words: str) -> None:
    header = header_of(file.data)
    change(header)  # type: ignore[operator]
    with pytest.raises(InputError, match=words):
        container.unpack(with_header(file.data, header), "some.file")


def test_another_key_is_refused(file: container.CalibrationFile) -> None:
    other = container.pack(TENSORS, dict(file.metadata), seed=bytes(32))
    with pytest.raises(VerifyError, match="signature"):
        container.verify(other)


def test_another_board_and_other_optics_are_named(file: container.CalibrationFile) -> None:
    with pytest.raises(RefusedError, match=r"gelslim.*gelsight-mini"):
        container.check_board(file, find_board("gelsight-mini"))


def test_merge_keeps_what_the_later_file_says(file: container.CalibrationFile) -> None:
    newer = container.pack(
        {**TENSORS, "operator.shift": np.ones((4, 1), np.uint8)}, {**file.metadata, "operator.out_shift": "5"}
    )
    colours = container.pack(
        {"photometric.unmix": np.zeros((13, 17, 2, 3), np.int16)}, container.base_metadata(find_board("gelslim"))
    )
    merged = container.merge([file, newer, colours])
    container.verify(merged)
    assert merged.metadata["operator.out_shift"] == "5"
    assert set(merged.kinds) >= {"operator", "photometric"}
    np.testing.assert_array_equal(merged.tensors["operator.shift"], 1)


def test_merge_refuses_files_of_two_boards(file: container.CalibrationFile) -> None:
    other = container.pack(TENSORS, container.base_metadata(find_board("gelsight-mini")))
    with pytest.raises(RuffiniError, match="board"):
        container.merge([file, other])


def test_write_is_whole_or_not_at_all(
    file: container.CalibrationFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.safetensors"
    container.write(path, file)
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match="No space left"):
        container.write(path, file)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.safetensors"):
        container.read(tmp_path / "nothing.safetensors")
