"""The calibration file of proto/CALIBRATION.md: write, sign, read, verify, merge."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, find_board
from ruffini.errors import InputError, RefusedError, VerifyError
from ruffini.files import readable, write_whole
from ruffini.older_python import UTC
from ruffini.version import __version__

Tensors = dict[str, npt.NDArray[np.generic]]
SIGNATURE = "zz_signature"
SIGNATURE_BYTES = 64
MAX_HEADER_BYTES = 65_536
MAX_RANK = 8


class Kind(NamedTuple):
    """A kind of tables. is_of_light: the manifest's `optics` are those that they were fitted with."""

    is_of_light: bool = False


KINDS = {
    "camera": Kind(),
    "contact": Kind(),
    "contact_depth": Kind(),
    "contact_model": Kind(),
    "dark": Kind(),
    "fingertip": Kind(),
    "finite_strain": Kind(),
    "gauge": Kind(),
    "marker_depth": Kind(),
    "operator": Kind(),
    "photometric": Kind(is_of_light=True),
    "relaxation": Kind(),
    "rest": Kind(),
    "skin": Kind(),
    "softness": Kind(),
    "support": Kind(),
    "views": Kind(),
    "wrench": Kind(),
}
PASSED, FAILED = "passed", "failed: "  # the manifest's gates: the report's verdict, or FAILED and names
DTYPES = {"U8": np.uint8, "I16": np.int16, "U16": np.uint16, "I32": np.int32}
# Anybody can derive this key: it proves integrity, not origin. STATUS says when it is in use.
DEVELOPMENT_SEED = hashlib.sha256(b"ruffini development key").digest()


@dataclass(frozen=True)
class CalibrationFile:
    """Tensors (without the signature) and metadata of one file."""

    tensors: Tensors
    metadata: dict[str, str]
    data: bytes = field(repr=False, default=b"")

    @property
    def sha256(self) -> bytes:
        return hashlib.sha256(self.data).digest()

    @property
    def kinds(self) -> list[str]:
        return [k for k in self.metadata.get("kinds", "").split(",") if k]


def base_metadata(board: Board, *, sensor_serial: str = "*", gel_serial: str = "*") -> dict[str, str]:
    """The manifest of a file for `board`, made now."""
    return {
        "format": "ruffini-calibration",
        "format_version": "1",
        "product": "ruffini",
        "board": board.name,
        "sensor_serial": sensor_serial,
        "gel_serial": gel_serial,
        "resolution": board.resolution,
        "optics": board.camera.optics,
        "version": "1",
        "security_epoch": "0",
        "created_utc": datetime.datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "tool_version": __version__,
        "inputs_sha256": hashlib.sha256(board.text.encode()).hexdigest(),
    }


def metadata_without_board() -> dict[str, str]:
    """The manifest of a file for a sensor that no board describes; it is judged on the host; no board accepts it."""
    created = datetime.datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "format": "ruffini-calibration", "format_version": "1", "product": "ruffini", "board": "none",
        "sensor_serial": "*", "gel_serial": "*", "resolution": "0x0", "optics": "none", "version": "1",
        "security_epoch": "0", "created_utc": created, "tool_version": __version__, "inputs_sha256": "",
    }  # fmt: skip


def pack(tensors: Tensors, metadata: dict[str, str], seed: bytes = DEVELOPMENT_SEED) -> CalibrationFile:
    """Lay out, sign and return a file.

    Parameters
    ----------
    seed : bytes
        32-byte Ed25519 seed; the public development key's unless given.

    Raises
    ------
    InputError
        A tensor of a type that the format does not have, or text beyond ASCII.
    """
    from nacl.signing import SigningKey

    key = SigningKey(seed)
    key_id = hashlib.sha256(bytes(key.verify_key)).hexdigest()[:8]
    kinds = sorted({name.split(".")[0] for name in tensors})
    manifest = {**metadata, "kinds": ",".join(kinds), "key_id": key_id}
    if not all(text.isascii() for pair in manifest.items() for text in pair):
        raise InputError("calibration metadata must be ASCII text")
    # Larger elements first keeps every tensor aligned without gaps.
    names = sorted(tensors, key=lambda n: (-tensors[n].dtype.itemsize, n))
    header: dict[str, object] = {"__metadata__": dict(sorted(manifest.items()))}
    chunks, offset = [], 0
    for name in names:
        array = np.ascontiguousarray(tensors[name])
        label = next((k for k, v in DTYPES.items() if array.dtype == v), None)
        if label is None:
            raise InputError(f"tensor {name} is {array.dtype}: the format has {', '.join(DTYPES)}")
        raw = array.astype(array.dtype.newbyteorder("<")).tobytes()
        header[name] = {
            "dtype": label,
            "shape": list(array.shape),
            "data_offsets": [offset, offset + len(raw)],
        }
        chunks.append(raw)
        offset += len(raw)
    header[SIGNATURE] = {
        "dtype": "U8", "shape": [SIGNATURE_BYTES], "data_offsets": [offset, offset + SIGNATURE_BYTES],
    }  # fmt: skip
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    body = struct.pack("<Q", len(text)) + text + b"".join(chunks)
    return CalibrationFile(tensors, manifest, body + key.sign(body).signature)


