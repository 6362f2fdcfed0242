"""A board's pipeline, bit for bit as the firmware runs it (firmware/capi/ruffini_core.h)."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.core.rows import (
    ContactRow as ContactRow,
)
from ruffini.core.rows import (
    HelmholtzRow as HelmholtzRow,
)
from ruffini.core.rows import (
    ModelledRow as ModelledRow,
)
from ruffini.core.rows import (
    ProfileRow as ProfileRow,
)
from ruffini.core.rows import (
    SkinState as SkinState,
)
from ruffini.core.rows import (
    TipRow as TipRow,
)
from ruffini.core.rows import (
    TouchRow as TouchRow,
)
from ruffini.errors import InputError
from ruffini.native import library, stage_slots

N_COVARIANCE = 21  # upper triangle of 6 x 6
DISPLACEMENT_LSB_M = 125e-9
NOT_MEASURED = -32768  # a component of a displacement that `Pipeline.solve` fills
NO_REFERENCE = 1
NO_TEMPERATURE = -(2**31)


class _Layout(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_int32)
        for name in (
            "width_px",
            "height_px",
            "depth_n_x",
            "depth_n_y",
            "depth_step_px",
            "node_n_x",
            "node_n_y",
            "node_first_x",
            "node_first_y",
            "marker_n_x",
            "marker_n_y",
            "force_lsb_un",
            "n_targets",
        )
    ]


class _Result(ctypes.Structure):
    _fields_ = [
        ("flags", ctypes.c_uint32),
        ("force_xy", ctypes.c_int32),
        ("force_z", ctypes.c_int32),
        ("depth", ctypes.c_int32),
        ("wrench_validity", ctypes.c_int32 * 6),
        ("n_markers_lost", ctypes.c_int32),
        ("n_markers_at_rest", ctypes.c_int32),
        ("saturations", ctypes.c_uint64),
        ("wrench", ctypes.c_int64 * 6),
        ("n_contacts", ctypes.c_int32),
    ]


class _Features(ctypes.Structure):
    _fields_ = [
        ("sort", ctypes.c_char_p),
        *((name, ctypes.c_int32) for name in ("n", "n_planes", "n_y", "n_x")),
    ]


class _Slot(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_char_p),
        ("type", ctypes.c_char_p),
        ("unit", ctypes.c_char_p),
        ("columns", ctypes.c_char_p),
        ("n_axes", ctypes.c_int32),
        ("shape", ctypes.c_int32 * 3),
    ]


@dataclass(frozen=True)
class Slot:
    """An array of results, as the core describes it: the unit of one step, and the names of the last axis, if any."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    unit: str
    columns: tuple[str, ...]


class Features(NamedTuple):
    """What the wrench of a board is made of: the sort that a stage writes, and how many numbers a frame has."""

    sort: str
    n: int
    grid: tuple[int, int, int] | None = None  # of values over a grid: planes, rows, columns


@dataclass(frozen=True)
class Frame:
    """What one frame gave, beyond the arrays of `Pipeline`.

    `flags` is the FlagBit mask of ruffini.proto; validities its Validity, of each component of the wrench too;
    `wrench_un` (6,) int64 in micronewton and micronewton micrometre; lost markers count lost targets in.
    """

    flags: int
    force_xy_validity: int
    force_z_validity: int
    depth_validity: int
    wrench_validity: tuple[int, ...]
    n_markers_lost: int
    n_markers_at_rest: int
    saturations: int
    wrench_un: npt.NDArray[np.int64]
    n_contacts: int
    stage_ns: dict[str, int]

    @property
    def has_reference(self) -> bool:
        return not self.flags & NO_REFERENCE

    @property
    def wrench(self) -> npt.NDArray[np.float64]:
        """(6,) force in N and moment in N m about the undeformed pad centre."""
        return np.asarray(self.wrench_un * np.array([1e-6] * 3 + [1e-12] * 3))


