"""A trained displacement network at work, through OpenCV: no PyTorch needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.train.presses import Picture, shrink_factor, shrunk

Array = npt.NDArray[np.float64]


class DisplacementNetwork:
    """The network of one board.

    Parameters
    ----------
    path : what `ruffini train displacement` exported.
    rest : (h, w, 3) untouched picture, B G R, as the camera gives it.

    Raises
    ------
    InputError
        No ONNX file, or one for another picture or another grid.
    """

    def __init__(self, path: Path, board: Board, rest: npt.NDArray[np.floating] | Picture) -> None:
        import cv2

        if not path.is_file():
            raise InputError(f"{path}: no such network: `ruffini train displacement --board {board.name}` makes one")
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            raise InputError(f"{path}: no ONNX network that OpenCV can run: export it again") from error
        self._path = path
        rows, columns = board.observed
        self._shape = (1, 3, rows.stop - rows.start, columns.stop - columns.start)
        self._board, self._factor = board, shrink_factor(board)
        self._rest = self._layers(np.round(rest).astype(np.uint8))
        self.displacement_m(np.round(rest).astype(np.uint8))  # refuses a network of another board now

    def _layers(self, picture: Picture) -> npt.NDArray[np.float32]:
        camera = self._board.camera
        if picture.shape != (camera.height_px, camera.width_px, 3):
            raise InputError(
                f"a picture of {self._board.name!r} is {camera.height_px} x {camera.width_px} x 3, not {picture.shape}"
            )
        return np.moveaxis(shrunk(picture, self._factor), -1, 0).astype(np.float32)

    def displacement_m(self, picture: Picture) -> Array:
        """(n_y, n_x, 3) metres at the observed nodes, of a picture (h, w, 3) uint8."""
        import cv2

        both = np.concatenate([self._layers(picture), self._rest])[None]
        try:
            self._net.setInput(both)
            out = self._net.forward()
        except cv2.error as error:
            raise InputError(
                f"{self._path}: does not take pictures of board {self._board.name!r}: train its own"
            ) from error
        if out.shape != self._shape:
            raise InputError(
                f"{self._path}: gives {out.shape}, board {self._board.name!r} has {self._shape}: train its own"
            )
        return np.asarray(np.moveaxis(out[0], 0, -1) * 1e-6, dtype=np.float64)
