"""A photometric table on ball presses that it was not fitted on: normals, cap shape, height, untouched frames.

Judged inside `INSIDE` of the contact radius, where the surface is the ball's; outside it the gel slopes too, and nobody
knows how. Circles are marked by hand to 1 or 2 px, which is 1.5 degrees a pixel: each press is judged on its circle as
marked and on the one within `REFIT_PX` of it that the normals agree with best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.boards.pictures import picture_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.photometric.intensity import has_depth_table
from ruffini.estimators.photometric.pad_view import MappedCamera, PadView, mm_per_px, pad_view
from ruffini.estimators.photometric.presses import Press, PressSet, ball_slope
from ruffini.frames import read_image
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]

INSIDE = 0.85  # of the contact radius
REFIT_PX = 2.0  # largest correction of centre and radius
REFIT_STEPS_PX = (1.0, 0.5, 0.25)
CENTER = 0.12  # radius of the middle whose height is the peak's, contact radii
RING = 0.04  # half width of the ring whose height is the edge's
EQUATOR = 0.98  # contact radius over ball radius: where the surface is upright no camera sees its slope
DEPTH_SMOOTHED_PX = 3.0  # before the slope is taken of a depth that was not made of slopes
FAR_MM = 500.0  # pinhole of a view without perspective


@dataclass(frozen=True)
class View:
    """How the images are looked at: the board and calibration that run, and the camera where there is perspective.

    `ideal_px`: with a camera as measured, where the device's own view has the image's pixels, x and y (2, h, w).
    """

    board: Board
    calibration: bytes
    camera: PadView | None
    ideal_px: npt.NDArray[np.float32] | None = None

    def px_per_mm(self, of_image: float) -> float:
        """Scale of the device's own view, where that of the image is `of_image`."""
        c = self.board.camera
        return of_image if self.ideal_px is None else c.focal_mpx / c.standoff_um

    def in_image(self, values: Array, size: tuple[int, int]) -> Array:
        """What the device has on its grid of depth cells, at every pixel of an image of `size` (width, height)."""
        import cv2

        whole = cv2.resize(values, size, interpolation=cv2.INTER_LINEAR)
        if self.ideal_px is None:
            return np.asarray(whole, dtype=np.float64)
        x, y = self.ideal_px
        moved = cv2.remap(whole, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(moved, dtype=np.float64)


def view_of(board: Board, file: CalibrationFile, shape: tuple[int, ...], px_per_mm: float) -> View:
    """The board itself where the images are its own, else a view of their size and scale with the same table.

    Nobody knows that view's lens: it has no perspective.
    """
    height, width = shape[:2]
    if (width, height) == (board.camera.width_px, board.camera.height_px):
        camera = pad_view(board, file.tensors, file.metadata)
        return View(board, file.data, camera, _ideal_px(board, camera) if isinstance(camera, MappedCamera) else None)
    step_px = 1 if max(width, height) <= 640 else 2
    stages = ["difference", "photometric", "poisson"]
    other = picture_board(shape, px_per_mm, stages, name=board.name, standoff_mm=FAR_MM, step_px=step_px)
    table = {name: tensor for name, tensor in file.tensors.items() if name.startswith("photometric.")}
    return View(other, pack(table, base_metadata(other)).data, None)


def _ideal_px(board: Board, camera: MappedCamera) -> npt.NDArray[np.float32]:
    """Where the ideal pinhole, whose slopes and depth the device has, sees what each pixel sees of the flat pad."""
    c = board.camera
    px = np.stack(np.meshgrid(np.arange(c.width_px), np.arange(c.height_px)), axis=-1)
    place_mm, _ = camera.rays(px.reshape(-1, 2).astype(float))
    ideal = [c.center_x_mpx / 1e3, c.center_y_mpx / 1e3] + place_mm * (c.focal_mpx / c.standoff_um)
    return np.asarray(ideal.T.reshape(2, *px.shape[:2]), dtype=np.float32)


@dataclass(frozen=True)
class Judgement:
    """One press on one circle: degrees, millimetres, ratio to the ball's, peak as it is and as the circle says."""

    normal_deg: float
    cap_rms_mm: float
    peak_to_edge: float
    peak_mm: float
    ball_peak_mm: float

    def row(self) -> dict[str, float]:
        """For --json."""
        return asdict(self)


@dataclass(frozen=True)
class Surface:
    """What the device made of one image, at every pixel: slope (h, w, 2), depth (h, w) in millimetres."""

    slope: Array
    depth_mm: Array


def _normals(slope: Array) -> Array:
    n = np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
    return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))


def normal_error_deg(presses: PressSet, circle: Press, seen: Surface) -> Array:
    """Angle to the ball's normal in the judged part of a circle, seen without perspective; elsewhere NaN."""
    shape = presses.reference.shape[:2]
    mask, slope = ball_slope(
        circle, shape, ball_radius_mm=presses.ball_mm / 2, px_per_mm=presses.px_per_mm, camera=None, inside=INSIDE
    )
    out = np.full(shape, np.nan)
    cosine = (_normals(seen.slope[mask]) * _normals(slope)).sum(axis=1)
    out[mask] = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return out


