"""A folder of ball presses with known ball and contact circle, and the slope that each pixel must see.

Layout: `reference.png` (or several `reference*.png`, averaged; or `press_ref*.png` beside `press_sample*.png`), press
images, and `presses.csv` with
columns image, center_x_px, center_y_px, contact_radius_px (for a fit they are found where nobody marked
them: find_balls.py); optionally `presses.toml` with ball_mm and px_per_mm.

Only pixels inside the contact have a known slope: the gel outside it still slopes, out to
about three contact radii, so "flat outside" is neither truth nor a label.
"""

from __future__ import annotations

import csv
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.find_balls import find_balls
from ruffini.calibrate.pad_view import PadView, mm_per_px
from ruffini.errors import InputError
from ruffini.frames import image_files, read_image

Array = npt.NDArray[np.float64]
COLUMNS = ("image", "center_x_px", "center_y_px", "contact_radius_px")
# Of the contact radius: further out the gel already leaves the ball, and the mark's error of 1-2 px is a slope error of
# up to 12 %. Recorded presses left out of the fit, circles refitted, normals alike: cap 0.054 mm, peak to edge 0.97
# (0.89 to 1.05) with 0.75; 0.064 mm, 0.99 (0.91 to 1.08) with 0.80. Depth under the twin's touches is off by 28, 40 um.
FITTED_INSIDE = 0.75
DARKEST_REST = 32.0  # grey levels of the lamps' light below which a ratio says little (firmware/image/rest.h)


@dataclass(frozen=True)
class Press:
    """One image of the ball in the gel; circle in pixels of that image."""

    path: Path
    center_x_px: float
    center_y_px: float
    radius_px: float


@dataclass(frozen=True)
class PressSet:
    """Ball presses of one unit: `reference` (h, w, 3) float64 mean of the untouched images, B G R."""

    presses: list[Press]
    reference: Array
    ball_mm: float
    px_per_mm: float
    is_found: bool = False  # circles without marks by hand
    dark: Array | None = None  # (h, w, 3) grey levels with the lamps off, where they were measured


def load_presses(
    folder: Path,
    *,
    ball_mm: float | None = None,
    px_per_mm: float | None = None,
    truth: Path | None = None,
    at_least: int = 3,
    may_find: bool = False,
) -> PressSet:
    """Read a press folder; arguments win over `presses.toml`, `truth` over `presses.csv`.

    at_least : number of presses that a fit needs; judging does with one.
    may_find : look for the contacts where there is no table; for a fit, never for judging.

    Raises
    ------
    InputError
        Missing file or column, unreadable number, image of another size, unknown ball or scale, ball not found.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of ball presses")
    settings = {}
    if (folder / "presses.toml").is_file():
        try:
            settings = tomllib.loads((folder / "presses.toml").read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{folder / 'presses.toml'}: not TOML: {error}") from error
    ball = ball_mm if ball_mm is not None else settings.get("ball_mm")
    scale = px_per_mm if px_per_mm is not None else settings.get("px_per_mm")
    if ball is None or scale is None:
        raise InputError(f"{folder} does not say its ball and scale: give --ball-mm (diameter) and --px-per-mm")
    if not (ball > 0 and scale > 0):
        raise InputError(f"ball_mm and px_per_mm must be positive, got {ball} and {scale}")
    references = reference_images(folder)
    reference = np.mean([read_image(p).astype(float) for p in references], axis=0)
    table = truth or folder / "presses.csv"
    is_found = may_find and truth is None and not table.is_file()
    if is_found:
        presses = _found(folder, reference, ball / 2 * scale)
    else:
        presses = [_parse_row(folder, table, i, row) for i, row in enumerate(_rows(table))]
    if len(presses) < at_least:
        where = f"{folder} holds" if is_found else f"{table} lists"
        raise InputError(f"{where} {len(presses)} presses: at least {at_least} are needed")
    return PressSet(presses, reference, float(ball), float(scale), is_found)


def _found(folder: Path, reference: Array, ball_radius_px: float) -> list[Press]:
    """All images that are no reference, with the contact that each shows."""
    from ruffini.calibrate.intensity import find_discs, is_monochrome

    pressed = folder / "press" if (folder / "press").is_dir() else folder
    paths = sorted(folder.glob("press_sample*.png"))
    if not paths:
        paths = [p for p in image_files(pressed) if not p.name.startswith(("reference", "press_ref"))]
    images = [read_image(p).astype(float) for p in paths]
    if images and all(i.shape == reference.shape for i in images) and is_monochrome(images, reference):
        circles = find_discs(images, reference, paths)
    else:
        circles = find_balls(images, reference, ball_radius_px, paths)
    return [Press(path, c.center_x_px, c.center_y_px, c.radius_px) for path, c in zip(paths, circles, strict=True)]


def reference_images(folder: Path) -> list[Path]:
    """Images of the untouched pad in a press folder, at least one."""
    references = sorted(folder.glob("reference*.png")) or sorted(folder.glob("press_ref*.png"))
    if not references:
        raise InputError(f"{folder} has no reference.png: one image of the untouched pad is needed")
    return references


def _rows(table: Path) -> list[dict[str, str]]:
    if not table.is_file():
        raise InputError(f"{table} is missing: it lists the contact circle of each press")
    try:
        with table.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            missing = [c for c in COLUMNS if c not in (reader.fieldnames or [])]
            if missing:
                raise InputError(f"{table} lacks the columns {', '.join(missing)}")
            return list(reader)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table}: not a CSV text: {error}") from error


def _parse_row(folder: Path, table: Path, index: int, row: dict[str, str]) -> Press:
    path = next((p for p in (folder / row["image"], folder / "press" / row["image"]) if p.is_file()), None)
    if path is None:
        raise InputError(f"{table} row {index + 1}: no image {row['image']!r} in {folder}")
    try:
        numbers = [float(row[c]) for c in COLUMNS[1:]]
    except (TypeError, ValueError) as error:
        raise InputError(f"{table} row {index + 1}: {error}") from error
    if not np.isfinite(numbers).all() or numbers[2] <= 0:
        raise InputError(f"{table} row {index + 1}: circle {numbers} is not finite and positive")
    return Press(path, *numbers)


def relative_change(image: Array, reference: Array, dark: Array | None = None) -> Array:
    """d = I / I_rest - 1 per channel, or (I - I_rest) / (I_rest - dark), as the firmware's difference stage."""
    if dark is not None:
        return np.asarray((image - reference) / np.maximum(reference - dark, DARKEST_REST))
    return np.asarray(image / np.maximum(reference, 1.0) - 1.0)


