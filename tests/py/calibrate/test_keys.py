"""Owners' keys: made once, kept to their owner, and no signature fits by luck."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.calibrate import container, keys
from ruffini.errors import InputError, VerifyError


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RUFFINI_KEYS", str(tmp_path / "keys"))
    return tmp_path / "keys"


@pytest.fixture
def file() -> container.CalibrationFile:
    return container.pack(
        {"rest.image": np.arange(8, dtype=np.uint8)},
        {"board": "any", "format": "ruffini-calibration", "format_version": "1"},
    )


def test_a_key_signs_and_only_its_owner_can_read_it(folder: Path, file: container.CalibrationFile) -> None:
    key = keys.make("lab")
    assert (folder / "lab.key").stat().st_mode & 0o777 == 0o600
    signed = keys.sign(file, "lab")
    assert signed.metadata["key_id"] == key.key_id
    assert keys.verify(signed) == "lab"
    assert keys.verify(file) == "development key"
    with pytest.raises(VerifyError, match=key.key_id):
        container.verify(signed)  # the development key's it is not
    changed = container.CalibrationFile(signed.tensors, signed.metadata, signed.data[:-70] + b"x" + signed.data[-69:])
    with pytest.raises(VerifyError, match="signature does not fit"):
        keys.verify(changed)


def test_a_spoilt_file_is_named_before_it_is_signed_anew(tmp_path: Path) -> None:
    path = tmp_path / "spoilt.safetensors"
    metadata = {**container.base_metadata(find_board("gelslim")), "kinds": "rest"}
    file = container.pack({"rest.image": np.arange(8, dtype=np.uint8)}, metadata)
    path.write_bytes(file.data.replace(bytes(range(8)), bytes(range(1, 9))))
    with pytest.raises(VerifyError, match=r"spoilt\.safetensors: the signature does not fit"):
        keys.read_verified(path)
    path.write_bytes(file.data)
    assert keys.read_verified(path).data == file.data


def test_where_only_the_public_half_is_files_are_checked_and_not_signed(
    folder: Path, file: container.CalibrationFile
) -> None:
    keys.make("lab")
    signed = keys.sign(file, "lab")
    (folder / "lab.key").unlink()
    assert [(k.name, k.can_sign) for k in keys.known()] == [("lab", False)]
    assert keys.verify(signed) == "lab"
    with pytest.raises(InputError, match="only the public half"):
        keys.sign(file, "lab")


def test_a_name_that_is_taken_or_none_is_refused(folder: Path) -> None:
    keys.make("lab")
    before = (folder / "lab.key").read_text()
    with pytest.raises(InputError, match="already"):
        keys.make("lab")
    assert (folder / "lab.key").read_text() == before
    for name in ("", "../lab", "a/b", ".hidden", "a" * 64):
        with pytest.raises(InputError, match="no name of a key"):
            keys.make(name)
    with pytest.raises(InputError, match="which has lab"):
        keys.find("other")


def test_what_is_no_key_is_named(folder: Path) -> None:
    keys.make("lab")
    for text in ("", "zz" * 32, "ab" * 31):
        (folder / "lab.pub").write_text(text)
        with pytest.raises(InputError, match=r"lab\.pub: no key"):
            keys.known()
    (folder / "lab.pub").write_text("ab" * 32)
    with pytest.raises(InputError, match="cannot be written"):
        keys.enrol("lab", folder / "lab.key" / "below a file")


def test_an_owner_says_what_a_file_may_follow(file: container.CalibrationFile) -> None:
    keys.make("lab")
    changes = {"version": "7", "security_epoch": "2", "sensor_serial": "0042", "allow_older": "1"}
    signed = container.unpack(keys.sign(file, "lab", changes).data)
    assert keys.verify(signed) == "lab"
    assert {key: signed.metadata[key] for key in changes} == changes
    assert keys.verify(keys.sign(signed, None, {"version": "8"})) == "development key"


def test_a_full_disk_leaves_no_half_of_a_key(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InputError, match="No space left"):
        keys.make("lab")
    assert list(folder.iterdir()) == []
    monkeypatch.undo()
    monkeypatch.setenv("RUFFINI_KEYS", str(folder))
    assert keys.make("lab").can_sign


@pytest.mark.parametrize("half", ["lab.key", "lab.pub"])
def test_a_key_is_not_written_through_a_link(folder: Path, tmp_path: Path, half: str) -> None:
    folder.mkdir()
    (folder / half).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="has a key lab already"):
        keys.make("lab")
    assert not (tmp_path / "elsewhere").exists()


def test_enrolling_replaces_a_link_and_not_its_target(folder: Path, tmp_path: Path) -> None:
    key, card = keys.make("lab"), tmp_path / "card"
    card.mkdir()
    (tmp_path / "precious").write_text("precious")
    (card / "lab.pub").symlink_to(tmp_path / "precious")
    assert bytes.fromhex(keys.enrol("lab", card).read_text()) == key.public
    assert (tmp_path / "precious").read_text() == "precious"