class Judge:
    """Presses of one set, seen in one view."""

    def __init__(self, presses: PressSet, view: View) -> None:
        self.presses, self.view = presses, view
        self.shape = presses.reference.shape[:2]
        self.ball_mm = presses.ball_mm / 2

    def contact_mm(self, circle: Press) -> float:
        """Radius of the contact on the flat pad."""
        if self.view.ideal_px is None or self.view.camera is None:
            return circle.radius_px / self.presses.px_per_mm
        middle_px = np.array([circle.center_x_px, circle.center_y_px])
        return circle.radius_px * mm_per_px(self.view.camera, middle_px, 0.0)

    def truth(self, circle: Press, inside: float) -> tuple[npt.NDArray[np.bool_], Array]:
        """Pixels inside a part of the circle, and the ball's slope there."""
        return ball_slope(
            circle, self.shape, ball_radius_mm=self.ball_mm, px_per_mm=self.presses.px_per_mm,
            camera=self.view.camera, inside=inside,
        )  # fmt: skip

    def _height(self, slope: Array) -> Array:
        """Of the ball's surface over its centre, where it has a slope, millimetres."""
        return np.asarray(-self.ball_mm / np.sqrt(1 + (slope**2).sum(axis=1)))

    def judge(self, circle: Press, seen: Surface) -> Judgement:
        """Errors inside the circle."""
        mask, slope = self.truth(circle, INSIDE)
        cosine = (_normals(seen.slope[mask]) * _normals(slope)).sum(axis=1)
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        apart = seen.depth_mm[mask] - self._height(slope)
        ratio, peak_mm = self._peak_to_edge(circle, seen)
        contact_mm = min(self.contact_mm(circle), self.ball_mm)
        ball_peak_mm = self.ball_mm - float(np.sqrt(self.ball_mm**2 - contact_mm**2))
        return Judgement(float(np.median(angle)), float(apart.std()), ratio, peak_mm, ball_peak_mm)

    def _peak_to_edge(self, circle: Press, seen: Surface) -> tuple[float, float]:
        """Height of the cap over the ball's, and the depth of its middle, millimetres."""
        mask, slope = self.truth(circle, INSIDE + RING)
        y, x = np.nonzero(mask)
        radius = np.hypot(x - circle.center_x_px, y - circle.center_y_px) / circle.radius_px
        is_peak, is_edge = radius < CENTER, radius > INSIDE - RING
        depth, height = seen.depth_mm[mask], self._height(slope)
        risen = height[is_edge].mean() - height[is_peak].mean()
        peak = float(depth[is_peak].mean())
        return float((depth[is_edge].mean() - peak) / risen), -peak

    def refit(self, circle: Press, seen: Surface) -> Press:
        """The circle near the marked one whose ball has the nearest normals, by a pattern search."""
        normals = _normals(seen.slope)

        def misfit(shift: Array) -> float:
            moved = _moved(circle, shift)
            mask, slope = self.truth(moved, INSIDE)
            return float(((normals[mask] - _normals(slope)) ** 2).sum(axis=1).mean())

        best = np.zeros(3)
        least = misfit(best)
        for step in REFIT_STEPS_PX:
            is_better = True
            while is_better:
                is_better = False
                for way in np.concatenate([np.eye(3), -np.eye(3)]) * step:
                    shift = best + way
                    if np.abs(shift).max() <= REFIT_PX and (value := misfit(shift)) < least:
                        best, least, is_better = shift, value, True
        return _moved(circle, best)


def _moved(circle: Press, shift: Array) -> Press:
    x, y, r = shift.tolist()
    return Press(circle.path, circle.center_x_px + x, circle.center_y_px + y, circle.radius_px + r)


def _surface(pipeline: Pipeline, view: View, image: npt.NDArray[np.uint8], px_per_mm: float | None = None) -> Surface:
    """Slope and depth of an image, brought to its pixels; with `px_per_mm` the slope is the depth's own."""
    import cv2

    pipeline.process(image)
    height, width = image.shape[:2]
    depth, size = pipeline.depth_m() * 1e3, (width, height)
    if px_per_mm is None:
        slope = pipeline.raw("slope") / 4096
    else:
        along_y, along_x = np.gradient(cv2.GaussianBlur(cv2.resize(depth, size), (0, 0), DEPTH_SMOOTHED_PX) * px_per_mm)
        slope = np.stack([along_x, along_y], axis=-1)
    return Surface(view.in_image(slope, size), view.in_image(depth, size))


def _read(path: Path, shape: tuple[int, ...]) -> npt.NDArray[np.uint8]:
    image = read_image(path)
    if image.shape[:2] != shape[:2]:
        height, width = image.shape[:2]
        raise InputError(f"{path}: is {width}x{height}, the reference is {shape[1]}x{shape[0]}: one size is needed")
    return image