def ball_slope(
    press: Press,
    shape: tuple[int, int],
    *,
    ball_radius_mm: float,
    px_per_mm: float,
    camera: PadView | None,
    inside: float = FITTED_INSIDE,
) -> tuple[npt.NDArray[np.bool_], Array]:
    """Slope of the ball's surface at the pixels well inside the contact.

    The pad is pressed from +z, so the surface is the ball's lower half, z = z_c - sqrt(R^2 - r^2),
    with slope (x, y) / sqrt(R^2 - r^2). With a `camera` the pixel's ray is met with that surface:
    pressed gel is nearer to the lens, hence larger in the image. The edge of the contact lies
    about a^2 / (2 R) deep (Hertz), which sets z_c well enough (0.1 mm there is 0.5 % of scale).

    Returns
    -------
    mask : (h, w) bool
        Pixels within `inside` times the contact radius.
    slope : (n, 2) float64
        (dz/dx, dz/dy) at the pixels of the mask.
    """
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    dx_px, dy_px = columns - press.center_x_px, rows - press.center_y_px
    mask = np.hypot(dx_px, dy_px) < inside * press.radius_px
    if camera is None:
        x, y = dx_px[mask] / px_per_mm, dy_px[mask] / px_per_mm
    else:
        px = np.stack([columns[mask], rows[mask]], axis=1).astype(float)
        x, y = _on_ball(press, px, ball_radius_mm, camera)
    radius2 = np.minimum(x**2 + y**2, 0.98 * ball_radius_mm**2)
    return mask, np.stack([x, y], axis=1) / np.sqrt(ball_radius_mm**2 - radius2)[:, None]


def _on_ball(press: Press, px: Array, ball_mm: float, camera: PadView) -> tuple[Array, Array]:
    """Pad coordinates, from the ball's centre, where the rays of image places (n, 2) meet the ball."""
    middle_px = np.array([press.center_x_px, press.center_y_px])
    contact_mm = min(press.radius_px * mm_per_px(camera, middle_px, 0.0), 0.98 * ball_mm)
    edge_z = -(contact_mm**2) / (2 * ball_mm)
    contact_mm = min(press.radius_px * mm_per_px(camera, middle_px, edge_z), 0.98 * ball_mm)
    center_z = edge_z + np.sqrt(ball_mm**2 - contact_mm**2)
    place, slope = camera.rays(middle_px[None])
    middle = place + slope * edge_z
    place, slope = camera.rays(px)
    z = np.full(len(px), edge_z)
    for _ in range(6):  # fixed point: each round gains a factor of about 10
        x, y = (place + slope * z[:, None] - middle).T
        z = center_z - np.sqrt(np.maximum(ball_mm**2 - x**2 - y**2, 0.02 * ball_mm**2))
    return x, y
