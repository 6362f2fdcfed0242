"""Lens and mounting of a camera from pictures of a flat target, and the tables that the board reads them from.

The lens is OpenCV's (radial-tangential or fisheye). Where the camera stands is board.toml's (above the pad's centre,
looking straight at it, at the standoff), or measured from a picture of the target lying on the pad, with x the image's
x. Either way the pad's centre is what the board's principal point sees: a fit knows its own to half a pixel at best.
Through a clear gel of refractive index n and a flat back rays bend by Snell's law, and the gel lifts what lies behind
it by t (1 - 1/n).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.camera.targets import Target
from ruffini.frames import read_image

Array = npt.NDArray[np.float64]

MIN_VIEWS = 4
STEP_LOG2 = 2  # lattice of the rays, pixels: bilinear between
INVERSION_ROUNDS = 12
MAX_PLACE_UM, MAX_SLOPE = 2.0**20, 4.0  # what the board's integers hold
NEWTON_STEP = 1e-5  # of directions, for differences
STEEPEST = 1.4  # radians from a fisheye's axis at which its inversion starts at most


@dataclass(frozen=True)
class Lens:
    """OpenCV's camera matrix and distortion."""

    matrix: Array
    distortion: Array
    is_fisheye: bool

    def directions(self, px: Array) -> Array:
        """Rays (n, 3) of image places (n, 2), in the camera's frame, z = 1."""
        scale = np.array([self.matrix[0, 0], self.matrix[1, 1]])
        start = (px - self.matrix[:2, 2]) / scale
        if self.is_fisheye:
            angle = np.hypot(start[:, 0], start[:, 1])[:, None]
            start = start * np.tan(np.minimum(angle, STEEPEST)) / np.maximum(angle, 1e-9)
        plane = invert(self._seen_at, px, start, NEWTON_STEP)
        return np.column_stack([plane, np.ones(len(px))])

    def _seen_at(self, plane: Array) -> Array:
        return self.project(np.column_stack([plane, np.ones(len(plane))]), np.zeros(3), np.zeros(3))

    def project(self, points: Array, rotation: Array, shift: Array) -> Array:
        """Image places (n, 2) of points (n, 3) in a frame that stands so before the camera."""
        import cv2

        where = points.reshape(-1, 1, 3)
        if self.is_fisheye:
            px = cv2.fisheye.projectPoints(where, rotation, shift, self.matrix, self.distortion)[0]
        else:
            px = cv2.projectPoints(where, rotation, shift, self.matrix, self.distortion)[0]
        return np.asarray(px, dtype=np.float64).reshape(-1, 2)


def invert(function: Callable[[Array], Array], wanted: Array, start: Array, half: float) -> Array:
    """x (n, 2) with function(x) = wanted, row by row, by Newton's method with differences over 2 half."""
    x = start.copy()
    ways = np.array([[half, 0], [0, half]])
    for _ in range(INVERSION_ROUNDS):
        wrong = wanted - function(x)
        a, b = ((function(x + way) - function(x - way)) / (2 * half) for way in ways)
        det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        step = np.column_stack([b[:, 1] * wrong[:, 0] - b[:, 0] * wrong[:, 1],
                                a[:, 0] * wrong[:, 1] - a[:, 1] * wrong[:, 0]]) / det[:, None]  # fmt: skip
        x += step
        if np.nanmax(np.abs(step)) < 1e-3 * half:
            break
    return x


@dataclass(frozen=True)
class CameraModel:
    """Lens, and the camera's place in the pad's frame (mm); the gel's index and thickness where light passes it."""

    lens: Lens
    turn: Array  # camera to pad, (3, 3)
    pinhole_mm: Array
    index: float = 1.0
    thickness_mm: float = 0.0

    def rays(self, px: Array) -> tuple[Array, Array]:
        """A (n, 2) in micrometres and S (n, 2): what is seen at an image place lies at A + S z."""
        direction = self.lens.directions(px) @ self.turn.T
        origin = np.broadcast_to(self.pinhole_mm, direction.shape)
        if self.index != 1:
            away = (-self.thickness_mm - origin[:, 2]) / direction[:, 2]
            origin = origin + away[:, None] * direction
            sideways = direction[:, :2] / np.linalg.norm(direction, axis=1, keepdims=True) / self.index
            direction = np.column_stack([sideways, np.sqrt(1 - (sideways**2).sum(axis=1))])
        slope = direction[:, :2] / direction[:, 2:]
        return (origin[:, :2] - origin[:, 2:] * slope) * 1e3, slope