class Pipeline:
    """One sensor's frame path. Not thread-safe; close it or use it as a context manager.

    Parameters
    ----------
    board : Board
    calibration : bytes, optional
        A calibration file. Its signature is not checked here.

    Raises
    ------
    InputError
        The core refuses the board or the calibration; the text says why.
    """

    def __init__(self, board: Board, calibration: bytes | None = None) -> None:
        self._lib = library()
        text = board.text.encode()
        self._handle = self._lib.ruffini_open(
            text, ctypes.c_size_t(len(text)), board.name.encode(),
            calibration, ctypes.c_size_t(len(calibration or b"")),
        )  # fmt: skip
        if not self._handle:
            raise InputError(self._lib.ruffini_error().decode())
        self._pointer = ctypes.c_void_p(self._handle)
        layout = _Layout()
        self._lib.ruffini_layout(self._pointer, ctypes.byref(layout))
        self.board = board
        self.layout = layout
        self.slots = dict(self._describe())
        self._stages = tuple(stage_slots())
        self._n_frames = 0

    def __enter__(self) -> Pipeline:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the core's memory."""
        if self._handle:
            self._lib.ruffini_close(self._pointer)
            self._handle = None

    def _check(self, code: int) -> None:
        if code:
            raise InputError(self._lib.ruffini_error().decode())

    def _describe(self) -> Iterator[tuple[str, Slot]]:
        for index in range(self._lib.ruffini_slot_count(self._pointer)):
            slot = _Slot()
            self._check(self._lib.ruffini_slot_describe(self._pointer, index, ctypes.byref(slot)))
            yield (
                slot.name.decode(),
                Slot(
                    np.dtype(slot.type.decode()),
                    tuple(slot.shape[: slot.n_axes]),
                    slot.unit.decode(),
                    tuple(slot.columns.decode().split()),
                ),
            )

    def process(self, bgr: npt.NDArray[np.uint8], capture_s: float | None = None) -> Frame:
        """Run one frame, (height, width, 3) uint8, B G R.

        Parameters
        ----------
        capture_s : float
            When it was captured, from any start; the pad's relaxation follows it. By default one frame period of the
            board after the one before.
        """
        if bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
            raise InputError(f"a frame must be (height, width, 3) uint8, got {bgr.shape} {bgr.dtype}")
        pixels = np.ascontiguousarray(bgr)
        result = _Result()
        self._n_frames += 1
        time_s = self._n_frames * 1000.0 / self.board.camera.rate_mhz if capture_s is None else capture_s
        self._check(
            self._lib.ruffini_process(
                self._pointer,
                pixels.ctypes.data_as(ctypes.c_void_p),
                bgr.shape[1],
                bgr.shape[0],
                ctypes.c_uint64(1 + round(time_s * 1e6)),
                ctypes.byref(result),
            )
        )
        return Frame(
            flags=result.flags,
            force_xy_validity=result.force_xy,
            force_z_validity=result.force_z,
            depth_validity=result.depth,
            wrench_validity=tuple(result.wrench_validity[:]),
            n_markers_lost=result.n_markers_lost,
            n_markers_at_rest=result.n_markers_at_rest,
            saturations=result.saturations,
            wrench_un=np.array(result.wrench[:], dtype=np.int64),
            n_contacts=result.n_contacts,
            stage_ns=self._stage_ns(),
        )

    def _stage_ns(self) -> dict[str, int]:
        times = np.zeros(len(self._stages), np.uint64)
        self._check(self._lib.ruffini_stage_times(self._pointer, times.ctypes.data_as(ctypes.c_void_p)))
        return dict(zip(self._stages, times.tolist(), strict=True))

    def set_celsius(self, celsius: float | None) -> None:
        """How warm the pad is from the next frame on; None, as at first: not measured."""
        milli = NO_TEMPERATURE if celsius is None else round(1e3 * celsius)
        self._check(self._lib.ruffini_set_temperature(self._pointer, ctypes.c_int32(milli)))

    def set_live(self, *, is_live: bool = True) -> None:
        """Frames are a live camera's: repeated and broken pictures are flagged, and creep is followed."""
        self._check(self._lib.ruffini_set_live(self._pointer, ctypes.c_int32(is_live)))

    def zero(self, n_frames: int = 0) -> None:
        """Learn rest from the next n frames (0 = the board's own number)."""
        self._check(self._lib.ruffini_zero(self._pointer, n_frames))

    def set_rest(self, image: npt.NDArray[np.float64] | npt.NDArray[np.uint8]) -> None:
        """Take an untouched image, (height, width, 3) grey levels, as rest."""
        if image.dtype == np.uint8:
            rest = image.astype(np.uint16, order="C") * np.uint16(16)
        else:
            rest = np.ascontiguousarray(np.clip(np.round(image.astype(float) * 16), 0, 65535).astype(np.uint16))
        if rest.shape != (self.layout.height_px, self.layout.width_px, 3):
            raise InputError(
                f"the rest image is {image.shape}, this board needs "
                f"({self.layout.height_px}, {self.layout.width_px}, 3)"
            )
        self._check(self._lib.ruffini_set_rest(self._pointer, rest.ctypes.data_as(ctypes.c_void_p)))

    def solve(self, displacement: npt.NDArray[np.int16]) -> npt.NDArray[np.int32]:
        """Displacement (frames, observed nodes, 3) in 125 nm -> force in steps of the board.

        A component of -32768 was not measured: it is filled smoothly from the nodes around, as are single nodes that
        contradict all their neighbours (firmware/image/field_repair.h). With [contact] steady_frames above 1 a frame is
        averaged with those before it, of earlier calls too.
        """
        n = self.layout.node_n_x * self.layout.node_n_y
        if displacement.shape[1:] != (n, 3) or displacement.dtype != np.int16:
            raise InputError(f"displacement must be (frames, {n}, 3) int16, got {displacement.shape}")
        u = np.ascontiguousarray(displacement)
        force = np.zeros(u.shape, np.int32)
        self._check(
            self._lib.ruffini_solve(
                self._pointer,
                u.ctypes.data_as(ctypes.c_void_p),
                len(u),
                force.ctypes.data_as(ctypes.c_void_p),
            )
        )
        return force

    def raw(self, name: str) -> npt.NDArray[Any]:
        """Integers of the last frame by the name of `slots`, which has their units; of a list the rows that it holds.

        Raises
        ------
        InputError
            No stage of this board writes them with this calibration, or the last frame does not state them.
        """
        slot = self.slots.get(name)
        out = np.zeros(slot.shape if slot else 0, slot.dtype if slot else np.uint8)
        n_rows = ctypes.c_int32()
        self._check(
            self._lib.ruffini_get_slot(
                self._pointer, name.encode(), out.ctypes.data_as(ctypes.c_void_p), ctypes.c_size_t(out.nbytes),
                ctypes.byref(n_rows),
            )
        )  # fmt: skip
        return out[: n_rows.value]

    def _columns(self, name: str) -> list[dict[str, int]]:
        rows = self.raw(name)
        return [dict(zip(self.slots[name].columns, row, strict=True)) for row in np.atleast_2d(rows).tolist() if row]

    def sigma(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
        """Uncertainty of the last frame: steps (n_y, n_x, 3), and covariance (21,) of the wrench in (uN, uN mm)^2."""
        return self.raw("sigma"), self.raw("covariance")

    def residual(self) -> npt.NDArray[np.int32]:
        """What the forces of the last frame leave unexplained, (n_y, n_x, 3) in 1/64 standard deviation.

        See proto/README.md, "What the forces do not explain".
        """
        return self.raw("residual")

    def covariance(self) -> npt.NDArray[np.int64]:
        """Of the last frame's wrench, (21,) as in `sigma`."""
        return self.raw("covariance")

    def targets(self) -> npt.NDArray[np.int64]:
        """Targets, (n, 9): x, y (px Q16), area (px^2 Q8), light round it (grey Q8) at rest, the same now; 1: lost."""
        return self.raw("targets")

    def features(self) -> npt.NDArray[np.int64]:
        """Features of the last frame, (n,), of which the stage feature_wrench makes the wrench.

        Targets: dx, dy and change of area of each; markers: dx, dy of each; others: the header of the stage that writes
        them. Unit: `slots["features"].unit`.
        """
        return self.raw("features").astype(np.int64)

    def feature_sort(self) -> Features | None:
        """The features of the board, whether or not its calibration lets a stage compute them; None: it has none."""
        out = _Features()
        self._check(self._lib.ruffini_features(self._pointer, ctypes.byref(out)))
        grid = (out.n_planes, out.n_y, out.n_x) if out.n_planes else None
        return Features(out.sort.decode(), out.n, grid) if out.sort else None

    def contacts(self) -> list[ContactRow]:
        """The listed contacts of the last frame, largest first."""
        return [ContactRow(**row) for row in self._columns("contacts")]

    def touches(self) -> list[TouchRow]:
        """The listed touches of a glowing skin in the last frame, hardest first."""
        return [TouchRow(**row) for row in self._columns("touches")]

    def profile(self) -> ProfileRow:
        """Profile of the last frame."""
        return ProfileRow(self.raw("radial_flow"), **self._columns("profile")[0])

    def modelled(self) -> ModelledRow:
        """Contact of the last frame by the contact model."""
        return ModelledRow(**self._columns("contact_model")[0])

    def helmholtz(self) -> HelmholtzRow:
        """Sums of the flow's parts in the last frame."""
        return HelmholtzRow(**self._columns("helmholtz")[0])

    def curl_free_flow_q4(self) -> npt.NDArray[np.int64]:
        """(n_y, n_x, 2): curl-free part of the flow of the last frame, 1/16 um."""
        return self.raw("curl_free_flow")

    def tip(self) -> TipRow:
        """What presses on a fingertip in the last frame."""
        return TipRow(**self._columns("tip")[0])

    def skin(self) -> SkinState:
        """State of a glowing skin in the last frame."""
        return SkinState(len(self.taxels()), *(self.raw("skin") / 4096).tolist())

    def taxels(self) -> npt.NDArray[np.int32]:
        """How much brighter each taxel is than at rest, Q12, (n,)."""
        return self.raw("taxels")

    def glow(self) -> npt.NDArray[np.int16]:
        """Brightness over rest, quarter levels, (h, w); smoothed where no taxels are calibrated."""
        return self.raw("glow")

    def markers(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
        """Rest positions and displacements in pixels, (n_y, n_x, 2) each, and 0 seen, 1 lost, 2 absent."""
        places = self.raw("markers") / 65536
        return places[..., :2], places[..., 2:], self.raw("marker_state")

    def triangulate(
        self, first_px: npt.NDArray[np.float64], second_px: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Points that two views of one frame see, by the calibration's kind `views`.

        Parameters
        ----------
        first_px, second_px : (n, 2) float64
            Places of the same points in the first and in the second view, in the frame's pixels.

        Returns
        -------
        point_m : (n, 3) float64
            In the pad's frame; NaN where the rays do not meet.
        gap_m : (n,) float64
            Between the two rays at that height, the larger of x and y.

        Raises
        ------
        InputError
            The calibration has no views.
        """
        places = np.ascontiguousarray(np.round(np.hstack([first_px, second_px]) * 65536).astype(np.int32))
        out = np.zeros((len(places), 4), np.int32)
        self._check(
            self._lib.ruffini_triangulate(
                self._pointer,
                places.ctypes.data_as(ctypes.c_void_p),
                len(places),
                out.ctypes.data_as(ctypes.c_void_p),
            )
        )
        metres = np.where(out == np.iinfo(np.int32).min, np.nan, out / 256e6)
        return metres[:, :3], metres[:, 3]

    def marker_quality(self) -> npt.NDArray[np.uint8]:
        """Quality of each marker of the last frame, (n_y, n_x): 255 / (1 + (expected error / 0.1 px)^2), 0 lost."""
        return self.raw("marker_quality")

    def force_n(self) -> npt.NDArray[np.float64]:
        """Nodal force of the last frame, (n_y, n_x, 3), newtons, on the observed nodes."""
        return np.asarray(self.raw("force") * (self.layout.force_lsb_un * 1e-6))

    def depth_m(self) -> npt.NDArray[np.float64]:
        """u_z of the last frame on the depth grid, metres, negative where pressed."""
        return np.asarray(self.raw("depth") * DISPLACEMENT_LSB_M)

    def displacement_m(self) -> npt.NDArray[np.float64]:
        """Nodal displacement of the last frame, (n_y, n_x, 3), metres."""
        return self.raw("displacement") * DISPLACEMENT_LSB_M