def unpack(data: bytes, where: str = "calibration file") -> CalibrationFile:
    """Read a file strictly; the signature is `verify`'s business.

    Raises
    ------
    InputError
        Whatever the format refuses: lengths, order, gaps, types, duplicate keys.
    """

    def refuse(what: str) -> InputError:
        return InputError(f"{where}: {what}: make or copy the file again")

    if len(data) < 8 + SIGNATURE_BYTES:
        raise refuse("is too short")
    (size,) = struct.unpack_from("<Q", data)
    if size > MAX_HEADER_BYTES or size > len(data) - 8 or size % 8:
        raise refuse(f"header length {size} makes no sense")

    def no_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
        keys = [k for k, _ in pairs]
        if len(set(keys)) != len(keys):
            raise refuse("duplicate keys in the header")
        return dict(pairs)

    try:
        header = json.loads(data[8 : 8 + size].decode("ascii"), object_pairs_hook=no_duplicates)
        metadata = dict(header.pop("__metadata__"))
        body = memoryview(data)[8 + size :]
        tensors: Tensors = {}
        offset = 0
        for name, entry in header.items():
            begin, end = entry["data_offsets"]
            dtype = np.dtype(DTYPES[entry["dtype"]])
            shape = entry["shape"]
            if any(type(n) is not int or n <= 0 for n in shape) or len(shape) > MAX_RANK:
                raise refuse(f"tensor {name} has no size")
            length = int(np.prod(shape, dtype=object)) * dtype.itemsize if shape else dtype.itemsize
            if begin != offset or end - begin != length or end > len(body):
                raise refuse(f"tensor {name} does not lie where the one before it ends")
            tensors[name] = np.frombuffer(body[begin:end], dtype).reshape(shape)
            offset = end
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise refuse(f"header is not that of a calibration ({error})") from error
    if offset != len(body) or not tensors:
        raise refuse("bytes after the last tensor, or a truncated file")
    if list(tensors)[-1] != SIGNATURE or tensors[SIGNATURE].nbytes != SIGNATURE_BYTES:
        raise refuse("the last tensor is not a 64 byte zz_signature")
    if not all(isinstance(v, str) for v in metadata.values()):
        raise refuse("metadata is not text")
    if (metadata.get("format"), metadata.get("format_version")) != ("ruffini-calibration", "1"):
        raise refuse("is not a ruffini calibration of format version 1")
    if "board" not in metadata:
        raise refuse("names no board")
    del tensors[SIGNATURE]
    file = CalibrationFile(tensors, metadata, data)
    for kind in set(file.kinds) - KINDS.keys():
        raise refuse(f'kind "{kind}" is unknown')
    for name in tensors:
        if name.split(".")[0] not in file.kinds:
            raise refuse(f"tensor {name} belongs to no kind that the file names")
    return file


def verify(file: CalibrationFile, public_key: bytes | None = None) -> None:
    """Check the signature against a 32-byte public key (the development key's unless given).

    Raises
    ------
    VerifyError
        The file was changed, or signed with another key.
    """
    from nacl.exceptions import BadSignatureError
    from nacl.signing import SigningKey, VerifyKey

    key = VerifyKey(public_key) if public_key else SigningKey(DEVELOPMENT_SEED).verify_key
    try:
        key.verify(file.data[:-SIGNATURE_BYTES], file.data[-SIGNATURE_BYTES:])
    except BadSignatureError as error:
        raise VerifyError(
            f"the signature does not fit (file says key {file.metadata.get('key_id')}): "
            "the file was changed, or signed with another key"
        ) from error