@dataclass(frozen=True)
class CameraFit:
    """A model, and how well it explains the pictures that it was fitted to."""

    model: CameraModel
    residual_px: Array  # RMS of each view
    um_per_px: float
    is_measured_on_pad: bool
    n_points: int
    skipped: list[str] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """For the manifest and the screen."""
        lens = self.model.lens
        rms = float(np.sqrt((self.residual_px**2).mean()))
        return {
            "views": len(self.residual_px), "points": self.n_points, "skipped": self.skipped,
            "residual_px": round(rms, 4), "worst_view_px": round(float(self.residual_px.max()), 4),
            "residual_um": round(rms * self.um_per_px, 3),
            "model": "fisheye" if lens.is_fisheye else "radtan",
            "focal_px": [round(float(lens.matrix[i, i]), 3) for i in (0, 1)],
            "center_px": [round(float(lens.matrix[i, 2]), 3) for i in (0, 1)],
            "distortion": [round(float(k), 6) for k in lens.distortion.ravel()],
            "pinhole_mm": [round(float(v), 4) for v in self.model.pinhole_mm],
            "is_measured_on_pad": self.is_measured_on_pad, "index": self.model.index,
        }  # fmt: skip


def read_of_board(path: Path, board: Board) -> npt.NDArray[np.uint8]:
    """An image of the board's size."""
    image = read_image(path)
    height, width = image.shape[:2]
    if (width, height) != (board.camera.width_px, board.camera.height_px):
        raise InputError(f"{path}: is {width}x{height}, board {board.name!r} needs {board.resolution}")
    return image


def fit_camera(
    paths: list[Path], target: Target, board: Board, *, is_fisheye: bool, on_pad: Path | None, index: float
) -> CameraFit:
    """Fit lens and mounting to pictures of the target.

    Raises
    ------
    InputError
        Images of another size than the board's, the target found in too few, or not in the one on the pad.
    """
    seen = [(path, target.find(read_of_board(path, board))) for path in paths]
    views = [found for _, found in seen if found is not None]
    skipped = [path.name for path, found in seen if found is None]
    size = f"{target.columns}x{target.rows}"
    if not views:
        raise InputError(
            f"no {target.kind} of {size} found in any of {len(paths)} images: check --size, or sharper ones"
        )
    if len(views) < MIN_VIEWS:
        raise InputError(f"the {target.kind} is seen in {len(views)} images: at least {MIN_VIEWS} from several sides")
    lens, residual = fit_lens(views, board, is_fisheye)
    camera = board.camera
    thickness_mm = board.pad.thickness_um * 1e-3 if index != 1 else 0.0
    lift = thickness_mm * (1 - 1 / index)
    center = lens.directions(np.array([[camera.center_x_mpx, camera.center_y_mpx]]) * 1e-3)[0]
    turn, pinhole = np.eye(3), -center * camera.standoff_um * 1e-3 - [0, 0, lift]
    if on_pad is not None:
        found = target.find(read_of_board(on_pad, board))
        if found is None:
            raise InputError(f"{on_pad}: no {target.kind} of {size} found: it shows where the pad lies")
        turn, pinhole = _stand(lens, found, board, lift)
    return CameraFit(
        CameraModel(lens, turn, pinhole, index, thickness_mm), residual, camera.standoff_um * 1e3 / camera.focal_mpx,
        on_pad is not None, sum(len(px) for px, _ in views), skipped,
    )  # fmt: skip


def _fisheye_flag(name: str) -> int:
    """OpenCV 5 moved the fisheye's flags beside the others, with other values."""
    import cv2

    module: Any = cv2
    home = module.fisheye if hasattr(module.fisheye, f"CALIB_{name}") else module
    return int(getattr(home, f"CALIB_{name}"))


def fit_lens(views: list[tuple[Array, Array]], board: Board, is_fisheye: bool) -> tuple[Lens, Array]:
    """Lens, and the residual of each view, px RMS."""
    import cv2

    camera = board.camera
    focal, x, y = (v * 1e-3 for v in (camera.focal_mpx, camera.center_x_mpx, camera.center_y_mpx))
    guess = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
    size = (camera.width_px, camera.height_px)
    flat = [np.column_stack([mm, np.zeros(len(mm))]) for _, mm in views]
    try:
        if is_fisheye:
            flags = sum(_fisheye_flag(n) for n in ("USE_INTRINSIC_GUESS", "RECOMPUTE_EXTRINSIC", "FIX_SKEW"))
            _, matrix, distortion, turns, shifts = cv2.fisheye.calibrate(
                [m.reshape(1, -1, 3) for m in flat], [p.reshape(1, -1, 2) for p, _ in views], size,
                guess, np.zeros(4), flags=flags,
            )  # fmt: skip
        else:
            _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                [m.astype(np.float32) for m in flat], [p.astype(np.float32) for p, _ in views], size,
                guess, np.zeros(5), flags=cv2.CALIB_USE_INTRINSIC_GUESS,
            )  # fmt: skip
    except cv2.error as error:
        raise InputError(f"the lens cannot be told from these views: turn the target more ({error.err})") from error
    lens = Lens(np.asarray(matrix), np.asarray(distortion), is_fisheye)
    off = [
        lens.project(m, np.asarray(r, np.float64), np.asarray(t, np.float64)) - p
        for m, (p, _), r, t in zip(flat, views, turns, shifts, strict=True)
    ]
    return lens, np.array([np.sqrt((e**2).sum(axis=1).mean()) for e in off])


