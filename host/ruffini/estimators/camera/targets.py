"""Points of a flat target in an image: chessboard, grid of dots, or ChArUco board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Kind = Literal["chessboard", "dots", "charuco"]
MIN_POINTS = 8  # of a partly hidden ChArUco board
MARKER_SHARE = 0.75  # side of a ChArUco marker over its square
SUBPIXEL = (3, 60, 1e-4)  # cv2's criteria: both, rounds, tolerance
DICTIONARIES = ("4X4_50", "4X4_250", "5X5_100", "5X5_250", "6X6_250")


@dataclass(frozen=True)
class Target:
    """A flat board. `columns` x `rows`: inner corners (chessboard), dots, or squares (ChArUco)."""

    kind: Kind
    columns: int
    rows: int
    pitch_mm: float
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or max(self.columns, self.rows) > 100:
            raise InputError(f"a target of {self.columns}x{self.rows} points: 3 to 100 a side are understood")
        if not 0 < self.pitch_mm < 1000:
            raise InputError(f"a pitch of {self.pitch_mm} mm: give the distance of neighbouring points, 0 to 1000 mm")
        if self.dictionary not in DICTIONARIES:
            raise InputError(f"unknown ChArUco dictionary {self.dictionary!r}: one of {', '.join(DICTIONARIES)}")

    def find(self, image: npt.NDArray[np.uint8]) -> tuple[Array, Array] | None:
        """Image places (n, 2), px, and places on the target (n, 2), mm; None where it is not seen."""
        import cv2

        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        if self.kind == "charuco":
            return self._charuco(grey)
        found = self._chessboard(grey) if self.kind == "chessboard" else self._dots(grey)
        if found is None:
            return None
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        return np.asarray(found, dtype=float).reshape(-1, 2), np.column_stack([column, row]) * self.pitch_mm

    def _chessboard(self, grey: Any) -> Any:
        import cv2

        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        is_found, corners = cv2.findChessboardCornersSB(grey, (self.columns, self.rows), flags=flags)
        if not is_found:
            return None
        # The saddle point within a third of a square: half the error of the detector's own corners.
        places = np.asarray(corners, dtype=np.float32).reshape(self.rows, self.columns, 2)
        apart = min(np.linalg.norm(np.diff(places, axis=axis), axis=-1).min() for axis in (0, 1))
        reach = max(2, int(apart / 3))
        return cv2.cornerSubPix(grey, places.reshape(-1, 1, 2), (reach, reach), (-1, -1), SUBPIXEL)

    def _dots(self, grey: Any) -> Any:
        import cv2

        module: Any = cv2  # its stubs lack the blob detector
        parameters = module.SimpleBlobDetector_Params()
        parameters.minArea, parameters.maxArea = 12.0, grey.size / 50
        parameters.minDistBetweenBlobs = 4.0
        parameters.filterByInertia = parameters.filterByConvexity = False
        for colour in (0, 255):
            parameters.blobColor = colour
            detector = module.SimpleBlobDetector_create(parameters)
            flags = cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
            is_found, centers = cv2.findCirclesGrid(grey, (self.columns, self.rows), flags=flags, blobDetector=detector)
            if is_found:
                return centers
        return None

    def charuco_board(self) -> Any:
        """OpenCV's board, to detect and to draw."""
        import cv2

        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.pitch_mm, MARKER_SHARE * self.pitch_mm, dictionary)

    def _charuco(self, grey: Any) -> tuple[Array, Array] | None:
        import cv2

        board = self.charuco_board()
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is None or len(ids) < MIN_POINTS:
            return None
        places = np.asarray(board.getChessboardCorners())[np.asarray(ids).ravel(), :2]
        return np.asarray(corners, dtype=float).reshape(-1, 2), np.asarray(places, dtype=float)
