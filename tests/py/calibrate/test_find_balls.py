"""Contacts found without marks: on drawn balls in gel that slopes on outside them, and what is skipped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.errors import InputError
from ruffini.estimators.photometric import find_balls as find_balls_module
from ruffini.estimators.photometric.change import Rest
from ruffini.estimators.photometric.circle import Circle
from ruffini.estimators.photometric.find_balls import NotFound, find_balls
from ruffini.estimators.photometric.presses import load_presses

BALL_PX = 40.0
N = 5  # presses of a folder
SHAPE = (160, 200)
LAMPS = np.array([[0.5, 0.1], [-0.2, 0.45], [-0.25, -0.5]])  # relative change of B, G, R per unit normal x, y
Image = npt.NDArray[np.float64]
Triple = tuple[float, float, float]
Spoil = Callable[[Image, np.random.Generator, bool], Image]
PLACE_Y, PLACE_X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)


def light(*circles: Triple, power: int = 2) -> Image:
    """Relative light of balls in gel: their slope inside, falling off with a power of the distance outside."""
    normal = np.zeros((*SHAPE, 2))
    for x, y, radius in circles:
        dx, dy = PLACE_X - x, PLACE_Y - y
        away = np.hypot(dx, dy)
        inward = (
            np.where(away < radius, away, radius * np.exp(-(np.maximum((away - radius) / 18, 0) ** power))) / BALL_PX
        )
        normal += (inward / np.maximum(away, 1e-6))[..., None] * np.stack([dx, dy], axis=-1)
    near = 1 + 0.15 * (PLACE_X / SHAPE[1] - 0.5)[..., None]
    return np.asarray(1 + near * (normal @ LAMPS.T))


def as_it_is(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
    return 110 * level


def dark(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
    return 27 * level


def dark_corners(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
    """3 % of the middle's light in the corners."""
    away = np.hypot(PLACE_X / SHAPE[1] - 0.5, PLACE_Y / SHAPE[0] - 0.5) / np.hypot(0.5, 0.5)
    return np.asarray(120 * level * (0.03 + 0.97 * np.clip(1 - away**2, 0, 1) ** 2)[..., None])