def target_before(lens: Lens, px: Array, mm: Array) -> tuple[Array, Array]:
    """Turn (3, 3) and shift (3,), mm, of a flat target in the camera's frame: of both that fit, the better one."""
    import cv2

    plane = np.ascontiguousarray(lens.directions(px)[:, :2])
    flat = np.column_stack([mm, np.zeros(len(mm))])
    n, turns, shifts, _ = cv2.solvePnPGeneric(flat, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    best: tuple[float, Array, Array] | None = None
    for turn, shift in zip(turns[:n], shifts[:n], strict=True):
        turn, shift = cv2.solvePnPRefineLM(flat, plane, np.eye(3), None, turn, shift)
        off = np.square(cv2.projectPoints(flat, turn, shift, np.eye(3), None)[0].reshape(-1, 2) - plane).sum()
        if best is None or off < best[0]:
            best = float(off), np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(shift, float).ravel()
    if best is None:
        raise InputError("the target on the pad does not tell where the camera stands: use a larger one")
    return best[1], best[2]


def _stand(lens: Lens, found: tuple[Array, Array], board: Board, lift_mm: float) -> tuple[Array, Array]:
    """The camera's turn and place in the pad's frame from the target on the pad."""
    turn, shift = target_before(lens, *found)
    normal = turn[:, 2]
    away = float(normal @ shift)  # of the pad's plane from the pinhole, along its normal
    normal, away = (normal, away) if away > 0 else (-normal, -away)
    camera = board.camera
    center = np.array([camera.center_x_mpx, camera.center_y_mpx]) * 1e-3
    look = lens.directions(np.stack([center, center + np.array([1.0, 0.0])]))
    middle, beside = (ray * away / (normal @ ray) for ray in look)
    along_x = (beside - middle) / np.linalg.norm(beside - middle)
    to_pad = np.stack([along_x, np.cross(normal, along_x), normal])
    pinhole = -to_pad @ middle
    return to_pad, pinhole - [0, 0, lift_mm]


def tables(model: CameraModel, board: Board) -> tuple[dict[str, npt.NDArray[np.int32]], dict[str, str]]:
    """Tensors and metadata of the kind `camera` (proto/CALIBRATION.md).

    Raises
    ------
    InputError
        A pixel does not see the pad: its ray leads beyond a metre, or nearly along the surface.
    """
    camera = board.camera
    px = lattice_px(camera.width_px, camera.height_px)
    place, slope = model.rays(px.reshape(-1, 2))
    rays = checked_rays(place, slope).reshape(*px.shape[:2], 4)
    # The ideal pinhole's S is A / H: the distance that fits the rays best; the scale stays the board's.
    standoff = float((place**2).sum() / (place * slope).sum())
    ratio = np.clip(standoff / camera.standoff_um, 0.5, 4.0)
    return (
        {"camera.rays": rounded(rays), "camera.source": rounded(_sources(model, board) * 2**16)},
        {"camera.step_log2": str(STEP_LOG2), "camera.focal_mpx": str(round(camera.focal_mpx * ratio)),
         "camera.standoff_um": str(round(camera.standoff_um * ratio))},
    )  # fmt: skip


def lattice_px(width_px: int, height_px: int) -> Array:
    """Image places of the lattice that rays are kept on, (n_y, n_x, 2)."""
    lines = [np.arange(((n - 2) >> STEP_LOG2) + 2) * float(1 << STEP_LOG2) for n in (width_px, height_px)]
    return np.stack(np.meshgrid(*lines), axis=-1)


def checked_rays(place: Array, slope: Array) -> Array:
    """A (n, 2) um and S (n, 2) as the board holds them, (n, 4) Q8 and Q20.

    Raises
    ------
    InputError
        A pixel does not see the pad: its ray leads beyond a metre, or nearly along the surface.
    """
    sound = np.isfinite(place).all() and np.isfinite(slope).all()
    if not sound or np.abs(place).max() > MAX_PLACE_UM or np.abs(slope).max() > MAX_SLOPE:
        raise InputError("the fitted camera does not see the pad with every pixel: check --size, --pitch-mm, --on-pad")
    return np.concatenate([place * 2**8, slope * 2**20], axis=1)


def rounded(values: Array) -> npt.NDArray[np.int32]:
    """The board's integers."""
    return np.floor(values + 0.5).astype(np.int32)


def _sources(model: CameraModel, board: Board) -> Array:
    """Where the image sees what each depth cell of the ideal pinhole looks at, (n_y, n_x, 2) px, by Newton."""
    camera, step = board.camera, board.depth.step_px
    cells = [np.arange(n // step) * step + (step - 1) / 2 for n in (camera.width_px, camera.height_px)]
    ideal = np.stack(np.meshgrid(*cells), axis=-1)
    center = np.array([camera.center_x_mpx, camera.center_y_mpx]) * 1e-3
    wanted = ((ideal - center) * (camera.standoff_um * 1e3 / camera.focal_mpx)).reshape(-1, 2)
    px = invert(lambda p: model.rays(p)[0], wanted, ideal.reshape(-1, 2), 0.5)
    # A lens fitted inside the image may turn back far outside it: places there are the border's.
    limit = np.array([camera.width_px, camera.height_px]) - 1.0
    return np.clip(np.nan_to_num(px), 0, limit).reshape(ideal.shape)