def evaluate(
    presses: PressSet,
    file: CalibrationFile,
    board: Board,
    untouched: list[Path],
    references: list[Path],
    *,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[dict[str, Any], list[Surface]]:
    """Judge every press and every untouched image; the result for `--json`, and the surfaces for the picture.

    Without `untouched` images each of several `references` is judged on the mean of the others.
    """
    view = view_of(board, file, presses.reference.shape, presses.px_per_mm)
    judge = Judge(presses, view)
    is_of_depth = has_depth_table(file)
    own_slope = view.px_per_mm(presses.px_per_mm) if is_of_depth else None
    rows, surfaces = [], []
    with Pipeline(view.board, view.calibration) as pipeline:
        pipeline.set_rest(presses.reference)
        for done, press in enumerate(presses.presses):
            seen = _surface(pipeline, view, _read(press.path, presses.reference.shape), own_slope)
            best = judge.refit(press, seen)
            rows.append({
                "image": press.path.name,
                "at_equator": judge.contact_mm(press) >= EQUATOR * judge.ball_mm,
                "marked": judge.judge(press, seen).row(), "refitted": judge.judge(best, seen).row(),
                "correction_px": [best.center_x_px - press.center_x_px, best.center_y_px - press.center_y_px,
                                  best.radius_px - press.radius_px],
            })  # fmt: skip
            surfaces.append(seen)
            progress((done + 1) / len(presses.presses))
        still = _untouched(pipeline, view, presses, untouched, references)
    result = {
        "source": "intensity" if is_of_depth else "colour", **presses.circle_report(),
        "circles_text": presses.circle_text(),
        "board": board.name, "is_own_view": view.board is board, "has_measured_camera": view.ideal_px is not None,
        "inside": INSIDE, "n_presses": len(rows), "marked": summary(rows, "marked"),
        "refitted": summary(rows, "refitted"),
        "untouched": {"n": len(still), "rms_um": still, "worst_um": max(still) if still else None}, "presses": rows,
    }  # fmt: skip
    return result, surfaces


def _untouched(
    pipeline: Pipeline, view: View, presses: PressSet, images: list[Path], references: list[Path]
) -> list[float]:
    """RMS depth of each untouched image, micrometres."""
    shape = presses.reference.shape
    pairs = [(_read(path, shape), presses.reference) for path in images]
    if not images and len(references) > 1:
        total = presses.reference * len(references)
        for path in references:
            image = _read(path, shape)
            pairs.append((image, (total - image) / (len(references) - 1)))
    out = []
    for image, rest in pairs:
        pipeline.set_rest(rest)
        out.append(float(np.sqrt((_surface(pipeline, view, image).depth_mm ** 2).mean()) * 1e3))
    return out


def summary(rows: list[dict[str, Any]], circle: str) -> dict[str, float]:
    """Median and worst over the presses; heights of presses at the equator are left out."""
    normal = [row[circle]["normal_deg"] for row in rows]
    cap = [row[circle]["cap_rms_mm"] for row in rows]
    height = [row[circle]["peak_to_edge"] for row in rows if not row["at_equator"]] or [float("nan")]
    return {
        "normal_median_deg": float(np.median(normal)), "normal_worst_deg": max(normal),
        "cap_median_mm": float(np.median(cap)), "cap_worst_mm": max(cap),
        "peak_to_edge_median": float(np.median(height)),
        "peak_to_edge_least": min(height), "peak_to_edge_most": max(height),
    }  # fmt: skip


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    lines = [
        f"{result['n_presses']} presses, inside {result['inside']} of the contact radius; "
        f"{result['circles_text']} | refitted within {REFIT_PX:.0f} px"
        + ("; camera as measured" if result["has_measured_camera"] else ""),
    ]
    shown = (("normal_deg", ".2f"), ("cap_rms_mm", ".4f"), ("peak_to_edge", ".3f"))
    lines += aligned(("image", "normals, deg", "cap RMS, mm", "peak to edge", "dx, dy, dr px", ""), [
        (
            row["image"], *(f"{row['marked'][key]:{form}} | {row['refitted'][key]:{form}}" for key, form in shown),
            " ".join(f"{v:+5.2f}" for v in row["correction_px"]), "at the equator" if row["at_equator"] else "",
        )
        for row in result["presses"]
    ])  # fmt: skip
    for name in ("marked", "refitted"):
        s = result[name]
        lines.append(
            f"{name}: normals {s['normal_median_deg']:.2f} deg median, {s['normal_worst_deg']:.2f} worst; cap "
            f"{s['cap_median_mm']:.4f} mm median, {s['cap_worst_mm']:.4f} worst; peak to edge "
            f"{s['peak_to_edge_median']:.3f} median, {s['peak_to_edge_least']:.3f} to {s['peak_to_edge_most']:.3f}"
        )
    if result["source"] == "intensity":
        for row in result["presses"]:
            deep, ball = row["marked"]["peak_mm"], row["marked"]["ball_peak_mm"]
            lines.append(f"{row['image']}: {deep:.3f} mm deep, {ball:.3f} by ball and circle")
    still = result["untouched"]
    lines.append(
        f"untouched: {still['n']} images, worst RMS {still['worst_um']:.3f} um"
        if still["n"]
        else "untouched: not judged, there is no second untouched image (--untouched DIR)"
    )
    lines += [f"skipped {skipped['image']}: {skipped['reason']}" for skipped in result["skipped"]]
    return "\n".join(lines)
