"""Several views of the pad in one frame: a lens and a place for each, and the tables that the board reads them from.

Views lie side by side, equally wide, left first; "mirrored" ones see the pad over a mirror, so that their picture is
reversed left to right: turned back, it is that of the camera's mirror image, and fitted as any other. Places come from
one picture of the target on the pad that all views see. The pad's centre is the mean of what the principal points of
the straight views look at, its x axis the first view's. A chessboard or grid of dots looks alike when turned by half a
turn: it is taken to lie the same way round in all views.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.camera.fit import (
    MIN_VIEWS,
    STEP_LOG2,
    CameraModel,
    Lens,
    checked_rays,
    fit_lens,
    lattice_px,
    read_of_board,
    rounded,
    target_before,
)
from ruffini.estimators.camera.targets import Target

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

KINDS = ("straight", "mirrored")
MAX_VIEWS = 4


@dataclass(frozen=True)
class View:
    """One view's camera; `width_px` of the view, whose places count from its own left edge."""

    model: CameraModel
    is_mirrored: bool
    width_px: int
    residual_px: Array  # RMS of each picture

    def rays(self, px: Array) -> tuple[Array, Array]:
        """A (n, 2) in micrometres and S (n, 2), as of `CameraModel.rays`."""
        return self.model.rays(self.turned(px))

    def turned(self, px: Array) -> Array:
        """Places as in a picture without the mirror, and back."""
        return px * [-1, 1] + [self.width_px - 1, 0] if self.is_mirrored else px


@dataclass(frozen=True)
class ViewsFit:
    """All views, and how well their rays meet on the target that lay on the pad (micrometres)."""

    views: list[View]
    height_um: Array  # z of the target's points, which lie at 0
    gap_um: Array  # between the rays of the first two views there

    def report(self) -> dict[str, Any]:
        """For the manifest and the screen."""
        return {
            "views": [
                {
                    "kind": KINDS[view.is_mirrored], "pictures": len(view.residual_px),
                    "residual_px": round(_rms(view.residual_px), 4),
                    "worst_picture_px": round(float(view.residual_px.max()), 4),
                    "focal_px": round(float(view.model.lens.matrix[0, 0]), 3),
                    "pinhole_mm": [round(float(v), 4) for v in view.model.pinhole_mm],
                }
                for view in self.views
            ],
            "points": len(self.height_um), "height_um": round(_rms(self.height_um), 2),
            "gap_um": round(_rms(self.gap_um), 2),
        }  # fmt: skip


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values).mean()))


def view_kinds(text: str) -> list[str]:
    """Of `--views straight,mirrored`."""
    kinds = text.split(",")
    if not 2 <= len(kinds) <= MAX_VIEWS or not set(kinds) <= set(KINDS) or kinds[0] != "straight":
        raise InputError(f"--views {text!r}: 2 to {MAX_VIEWS} of {', '.join(KINDS)} from left to right, straight first")
    return kinds


def fit_views(
    paths: list[Path], target: Target, board: Board, kinds: list[str], *, is_fisheye: bool, on_pad: Path, index: float
) -> ViewsFit:
    """Fit every view's lens to pictures of the target, and their places to the one where it lies on the pad.

    Raises
    ------
    InputError
        Images of another size than the board's, a width that the views do not share evenly, or the target found in too
        few pictures of a view, or not by all views in the one on the pad.
    """
    if board.camera.width_px % len(kinds):
        raise InputError(f"{len(kinds)} views do not share the {board.camera.width_px} px of {board.name!r} evenly")
    width_px = board.camera.width_px // len(kinds)
    part = board.model_copy(update={"camera": board.camera.model_copy(update={"width_px": width_px})})
    pictures, last = [read_of_board(path, board) for path in paths], read_of_board(on_pad, board)
    fitted: list[tuple[Lens, Array]] = []
    found: list[tuple[Array, Array]] = []
    for number, kind in enumerate(kinds):
        seen = [target.find(_part(picture, number, width_px, kind)) for picture in pictures]
        views = [points for points in seen if points is not None]
        where = f"view {number + 1} of {len(kinds)}"
        if len(views) < MIN_VIEWS:
            raise InputError(
                f"the {target.kind} is seen in {len(views)} pictures by {where}: at least {MIN_VIEWS} are needed"
            )
        points = target.find(_part(last, number, width_px, kind))
        if points is None:
            raise InputError(f"{on_pad}: no {target.kind} found by {where}: all views must see it on the pad")
        fitted.append(fit_lens(views, part, is_fisheye))
        found.append(points)
    thickness_mm = board.pad.thickness_um * 1e-3 if index != 1 else 0.0
    places = _places([lens for lens, _ in fitted], found, kinds, part, thickness_mm * (1 - 1 / index))
    views_ = [
        View(CameraModel(lens, turn, pinhole, index, thickness_mm), kind == "mirrored", width_px, residual)
        for (lens, residual), (turn, pinhole), kind in zip(fitted, places, kinds, strict=True)
    ]
    return ViewsFit(views_, *_met(views_, found))


