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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.estimators.photometric.change import Change, Rest
from ruffini.estimators.photometric.find_balls import NotFound, find_balls
from ruffini.estimators.photometric.find_discs import find_discs, is_monochrome
from ruffini.estimators.photometric.pad_view import PadView, mm_per_px
from ruffini.files import readable
from ruffini.frames import image_files, read_image
from ruffini.older_python import tomllib

Array = npt.NDArray[np.float64]
COLUMNS = ("image", "center_x_px", "center_y_px", "contact_radius_px")
# Of the contact radius: further out the gel already leaves the ball, and the mark's error of 1-2 px is a slope error of
# up to 12 %. Recorded presses left out of the fit, circles refitted, normals alike: cap 0.054 mm, peak to edge 0.97
# (0.89 to 1.05) with 0.75; 0.064 mm, 0.99 (0.91 to 1.08) with 0.80. Depth under the twin's touches is off by 28, 40 um.
FITTED_INSIDE = 0.75
LEAST_PIXELS = 50  # of a press, inside the part of its circle that is fitted
BLACK_LEVEL, BLACK_SHARE = 8.0, 0.1  # grey levels, and of the reference's mean
FULL_LEVEL = 255.0
FULL_SHARE = 0.4  # of pixels, in any channel, beyond the reference's; recorded presses reach 0.19, beside the lamps
LEAST_BALL_PX, MOST_BALL = 10.0, 20.0  # diameter; the latter in sides of the picture
WIDEST_CONTACT = 1.1  # of the ball's radius: marks by hand are not exact
SAME_PX = 2.0  # between two circles: marks by hand of one contact agree so well
LOOKED_AT_PX = 4  # every so many pixels of a picture
SAME_LEVELS = 0.5  # mean difference of two pictures, grey levels: below, one is a copy of the other
LISTED = 5  # reasons in a message
DARKEST_REST = 32.0  # grey levels of the lamps' light below which a ratio says little (firmware/image/rest.h)


@dataclass(frozen=True)
class Press:
    """One image of the ball in the gel; circle in pixels of that image."""

    path: Path
    center_x_px: float
    center_y_px: float
    radius_px: float
    center_sigma_px: float = 0.0  # one standard deviation, of circles that were found
    radius_sigma_px: float = 0.0


@dataclass(frozen=True)
class Skipped:
    """An image that is not used, and why."""

    path: Path
    reason: str


