"""The stereo paper's network at work on the host, through OpenCV: no PyTorch needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

METADATA_PROPS = 14
VARINT, BYTES = 0, 2  # wire types


@dataclass(frozen=True)
class Told:
    """values (n,) in the order of the network's outputs; is_valid : finite, and within what the network was taught."""

    values: Array
    is_valid: bool


class StereoNetwork:
    """The network of one board.

    Raises
    ------
    InputError
        No such file, none of ours, or one of another board.
    """

    def __init__(self, path: Path, board: Board) -> None:
        import cv2

        if not path.is_file():
            raise InputError(f"{path}: no such network: `ruffini train stereo --board {board.name}` makes one")
        self.metadata = metadata_of(path)
        size = f"{board.camera.width_px}x{board.camera.height_px}"
        if self.metadata.get("ruffini.board") != board.name or self.metadata.get("ruffini.resolution") != size:
            raise InputError(
                f"{path} is a network for board {self.metadata.get('ruffini.board')!r} and pictures of "
                f"{self.metadata.get('ruffini.resolution')}, not for {board.name!r} and {size}: train its own"
            )
        self.outputs = self.metadata["ruffini.outputs"].split(",")
        self._low, self._high = (
            np.array(self.metadata[f"ruffini.{end}"].split(","), dtype=float) for end in ("low", "high")
        )
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            raise InputError(f"{path}: no ONNX network that OpenCV can run: export it again") from error

    def raw(self, picture: npt.NDArray[np.uint8]) -> Array:
        """What the network says of a frame (h, w, 3), B G R."""
        self._net.setInput(np.moveaxis(picture, -1, 0)[None].astype(np.float32))
        return np.asarray(self._net.forward()[0], dtype=np.float64)

    def __call__(self, picture: npt.NDArray[np.uint8]) -> Told:
        """The same, and whether it was taught such."""
        values = self.raw(picture)
        inside = (values >= self._low) & (values <= self._high)  # NaN is not
        return Told(values, bool(inside.all()))


def metadata_of(path: Path) -> dict[str, str]:
    """metadata_props of an ONNX file (field 14 of ModelProto: key 1, value 2), without reading the weights.

    Raises
    ------
    InputError
        The file is none.
    """
    found: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            for number, size in _fields(file):
                if number == METADATA_PROPS:
                    entry = BytesIO(file.read(size))
                    parts = [entry.read(n).decode("utf-8") for _, n in _fields(entry)]
                    found[parts[0]] = parts[1]
                else:
                    file.seek(size, 1)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"{path}: no ONNX network: export it again") from error
    return found


def _fields(file: IO[bytes]) -> Iterator[tuple[int, int]]:
    """Number and size of each field of a protobuf message; numbers that are no bytes are passed over."""
    while (tag := _varint(file)) is not None:
        number, wire = tag >> 3, tag & 7
        if wire == VARINT:
            _varint(file)
        elif wire == BYTES and (size := _varint(file)) is not None:
            yield number, size
        else:
            raise ValueError(f"wire type {wire}")


def _varint(file: IO[bytes]) -> int | None:
    """None at the end of the file."""
    value = 0
    for shift in range(0, 70, 7):
        byte = file.read(1)
        if not byte:
            return None
        value |= (byte[0] & 0x7F) << shift
        if byte[0] < 0x80:
            return value
    raise ValueError("no number")