def _part(picture: Picture, number: int, width_px: int, kind: str) -> Picture:
    part = picture[:, number * width_px : (number + 1) * width_px]
    return np.ascontiguousarray(part[:, ::-1] if kind == "mirrored" else part)


def _places(
    lenses: list[Lens], found: list[tuple[Array, Array]], kinds: list[str], part: Board, lift_mm: float
) -> list[tuple[Array, Array]]:
    """Each camera's turn and pinhole in the pad's frame."""
    center = np.array([part.camera.center_x_mpx, part.camera.center_y_mpx]) * 1e-3
    stands, middles, along = [], [], np.zeros(2)
    for i, (lens, (px, mm)) in enumerate(zip(lenses, found, strict=True)):
        stand = target_before(lens, px, mm)
        middle, beside = _on_target(lens, stand, np.stack([center, center + np.array([1.0, 0.0])]))
        if i == 0:
            along = (beside - middle) / np.linalg.norm(beside - middle)
        elif (beside - middle) @ along < 0:  # the same target, turned by half a turn
            stand = target_before(lens, px, mm.max(axis=0) + mm.min(axis=0) - mm)
            middle = _on_target(lens, stand, center[None])[0]
        stands.append(stand)
        middles.append(middle)
    origin = np.append(np.mean([m for m, k in zip(middles, kinds, strict=True) if k == "straight"], axis=0), 0.0)
    turn, shift = stands[0]
    normal = np.array([0.0, 0.0, 1.0 if (turn.T @ shift)[2] > 0 else -1.0])  # away from the camera
    x = np.append(along, 0.0)
    to_pad = np.stack([x, np.cross(normal, x), normal])
    return [(to_pad @ turn.T, to_pad @ (-turn.T @ shift - origin) - [0, 0, lift_mm]) for turn, shift in stands]


def _on_target(lens: Lens, stand: tuple[Array, Array], px: Array) -> Array:
    """Places (n, 2), mm, on the target that image places look at."""
    turn, shift = stand
    origin, ray = -turn.T @ shift, lens.directions(px) @ turn
    return np.asarray((origin - origin[2] / ray[:, 2:] * ray)[:, :2])


def _met(views: list[View], found: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Heights and gaps, um, of the target's points where the rays of the first two views meet."""
    both = [{tuple(np.round(mm, 6)): px for px, mm in zip(*points, strict=True)} for points in found[:2]]
    shared = [key for key in both[0] if key in both[1]]
    if not shared:
        raise InputError("the first two views see no point of the target in common on the pad: move it to the middle")
    (a1, s1), (a2, s2) = (
        v.model.rays(np.array([seen[k] for k in shared])) for v, seen in zip(views, both, strict=False)
    )
    apart, turn = a1 - a2, s2 - s1
    z = (apart * turn).sum(axis=1) / (turn**2).sum(axis=1)
    return z, np.asarray(np.abs(apart - turn * z[:, None]).max(axis=1))


def tables(fit: ViewsFit, board: Board) -> tuple[dict[str, npt.NDArray[np.int32]], dict[str, str]]:
    """Tensor and metadata of the kind `views` (proto/CALIBRATION.md).

    Raises
    ------
    InputError
        A pixel of a view does not see the pad.
    """
    px = lattice_px(fit.views[0].width_px, board.camera.height_px)
    rays = [checked_rays(*view.rays(px.reshape(-1, 2))).reshape(*px.shape[:2], 4) for view in fit.views]
    return {"views.rays": rounded(np.stack(rays))}, {"views.step_log2": str(STEP_LOG2)}
