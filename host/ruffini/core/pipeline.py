"""A board's pipeline, bit for bit as the firmware runs it (firmware/capi/ruffini_core.h)."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

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
from ruffini.native import library

N_COVARIANCE = 21  # upper triangle of 6 x 6
DISPLACEMENT_LSB_M = 125e-9
NOT_MEASURED = -32768  # a component of a displacement that `Pipeline.solve` fills
NO_REFERENCE = 1
NO_TEMPERATURE = -(2**31)
STAGES = (
    "difference", "markers", "targets", "photometric", "poisson", "displacement",
    "operator", "support", "wrench", "feature_wrench", "contacts", "skin", "contact_model", "fingertip", "helmholtz",
    "contact_depth",
)  # fmt: skip


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
        ("stage_ns", ctypes.c_uint64 * len(STAGES)),
    ]


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


MAX_CONTACTS = 8
N_RINGS = 16


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
            stage_ns=dict(zip(STAGES, result.stage_ns[:], strict=True)),
        )

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
        contradict all their neighbours (firmware/image/field_repair.h).
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

    def sigma(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
        """How sure the last frame is: steps (n_y, n_x, 3), and covariance (21,) of the wrench in (uN, uN mm)^2.

        Raises
        ------
        InputError
            The frame states none: no error model in the calibration, or no second pass.
        """
        sigma = np.zeros((self.layout.node_n_y, self.layout.node_n_x, 3), np.int32)
        covariance = np.zeros(N_COVARIANCE, np.int64)
        self._check(
            self._lib.ruffini_get_sigma(
                self._pointer, sigma.ctypes.data_as(ctypes.c_void_p), covariance.ctypes.data_as(ctypes.c_void_p)
            )
        )
        return sigma, covariance

    def residual(self) -> npt.NDArray[np.int32]:
        """What the forces of the last frame leave unexplained, (n_y, n_x, 3) in 1/64 standard deviation.

        See proto/README.md, "What the forces do not explain".

        Raises
        ------
        InputError
            The frame had no second pass: no `support` in the calibration, or depth is not measured.
        """
        out = np.zeros((self.layout.node_n_y, self.layout.node_n_x, 3), np.int32)
        validity = ctypes.c_int32()
        self._check(
            self._lib.ruffini_get_residual(self._pointer, out.ctypes.data_as(ctypes.c_void_p), ctypes.byref(validity))
        )
        return out

    def covariance(self) -> npt.NDArray[np.int64]:
        """Of the last frame's wrench, (21,) as in `sigma`.

        Raises
        ------
        InputError
            The frame states none.
        """
        covariance = np.zeros(N_COVARIANCE, np.int64)
        self._check(self._lib.ruffini_get_covariance(self._pointer, covariance.ctypes.data_as(ctypes.c_void_p)))
        return covariance

    def targets(self) -> npt.NDArray[np.int64]:
        """Targets, (n, 9): x, y (px Q16), area (px^2 Q8), light round it (grey Q8) at rest, the same now; 1: lost."""
        return self._get("targets", (self.layout.n_targets, 9), np.int64)

    def features(self) -> npt.NDArray[np.int64]:
        """What the stage feature_wrench reads, (n,).

        dx, dy (px Q16) and change of area (px^2 Q8) of each target; where there are none, dx and dy of each marker.
        """
        if "targets" in self.board.pipeline.stages:
            rows = self.targets()
            return np.asarray((rows[:, [4, 5, 6]] - rows[:, [0, 1, 2]]).ravel())
        moved = np.zeros((self.layout.marker_n_y, self.layout.marker_n_x, 2), np.int32)
        rest, lost = np.zeros_like(moved), np.zeros(moved.shape[:2], np.uint8)
        self._lib.ruffini_get_markers(
            self._pointer, rest.ctypes.data_as(ctypes.c_void_p),
            moved.ctypes.data_as(ctypes.c_void_p), lost.ctypes.data_as(ctypes.c_void_p),
        )  # fmt: skip
        return moved.ravel().astype(np.int64)

    def _get(self, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> npt.NDArray[Any]:
        out = np.zeros(shape, dtype)
        getattr(self._lib, f"ruffini_get_{name}")(self._pointer, out.ctypes.data_as(ctypes.c_void_p))
        return out

    def raw(self, name: str) -> npt.NDArray[Any]:
        """Integers of a stage of the last frame: change, slope, depth, displacement, force, mask or slip."""
        layout = self.layout
        nodes = (layout.node_n_y, layout.node_n_x)
        depth = (layout.depth_n_y, layout.depth_n_x)
        shapes: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
            "change": ((layout.height_px, layout.width_px, 3), np.int16),
            "slope": ((*depth, 2), np.int16),
            "depth": (depth, np.int16),
            "displacement": ((*nodes, 3), np.int16),
            "force": ((*nodes, 3), np.int32),
            "mask": (nodes, np.uint8),
            "slip": (nodes, np.uint8),
        }
        return self._get(name, *shapes[name])

    def contacts(self) -> list[ContactRow]:
        """The listed contacts of the last frame, largest first."""
        rows, n = np.zeros((MAX_CONTACTS, len(ContactRow._fields)), np.int64), ctypes.c_int32()
        self._lib.ruffini_get_contacts(self._pointer, rows.ctypes.data_as(ctypes.c_void_p), ctypes.byref(n))
        return [ContactRow(*row) for row in rows[: n.value].tolist()]

    def touches(self) -> list[TouchRow]:
        """The listed touches of a glowing skin in the last frame, hardest first.

        Raises
        ------
        InputError
            The board has no such skin.
        """
        rows, n = np.zeros((MAX_CONTACTS, len(TouchRow._fields)), np.int64), ctypes.c_int32()
        self._check(self._lib.ruffini_get_touches(self._pointer, rows.ctypes.data_as(ctypes.c_void_p), ctypes.byref(n)))
        return [TouchRow(*row) for row in rows[: n.value].tolist()]

    def profile(self) -> ProfileRow:
        """Profile of the last frame. Raises InputError where the board has no stage contact_model."""
        row = np.zeros(N_RINGS + len(ProfileRow._fields) - 1, np.int64)
        self._check(self._lib.ruffini_get_profile(self._pointer, row.ctypes.data_as(ctypes.c_void_p)))
        return ProfileRow(row[:N_RINGS], *row[N_RINGS:].tolist())

    def modelled(self) -> ModelledRow:
        """Contact of the last frame. Raises InputError where the calibration has no contact model."""
        row = np.zeros(len(ModelledRow._fields), np.int64)
        self._check(self._lib.ruffini_get_contact_model(self._pointer, row.ctypes.data_as(ctypes.c_void_p)))
        return ModelledRow(*row.tolist())

    def helmholtz(self) -> HelmholtzRow:
        """Sums of the flow's parts in the last frame. Raises InputError where the board has no stage helmholtz."""
        row = np.zeros(len(HelmholtzRow._fields), np.int64)
        self._check(self._lib.ruffini_get_helmholtz(self._pointer, row.ctypes.data_as(ctypes.c_void_p), None))
        return HelmholtzRow(*row.tolist())

    def curl_free_flow_q4(self) -> npt.NDArray[np.int64]:
        """(n_y, n_x, 2): curl-free part of the flow of the last frame, 1/16 um. Raises InputError as `helmholtz`."""
        _, _, lost = self.markers()
        row, flow = np.zeros(len(HelmholtzRow._fields), np.int64), np.zeros((*lost.shape, 2), np.int64)
        self._check(self._lib.ruffini_get_helmholtz(self._pointer, row.ctypes.data_as(ctypes.c_void_p),
                                                    flow.ctypes.data_as(ctypes.c_void_p)))  # fmt: skip
        return flow

    def tip(self) -> TipRow:
        """What presses on a fingertip in the last frame. Raises InputError where it is not calibrated."""
        row = np.zeros(len(TipRow._fields), np.int64)
        self._check(self._lib.ruffini_get_tip(self._pointer, row.ctypes.data_as(ctypes.c_void_p)))
        return TipRow(*row.tolist())

    def skin(self) -> SkinState:
        """State of a glowing skin in the last frame. Raises InputError where the board has none."""
        n, light_age = ctypes.c_int32(), np.zeros(2, np.int64)
        self._check(
            self._lib.ruffini_skin_state(self._pointer, ctypes.byref(n), light_age.ctypes.data_as(ctypes.c_void_p))
        )
        return SkinState(n.value, *(light_age / 4096).tolist())

    def taxels(self) -> npt.NDArray[np.int32]:
        """How much brighter each taxel is than at rest, Q12, (n,). Raises InputError without a skin."""
        return self._get("taxels", (self.skin().n_taxels,), np.int32)

    def glow(self) -> npt.NDArray[np.int16]:
        """Brightness over rest, quarter levels, (h, w); smoothed where no taxels are calibrated."""
        self.skin()
        return self._get("glow", (self.layout.height_px, self.layout.width_px), np.int16)

    def markers(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
        """Rest positions and displacements in pixels, (n_y, n_x, 2) each, and 0 seen, 1 lost, 2 absent."""
        shape = (self.layout.marker_n_y, self.layout.marker_n_x)
        rest, moved = np.zeros((*shape, 2), np.int32), np.zeros((*shape, 2), np.int32)
        lost = np.zeros(shape, np.uint8)
        self._lib.ruffini_get_markers(
            self._pointer, rest.ctypes.data_as(ctypes.c_void_p),
            moved.ctypes.data_as(ctypes.c_void_p), lost.ctypes.data_as(ctypes.c_void_p),
        )  # fmt: skip
        return rest / 65536, moved / 65536, lost

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
        """How sure each marker of the last frame is, (n_y, n_x): 255 / (1 + (expected error / 0.1 px)^2), 0 lost.

        Raises
        ------
        InputError
            The board's markers are not graded.
        """
        quality = np.zeros((self.layout.marker_n_y, self.layout.marker_n_x), np.uint8)
        self._check(self._lib.ruffini_get_marker_quality(self._pointer, quality.ctypes.data_as(ctypes.c_void_p)))
        return quality

    def force_n(self) -> npt.NDArray[np.float64]:
        """Nodal force of the last frame, (n_y, n_x, 3), newtons, on the observed nodes."""
        return np.asarray(self.raw("force") * (self.layout.force_lsb_un * 1e-6))

    def depth_m(self) -> npt.NDArray[np.float64]:
        """u_z of the last frame on the depth grid, metres, negative where pressed."""
        return np.asarray(self.raw("depth") * DISPLACEMENT_LSB_M)

    def displacement_m(self) -> npt.NDArray[np.float64]:
        """Nodal displacement of the last frame, (n_y, n_x, 3), metres."""
        return self.raw("displacement") * DISPLACEMENT_LSB_M
