"""Owners' signing keys: Ed25519 seeds that stay on the host, and the public halves that a sensor is given.

A key NAME is two files of 64 hexadecimal digits in RUFFINI_KEYS, else ~/.config/ruffini/keys: NAME.key, which only its
owner may read, and NAME.pub. No key on a sensor can sign.
"""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import Path

from ruffini.calibrate import container
from ruffini.errors import InputError, VerifyError
from ruffini.files import readable, write_new, write_whole

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
KEY_BYTES = 32


@dataclass(frozen=True)
class Key:
    """A public key and what is known of it."""

    name: str
    public: bytes
    can_sign: bool

    @property
    def key_id(self) -> str:
        """The first eight digits of its SHA-256, as calibrations and sensors name it."""
        return hashlib.sha256(self.public).hexdigest()[:8]


def folder() -> Path:
    """Where keys are kept."""
    return Path(os.environ.get("RUFFINI_KEYS") or Path.home() / ".config" / "ruffini" / "keys")


def known() -> list[Key]:
    """Every key whose public half is there.

    Raises
    ------
    InputError
        A file that is no key.
    """
    paths = sorted(folder().glob("*.pub")) if folder().is_dir() else []
    return [Key(p.stem, _read(p), p.with_suffix(".key").is_file()) for p in paths]


def make(name: str) -> Key:
    """A new key.

    Raises
    ------
    InputError
        The name is taken, or no name; the folder cannot be written.
    """
    from nacl.signing import SigningKey

    if not NAME.fullmatch(name):
        raise InputError(f"{name!r} is no name of a key: give letters, digits, '.', '_' and '-'")
    secret, public = folder() / f"{name}.key", folder() / f"{name}.pub"
    if os.path.lexists(secret) or os.path.lexists(public):
        raise InputError(f"{folder()} has a key {name} already: choose another name")
    made = SigningKey.generate()
    try:
        folder().mkdir(parents=True, exist_ok=True, mode=0o700)
        write_new(public, bytes(made.verify_key).hex().encode() + b"\n")
        try:
            write_new(secret, bytes(made).hex().encode() + b"\n", mode=0o600)
        except OSError:
            public.unlink()
            raise
    except OSError as error:
        raise InputError(f"{folder()}: cannot be written: {error.strerror}") from error
    return Key(name, bytes(made.verify_key), can_sign=True)


def enrol(name: str, into: Path) -> Path:
    """Put the public half where a sensor reads its keys (`ruffinid --keys`): a mounted card, or the sensor itself.

    Raises
    ------
    InputError
        There is no such key, or the folder cannot be written.
    """
    key = find(name)
    target = into / f"{name}.pub"
    write_whole(target, key.public.hex().encode() + b"\n")
    return target


def find(name: str) -> Key:
    """The key of that name.

    Raises
    ------
    InputError
        There is none; the text lists those there are.
    """
    keys = {key.name: key for key in known()}
    if name not in keys:
        raise InputError(f"no key {name!r} in {folder()}, which has {', '.join(keys) or 'none'}: `ruffini key new`")
    return keys[name]


def sign(
    file: container.CalibrationFile, name: str | None, changes: dict[str, str] | None = None
) -> container.CalibrationFile:
    """The same tables, signed by an owner's key; None: the public development key.

    Parameters
    ----------
    changes : dict
        Keys of the manifest (proto/CALIBRATION.md) that the owner sets.

    Raises
    ------
    InputError
        There is no such key, or only its public half.
    """
    seed = secret(name) if name else container.DEVELOPMENT_SEED
    return container.pack(file.tensors, {**file.metadata, **(changes or {})}, seed=seed)


def secret(name: str) -> bytes:
    """The seed of a key.

    Raises
    ------
    InputError
        There is no such key, or only its public half.
    """
    if not find(name).can_sign:
        raise InputError(f"of key {name} only the public half is in {folder()}: sign where {name}.key is")
    return _read(folder() / f"{name}.key")


def verify(file: container.CalibrationFile) -> str:
    """Check the signature; the name of the key, or "development key".

    Raises
    ------
    VerifyError
        The file was changed, or signed with a key that is not known here.
    """
    key = next((k for k in known() if k.key_id == file.metadata.get("key_id")), None)
    container.verify(file, key.public if key else None)
    return key.name if key else "development key"


def read_verified(path: Path) -> container.CalibrationFile:
    """Read a file whose data is to be signed again: a new signature would hide damage.

    Raises
    ------
    VerifyError
        As `verify`, naming the file.
    """
    file = container.read(path)
    try:
        verify(file)
    except VerifyError as error:
        raise VerifyError(f"{path}: {error}") from error
    return file


def _read(path: Path) -> bytes:
    try:
        data = bytes.fromhex(readable(path).read_text().strip())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no key of 64 hexadecimal digits: remove it, or copy it again") from error
    if len(data) != KEY_BYTES:
        raise InputError(f"{path}: no key of 64 hexadecimal digits: remove it, or copy it again")
    return data