@dataclass(frozen=True)
class PressSet:
    """Ball presses of one unit: `reference` (h, w, 3) float64 mean of the untouched images, B G R."""

    presses: list[Press]
    reference: Array
    ball_mm: float
    px_per_mm: float
    is_found: bool = False  # circles without marks by hand
    dark: Array | None = None  # (h, w, 3) grey levels with the lamps off, where they were measured
    skipped: tuple[Skipped, ...] = ()

    def less(self, dark: Array | None) -> PressSet:
        """The same with what the camera shows without lamps taken off, where that is known.

        Raises
        ------
        InputError
            The presses are of another size.
        """
        if dark is not None and (dark.ndim != 3 or dark.shape[2] != 3):
            shape = " x ".join(map(str, dark.shape))
            raise InputError(f"the dark frame is an array of {shape}, not rows x columns x 3: measure it again with "
                             "`ruffini cal fit --only dark`")  # fmt: skip
        if dark is not None and dark.shape != self.reference.shape:
            (height, width), (dark_height, dark_width) = self.reference.shape[:2], dark.shape[:2]
            raise InputError(
                f"the dark frame is {dark_width}x{dark_height}, the presses are {width}x{height}: measure it again "
                "with `ruffini cal fit --only dark`"
            )
        return replace(self, dark=dark)

    def n_places(self) -> int:
        """Number of presses that differ by more than `SAME_PX` in place or size."""
        kept: list[tuple[float, float, float]] = []
        for press in self.presses:
            circle = (press.center_x_px, press.center_y_px, press.radius_px)
            if all(max(abs(a - b) for a, b in zip(circle, other, strict=True)) > SAME_PX for other in kept):
                kept.append(circle)
        return len(kept)

    def circle_report(self) -> dict[str, Any]:
        """How the circles were made, how well they are known, and the presses that were skipped."""
        report: dict[str, Any] = {"circles": "found" if self.is_found else "marked"}
        if self.is_found:
            sigma = float(np.median([press.center_sigma_px for press in self.presses]))
            report["center_sigma_px"] = round(sigma, 2)
            report["radius_sigma_px"] = round(float(np.median([p.radius_sigma_px for p in self.presses])), 2)
            report["center_sigma_deg"] = round(float(np.degrees(sigma / (self.ball_mm / 2 * self.px_per_mm))), 2)
        report["skipped"] = [{"image": skipped.path.name, "reason": skipped.reason} for skipped in self.skipped]
        return report

    def circle_text(self) -> str:
        """The circles in words: `circles found to 0.70 px, 0.90 deg of slope`."""
        report = self.circle_report()
        text = f"circles {report['circles']}"
        if self.is_found:
            text += f" to {report['center_sigma_px']:.2f} px, {report['center_sigma_deg']:.2f} deg of slope"
        return text

    def skipped_text(self) -> str:
        """A line for each press that was skipped; empty if none was."""
        return "".join(f"\nskipped {skipped.path.name}: {skipped.reason}" for skipped in self.skipped)


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
    may_find : find the contacts automatically if there is no table.

    A picture that is unreadable, black, overexposed, of another size or without this ball's contact is skipped, with
    its reason in `PressSet.skipped`.

    Raises
    ------
    InputError
        Missing file or column, unreadable number, unknown or implausible ball or scale, too few presses remain.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of ball presses")
    settings = {}
    if (folder / "presses.toml").is_file():
        try:
            settings = tomllib.loads(readable(folder / "presses.toml").read_text(encoding="utf-8"))
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
    ball, scale = float(ball), float(scale)
    _check_ball(ball, scale, reference)
    table = truth or folder / "presses.csv"
    is_found = may_find and truth is None and not table.is_file()
    if is_found:
        presses, skipped = _found(folder, reference, ball / 2 * scale)
    else:
        marked = [_parse_row(folder, table, i, row) for i, row in enumerate(_rows(table))]
        if marked:
            _check_radii(marked, ball, scale)
        presses, skipped = _usable(marked, reference, ball / 2 * scale)
    if len(presses) < at_least:
        where = f"{folder} holds" if is_found else f"{table} lists"
        reasons = "".join(f"; {s.path.name}: {s.reason}" for s in skipped[:LISTED])
        advice = " (take those pictures again, or mark their circles in presses.csv)" if is_found and skipped else ""
        raise InputError(f"{where} {len(presses)} usable presses: at least {at_least} are needed{reasons}{advice}")
    _check_radii(presses, ball, scale)
    return PressSet(presses, reference, ball, scale, is_found, skipped=tuple(skipped))


def _check_ball(ball_mm: float, px_per_mm: float, reference: Array) -> None:
    """Refuse a ball that no camera could see on the pad: metres, micrometres, or a scale turned over."""
    width_px, side_px = ball_mm * px_per_mm, max(reference.shape[:2])
    if not LEAST_BALL_PX <= width_px <= MOST_BALL * side_px:
        raise InputError(
            f"a ball of {ball_mm:g} mm at {px_per_mm:g} px/mm would be {width_px:.3g} px wide in pictures of {side_px} "
            "px: give --ball-mm as the diameter in millimetres and --px-per-mm as pixels a millimetre"
        )


def _check_radii(presses: list[Press], ball_mm: float, px_per_mm: float) -> None:
    """Refuse contacts that are wider than the ball."""
    contact_mm = float(np.median([press.radius_px for press in presses])) / px_per_mm
    if contact_mm > WIDEST_CONTACT * ball_mm / 2:
        raise InputError(
            f"contacts have a radius of {contact_mm:.2f} mm, the ball of {ball_mm:g} mm only {ball_mm / 2:.2f} mm: "
            "give --ball-mm as the diameter, not the radius, and check --px-per-mm"
        )