def gradients(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
    """One lamp a side: 15 % of its light on the far side."""
    x, y = PLACE_X / SHAPE[1], PLACE_Y / SHAPE[0]
    return np.asarray(150 * level * np.stack([0.15 + 0.85 * x, 0.15 + 0.85 * y, 1 - 0.85 * x], axis=-1))


def warm(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
    """Lamps off by 5 % since the reference, with 4 % of spread."""
    if not is_press:
        return 110 * level
    gain = 1 + rng.uniform(-0.05, 0.05, 3) + rng.uniform(-0.04, 0.04, 3) * (PLACE_X / SHAPE[1] - 0.5)[..., None]
    return np.asarray(110 * level * gain)


def dotted(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
    """Printed dots, which move by a pixel and a half under a press."""
    shift = 1.5 * is_press
    near = np.hypot((PLACE_X - shift) % 16 - 8, PLACE_Y % 16 - 8)
    return np.asarray(110 * level * np.where(near < 2.5, 0.35, 1.0)[..., None])


def compressed(quality: int) -> Spoil:
    def spoil(level: Image, rng: np.random.Generator, is_press: bool) -> Image:
        coded = cv2.imencode(".jpg", picture(110 * level, rng).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return cv2.imdecode(coded, cv2.IMREAD_COLOR).astype(float)

    return spoil


def picture(level: Image, rng: np.random.Generator) -> Image:
    return np.clip(np.round(level + rng.normal(0, 1.5, level.shape)), 0, 255)


def presses(n: int, spoil: Spoil = as_it_is, power: int = 2) -> tuple[list[Image], Image, list[Triple]]:
    rng = np.random.default_rng(8)
    circles = [(rng.uniform(55, 145), rng.uniform(50, 110), rng.uniform(18, 30)) for _ in range(n)]
    reference = np.mean([picture(spoil(light(), rng, False), rng) for _ in range(4)], axis=0)
    return [picture(spoil(light(c, power=power), rng, True), rng) for c in circles], reference, circles


def found_in(images: list[Image], reference: Image, ball_px: float = BALL_PX) -> list[Circle | NotFound]:
    rest = Rest(reference)
    return kept(find_balls, [rest.change(image) for image in images], ball_px)


# The bounds are in pixels of a contact of 18 to 30: of the centre's, and of the radius's largest error.
GELS = {
    "as it is": (as_it_is, 1.0, 2.0), "four times darker": (dark, 1.5, 3.0), "dark corners": (dark_corners, 2.0, 3.0),
    "gradients": (gradients, 2.0, 3.0), "warm lamps": (warm, 1.5, 2.5), "dotted": (dotted, 1.5, 2.5),
    "jpeg 90": (compressed(90), 1.0, 2.0), "jpeg 75": (compressed(75), 1.0, 2.0), "jpeg 50": (compressed(50), 1.5, 2.5),
}  # fmt: skip


@pytest.mark.parametrize("gel", GELS)
def test_centres_and_radii_are_found(gel: str) -> None:
    spoil, centre_px, radius_px = GELS[gel]
    images, reference, truth = presses(N, spoil)
    found = [c for c in found_in(images, reference) if isinstance(c, Circle)]
    assert len(found) == N
    apart = np.array([[f.center_x_px, f.center_y_px, f.radius_px] for f in found]) - truth
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < centre_px, apart
    assert np.abs(apart[:, 2]).max() < radius_px, apart
    stated = np.median([f.center_sigma_px for f in found])
    assert 0.02 < stated < 1.5
    assert np.median(np.hypot(apart[:, 0], apart[:, 1])) < 3 * stated


def test_radii_are_found_where_the_slope_has_a_kink_at_the_edge() -> None:
    images, reference, truth = presses(N, power=1)
    found = [c for c in found_in(images, reference) if isinstance(c, Circle)]
    assert len(found) == N
    assert np.abs([f.radius_px - t[2] for f, t in zip(found, truth, strict=True)]).max() < 1.0


def test_a_picture_of_more_pixels_is_found_in_its_own() -> None:
    images, reference, truth = presses(4)
    larger = [cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_LINEAR) for image in [reference, *images]]
    for circle, (x, y, _) in zip(found_in(larger[1:], larger[0], 3 * BALL_PX), truth, strict=True):
        assert isinstance(circle, Circle)
        assert np.hypot(circle.center_x_px - 3 * x - 1, circle.center_y_px - 3 * y - 1) < 3.0


def noise(rest: Image, sigma: float, blur: float) -> Image:
    rough = np.random.default_rng(2).normal(0, 1, rest.shape)
    return rough if not blur else cv2.GaussianBlur(rough, (0, 0), blur) * 2 * blur * np.sqrt(np.pi) * sigma


RANDOM = np.random.default_rng(1)
BAD: dict[str, tuple[Callable[[Image], Image], str]] = {
    "untouched": (lambda rest: rest + RANDOM.normal(0, 1.5, rest.shape), "no more than"),
    "random colours": (lambda rest: (rest * (1 + noise(rest, 0.3, 8))).clip(0, 250), "nothing round|colours|edge|two"),
    "two balls": (lambda rest: 110 * light((50, 80, 22), (145, 75, 22)), "two contacts"),
    "beyond the border": (lambda rest: 110 * light((-8, 80, 24)), "in the picture|colours|round|edge"),
    "other colours": (lambda rest: 110 * light((90, 80, 25))[..., ::-1], "colours do not fit"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_no_press_is_skipped_with_its_reason(what: str) -> None:
    import re

    spoil, message = BAD[what]
    images, reference, _ = presses(N)
    *good, bad = found_in([*images, spoil(reference)], reference)
    assert isinstance(bad, NotFound)
    assert re.search(message, bad.reason), bad.reason
    assert all(isinstance(c, Circle) for c in good)


def test_a_circle_without_a_single_pixel_has_no_second_opinion() -> None:
    images, reference, _ = presses(1)
    change = Rest(reference).change(images[0])
    unmix = np.zeros((9, 2))
    place, explained = find_balls_module._improved(change, Circle(-90, -90, 5), (-90.0, -90.0), unmix, BALL_PX, 1)
    assert (place, explained) == ((-90.0, -90.0), 0.0)


def test_a_press_at_the_border_is_found() -> None:
    images, reference, _ = presses(N)
    circle = found_in([*images, picture(110 * light((20, 80, 26)), RANDOM)], reference)[-1]
    assert isinstance(circle, Circle)
    assert np.hypot(circle.center_x_px - 20, circle.center_y_px - 80) < 2.0


def write(folder: Path, images: list[Image], reference: Image) -> None:
    cv2.imwrite(str(folder / "reference.png"), reference)
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"{i}.png"), image)


def test_a_folder_without_a_table_is_searched_and_bad_pictures_are_listed(tmp_path: Path) -> None:
    images, reference, truth = presses(6)
    write(tmp_path, [*images, np.zeros_like(reference), np.full_like(reference, 255), reference[:100]], reference)
    (tmp_path / "9.png").write_text("no picture")
    found = load_presses(tmp_path, ball_mm=2 * BALL_PX / 10, px_per_mm=10, may_find=True)
    assert found.is_found
    assert [p.path.name for p in found.presses] == [f"{i}.png" for i in range(6)]
    assert abs(found.presses[3].center_x_px - truth[3][0]) < 1.0
    reasons = {s.path.name: s.reason for s in found.skipped}
    assert list(reasons) == ["6.png", "7.png", "8.png", "9.png"]
    for name, words in {"6.png": "black", "7.png": "overexposed", "8.png": "200x100", "9.png": "cannot read"}.items():
        assert words in reasons[name]
    assert "px, " in found.circle_text()
    with pytest.raises(InputError, match=r"presses\.csv is missing"):
        load_presses(tmp_path, ball_mm=2 * BALL_PX / 10, px_per_mm=10)


@pytest.mark.parametrize(
    ("ball_mm", "words"), [(2.0, "the diameter, not the radius"), (8e3, "in millimetres"), (8e-3, "in millimetres")]
)
def test_an_implausible_ball_is_said(tmp_path: Path, ball_mm: float, words: str) -> None:
    rng = np.random.default_rng(8)
    reference = picture(110 * light(), rng)
    write(tmp_path, [picture(110 * light((x, 80, 28)), rng) for x in (70, 90, 110, 130)], reference)
    with pytest.raises(InputError, match=words):
        load_presses(tmp_path, ball_mm=ball_mm, px_per_mm=10, may_find=True)


def test_untouched_dark_corners_do_not_look_pressed() -> None:
    rng = np.random.default_rng(3)
    reference = np.round(dark_corners(light(), rng, False))
    assert reference.min() < 8  # in the corners, below any level that a division could be floored at
    assert not Rest(reference).change(reference).light.any()
