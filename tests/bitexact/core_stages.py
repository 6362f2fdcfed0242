"""ctypes door on the stages of the core (stages.cpp): the side that the mirror is compared with."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import numpy.typing as npt

I32 = npt.NDArray[np.int32]
U16 = npt.NDArray[np.uint16]
NO_LEVEL = np.zeros(3, np.int32)
MARKER_COLUMNS = 6  # x, y, dx, dy (Q16 px), is_lost, is_absent
MAX_DOTS = 4096


def _pointer(array: npt.NDArray[np.generic], dtype: type[np.generic]) -> ctypes.c_void_p:
    assert array.dtype == dtype
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)


class CoreStages:
    """The C++ stages of one board; every method takes and returns raw integers."""

    def __init__(self, library: Path, board_toml: str) -> None:
        self._lib = ctypes.CDLL(str(library))
        self._lib.stages_open.restype = ctypes.c_void_p
        for name in ("stages_poisson", "stages_displacement"):
            getattr(self._lib, name).restype = ctypes.c_int64
        error = ctypes.create_string_buffer(256)
        handle = self._lib.stages_open(board_toml.encode(), error)
        if not handle:
            raise ValueError(error.value.decode())
        self._handle = ctypes.c_void_p(handle)

    def close(self) -> None:
        self._lib.stages_close(self._handle)

    def cos_pi_q30(self, numerator: int, denominator: int) -> int:
        return int(self._lib.stages_cos_pi_q30(ctypes.c_int64(numerator), ctypes.c_int64(denominator)))

    def without_ambient(self, lit: npt.NDArray[np.uint8], dark: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        out = lit.copy()
        self._lib.stages_take_ambient_away(_pointer(out, np.uint8), _pointer(dark, np.uint8), out.size)
        return out

    def rest(self, frames: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.int16]]:
        image = np.zeros(frames.shape[1:], np.uint16)
        reciprocal = np.zeros((3, *frames.shape[1:3]), np.int16)
        assert self._lib.stages_rest(
            self._handle,
            _pointer(frames, np.uint8),
            len(frames),
            _pointer(image, np.uint16),
            _pointer(reciprocal, np.int16),
        )
        return image, np.moveaxis(reciprocal, 0, 2)

    def difference(
        self, frame: npt.NDArray[np.uint8]
    ) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16], tuple[int, int]]:
        """Relative change against the rest learned last, grey, (dark, full) pixel counts."""
        out = np.zeros((3, *frame.shape[:2]), np.int16)
        grey = np.zeros(frame.shape[:2], np.uint16)
        counts = np.zeros(2, np.int32)
        self._lib.stages_difference(
            self._handle,
            _pointer(frame, np.uint8),
            _pointer(out, np.int16),
            _pointer(grey, np.uint16),
            _pointer(counts, np.int32),
        )
        return np.moveaxis(out, 0, 2), grey, (int(counts[0]), int(counts[1]))

    def dots(self, grey: npt.NDArray[np.uint16]) -> I32:
        """Rows of x, y (Q16), area."""
        out = np.zeros((MAX_DOTS, 3), np.int32)
        n = self._lib.stages_dots(self._handle, _pointer(grey, np.uint16), _pointer(out, np.int32))
        return out[:n].copy()

    def learn_markers(self, dots: I32, n_markers: int) -> tuple[I32, int]:
        return self._markers(self._lib.stages_learn_markers, dots, n_markers)

    def track_markers(self, dots: I32, error2: npt.NDArray[np.int64]) -> tuple[I32, int]:
        """Rows of markers from dots that may be off by these, Q16 px squared; number lost."""
        out = np.zeros((len(error2), MARKER_COLUMNS), np.int32)
        n_lost = self._lib.stages_track_markers(
            self._handle, _pointer(dots, np.int32), len(dots), _pointer(error2, np.int64), _pointer(out, np.int32)
        )
        return out, int(n_lost)

    def printed(
        self,
        rest: tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16]],
        frame: tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]],
        n_markers: int,
    ) -> tuple[I32, npt.NDArray[np.uint8], int]:
        """Rows of markers of one frame, their quality and how many are lost; (grey, colours) of rest and frame."""
        rows, quality = np.zeros((n_markers, MARKER_COLUMNS), np.int32), np.zeros(n_markers, np.uint8)
        n_lost = self._lib.stages_printed(
            self._handle, _pointer(rest[0], np.uint16), _pointer(rest[1], np.uint16), _pointer(frame[0], np.uint16),
            _pointer(frame[1], np.uint8), _pointer(rows, np.int32), _pointer(quality, np.uint8),
        )  # fmt: skip
        return rows, quality, int(n_lost)

    def marker_quality(self, n_markers: int) -> npt.NDArray[np.uint8]:
        """Of the markers tracked last."""
        out = np.zeros(n_markers, np.uint8)
        self._lib.stages_marker_quality(self._handle, _pointer(out, np.uint8))
        return out

    def _markers(self, call: ctypes._NamedFuncPointer, dots: I32, n_markers: int) -> tuple[I32, int]:
        out = np.zeros((n_markers, MARKER_COLUMNS), np.int32)
        count = call(self._handle, _pointer(dots, np.int32), len(dots), _pointer(out, np.int32))
        return out, int(count)

    def flow(
        self, rest: tuple[U16, U16], frame: tuple[npt.NDArray[np.uint8], U16], n_markers: int
    ) -> tuple[I32, I32, npt.NDArray[np.uint8], tuple[int, int]]:
        """Marker rows at rest and of one frame of a textured board, their qualities; found, lost.

        rest, frame: picture (h, w, 3) and its grey.
        """
        learned, tracked = np.zeros((2, n_markers, MARKER_COLUMNS), np.int32)
        counts, quality = np.zeros(2, np.int32), np.zeros(n_markers, np.uint8)
        self._lib.stages_flow(
            self._handle,
            _pointer(rest[0], np.uint16),
            _pointer(rest[1], np.uint16),
            _pointer(frame[0], np.uint8),
            _pointer(frame[1], np.uint16),
            _pointer(learned, np.int32),
            _pointer(tracked, np.int32),
            _pointer(quality, np.uint8),
            _pointer(counts, np.int32),
        )
        return learned, tracked, quality, (int(counts[0]), int(counts[1]))

    def set_photometric(
        self,
        unmix: npt.NDArray[np.int16],
        slope: npt.NDArray[np.int16],
        bend: npt.NDArray[np.int16] | None = None,
        bend_axis: I32 | None = None,
    ) -> None:
        """A table that is balanced."""
        self._tables = (unmix, slope, bend, bend_axis)  # the core looks into them
        self._lib.stages_set_photometric(
            self._handle,
            _pointer(unmix, np.int16),
            unmix.shape[1],
            unmix.shape[0],
            _pointer(slope, np.int16),
            None if bend is None else _pointer(bend, np.int16),
            None if bend_axis is None else _pointer(bend_axis, np.int32),
        )

    def photometric(
        self, difference: npt.NDArray[np.int16], markers: I32, grid: tuple[int, int], level_q16: I32 = NO_LEVEL
    ) -> npt.NDArray[np.int16]:
        out = np.zeros((*grid, 2), np.int16)
        self._lib.stages_photometric(
            self._handle,
            _pointer(np.ascontiguousarray(np.moveaxis(difference, 2, 0)), np.int16),
            _pointer(markers, np.int32),
            _pointer(level_q16, np.int32),
            _pointer(out, np.int16),
        )
        return out

    def intensity(
        self, table: npt.NDArray[np.int16], difference: npt.NDArray[np.int16], grid: tuple[int, int], level_q16: I32
    ) -> npt.NDArray[np.int16]:
        out = np.zeros(grid, np.int16)
        self._lib.stages_intensity(
            self._handle,
            _pointer(table, np.int16),
            _pointer(np.ascontiguousarray(np.moveaxis(difference, 2, 0)), np.int16),
            _pointer(level_q16, np.int32),
            _pointer(out, np.int16),
        )
        return out

    def poisson(self, slope: npt.NDArray[np.int16]) -> tuple[npt.NDArray[np.int16], int]:
        depth = np.zeros(slope.shape[:2], np.int16)
        saturations = self._lib.stages_poisson(self._handle, _pointer(slope, np.int16), _pointer(depth, np.int16))
        return depth, int(saturations)

    def displacement(
        self, markers: I32, depth: npt.NDArray[np.int16] | None, nodes: tuple[int, int]
    ) -> tuple[npt.NDArray[np.int16], int]:
        out = np.zeros((*nodes, 3), np.int16)
        z = np.zeros(0, np.int16) if depth is None else depth
        saturations = self._lib.stages_displacement(
            self._handle,
            _pointer(markers, np.int32),
            _pointer(z, np.int16),
            z.size,
            _pointer(out, np.int16),
        )
        return out, int(saturations)

    def filled(self, markers: I32, nodes: tuple[int, int]) -> npt.NDArray[np.uint8]:
        out = np.zeros(nodes, np.uint8)
        self._lib.stages_filled(self._handle, _pointer(markers, np.int32), _pointer(out, np.uint8))
        return out

    def slip(
        self, mask: npt.NDArray[np.uint8], force: I32, displacement: npt.NDArray[np.int16]
    ) -> tuple[npt.NDArray[np.uint8], list[list[int]]]:
        """Node plane, and for each listed contact: state, ratio, friction, sigma, share, margin."""
        plane, rows = np.zeros(mask.shape, np.uint8), np.zeros((8, 6), np.int64)
        n = self._lib.stages_slip(
            self._handle,
            _pointer(mask, np.uint8),
            _pointer(force, np.int32),
            _pointer(displacement, np.int16),
            _pointer(plane, np.uint8),
            _pointer(rows, np.int64),
        )
        return plane, [[int(v) for v in row] for row in rows[:n]]

    def slip_forget(self) -> None:
        self._lib.stages_slip_forget(self._handle)