def _usable(presses: list[Press], reference: Array, ball_px: float) -> tuple[list[Press], list[Skipped]]:
    """Marked presses whose picture shows something, and the others."""
    kept, skipped = [], []
    rows, columns = np.indices(reference.shape[:2])
    copies = _Copies()
    for press in presses:
        try:
            if press.radius_px > WIDEST_CONTACT * ball_px:
                raise InputError(f"its circle has a radius of {press.radius_px:.3g} px, the ball only {ball_px:.3g} px")
            copies.check(press.path, _checked_image(press.path, reference))
            away = np.hypot(columns - press.center_x_px, rows - press.center_y_px)
            n_inside = int((away < FITTED_INSIDE * press.radius_px).sum())
            if n_inside < LEAST_PIXELS:
                raise InputError(f"only {n_inside} pixels of the picture are inside its circle: is the circle right?")
        except InputError as error:
            skipped.append(Skipped(press.path, str(error)))
        else:
            kept.append(press)
    return kept, skipped


class _Copies:
    """Pictures seen so far, small, to find those that are there twice."""

    def __init__(self) -> None:
        self._seen: list[tuple[Path, Array]] = []

    def check(self, path: Path, image: Array) -> None:
        """Remember a picture; raises InputError if it is a copy of one before."""
        looked = image[::LOOKED_AT_PX, ::LOOKED_AT_PX]
        for other, before in self._seen:
            if np.abs(looked - before).mean() < SAME_LEVELS:
                raise InputError(f"the same picture as {other.name}")
        self._seen.append((path, looked))


def _checked_image(path: Path, reference: Array) -> Array:
    """A picture (h, w, 3) that may show a press; raises `InputError` with the reason if it does not."""
    image = read_image(path).astype(float)
    if image.shape != reference.shape:
        height, width = image.shape[:2]
        raise InputError(
            f"the picture is {width}x{height}, the reference {reference.shape[1]}x{reference.shape[0]} pixels: "
            "one size is needed"
        )
    if image.max() < BLACK_LEVEL or image.mean() < BLACK_SHARE * reference.mean():
        raise InputError("the picture is black: was the light off, or the lens covered?")
    if (image >= FULL_LEVEL).any(axis=2).mean() > FULL_SHARE + (reference >= FULL_LEVEL).any(axis=2).mean():
        raise InputError("the picture is overexposed: take it again with less exposure or light")
    return image


def _found(folder: Path, reference: Array, ball_radius_px: float) -> tuple[list[Press], list[Skipped]]:
    """All images that are no reference, with the contact that each shows, and those without one."""
    pressed = folder / "press" if (folder / "press").is_dir() else folder
    paths = sorted(folder.glob("press_sample*.png"))
    if not paths:
        paths = [p for p in image_files(pressed) if not p.name.startswith(("reference", "press_ref"))]
    rest = Rest(reference)
    changes: dict[Path, Change] = {}
    reasons: dict[Path, str] = {}
    copies = _Copies()
    for path in paths:
        try:
            image = _checked_image(path, reference)
            copies.check(path, image)
            changes[path] = rest.change(image)
        except InputError as error:
            reasons[path] = str(error)
    seen = list(changes.values())
    circles = find_discs(seen) if is_monochrome(seen) else find_balls(seen, ball_radius_px)
    presses = []
    for path, circle in zip(changes, circles, strict=True):
        if isinstance(circle, NotFound):
            reasons[path] = f"ball not found: {circle.reason}"
        else:
            presses.append(Press(path, circle.center_x_px, circle.center_y_px, circle.radius_px,
                                 circle.center_sigma_px, circle.radius_sigma_px))  # fmt: skip
    return presses, [Skipped(path, reasons[path]) for path in paths if path in reasons]


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
        with readable(table).open(newline="", encoding="utf-8-sig") as stream:
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