def check_board(file: CalibrationFile, board: Board) -> None:
    """Refuse a file for another board or resolution, in one sentence."""
    for what, theirs, ours in (
        ("board", file.metadata.get("board"), board.name),
        ("resolution", file.metadata.get("resolution"), board.resolution),
    ):
        if theirs != ours:
            raise RefusedError(f"calibration is for {what} {theirs!r}, this is {ours!r}: use the right file")


def board_of(file: CalibrationFile, choice: str | None = None) -> Board:
    """The board that was chosen, or else the one that the file names; refuses a file for another one."""
    board = find_board(choice or file.metadata["board"])
    check_board(file, board)
    return board


def read(path: Path) -> CalibrationFile:
    """Read and check the layout of a file on disk."""
    try:
        data = readable(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return unpack(data, str(path))


def write(path: Path, file: CalibrationFile) -> None:
    """Write a calibration file, whole or not at all."""
    write_whole(path, file.data)


def _merged_gates(files: list[CalibrationFile]) -> dict[str, str]:
    """`gates` and `residuals` of the whole: the last file's figures with the gates of all.

    Of a stage that several files have fitted, the last one's gates count, as its tables do.
    """
    trees = [residuals(file) for file in files]
    said = [file.metadata.get("gates", "") for file in files]
    rows, bad, later = list[Any](), list[str](), set[str]()
    for tree, text in zip(reversed(trees), reversed(said), strict=True):
        own = tree.get("gates", [])
        gone = [row for row in own if _stage_of(row) in later]
        rows = [row for row in own if row not in gone] + rows
        if text.startswith(FAILED):
            replaced = {row["name"] for row in gone if "name" in row}
            bad = [name for name in text.removeprefix(FAILED).split(", ") if name not in replaced] + bad
        later |= {stage for row in own if (stage := _stage_of(row))}
    out = {"residuals": json.dumps({**trees[-1], **({"gates": rows} if rows else {})})} if rows else {}
    if bad:
        return {**out, "gates": FAILED + ", ".join(dict.fromkeys(bad))}
    return {**out, "gates": PASSED} if all(text == PASSED or text.startswith(FAILED) for text in said) else out


def _stage_of(row: Any) -> str:
    """The estimator that a gate of a manifest is of; empty: it is of none, or no gate."""
    return str(row.get("stage", "")) if isinstance(row, dict) else ""


def residuals(file: CalibrationFile) -> dict[str, Any]:
    """The report that a file carries; empty where it has none that can be read."""
    with contextlib.suppress(ValueError):
        tree = json.loads(file.metadata.get("residuals", "{}"))
        if isinstance(tree, dict) and isinstance(tree.get("gates", []), list):
            return tree
    return {}


def merge(files: list[CalibrationFile], seed: bytes = DEVELOPMENT_SEED) -> CalibrationFile:
    """One file with the kinds of all; where two bring the same kind, the later one wins.

    The optics are those of the file that brings the photometric table; gates are those of all files, and a file that
    nobody has judged leaves the whole unjudged.

    Raises
    ------
    RefusedError
        Files for different boards, resolutions or sensors.
    """
    tensors: Tensors = {}
    metadata: dict[str, str] = {}
    optics = files[0].metadata.get("optics", "")
    for file in files:
        for key in ("board", "resolution", "sensor_serial", "gel_serial"):
            if metadata and metadata.get(key) != file.metadata.get(key):
                raise RefusedError(
                    f"the files are for different {key}: {metadata.get(key)!r} and {file.metadata.get(key)!r}"
                )
        for kind in file.kinds:
            tensors = {k: v for k, v in tensors.items() if not k.startswith(kind + ".")}
            metadata = {k: v for k, v in metadata.items() if not k.startswith(kind + ".")}
        tensors.update(file.tensors)
        metadata.update(file.metadata)
        if any(KINDS[kind].is_of_light for kind in file.kinds):
            optics = file.metadata.get("optics", "")
    metadata["optics"] = optics
    metadata = {**{k: v for k, v in metadata.items() if k != "gates"}, **_merged_gates(files)}
    return pack(tensors, metadata, seed)
