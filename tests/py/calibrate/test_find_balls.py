"""Contacts found without marks: on drawn balls in gel that slopes on outside them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from ruffini.calibrate.find_balls import find_balls
from ruffini.calibrate.presses import load_presses
from ruffini.errors import InputError

BALL_PX = 40.0
SHAPE = (160, 200)
LAMPS = np.array([[0.5, 0.1], [-0.2, 0.45], [-0.25, -0.5]])  # relative change of B, G, R per unit normal x, y
Image = npt.NDArray[np.float64]


def draw(rng: np.random.Generator, circle: tuple[float, float, float] | None) -> Image:
    """A ball in gel: its slope inside the circle, falling off as a Gaussian of the distance outside; near lamps."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    normal = np.zeros((*SHAPE, 2))
    if circle is not None:
        dx, dy = x - circle[0], y - circle[1]
        away = np.hypot(dx, dy)
        inward = np.where(away < circle[2], away, circle[2] * np.exp(-(((away - circle[2]) / 18) ** 2))) / BALL_PX
        normal = (inward / np.maximum(away, 1e-6))[..., None] * np.stack([dx, dy], axis=-1)
    near = 1 + 0.15 * (x / SHAPE[1] - 0.5)[..., None]
    level = 110 * (1 + near * (normal @ LAMPS.T)) + rng.normal(0, 1.5, (*SHAPE, 3))
    return np.clip(np.round(level), 0, 255)


def presses(n: int) -> tuple[list[Image], Image, list[tuple[float, float, float]]]:
    rng = np.random.default_rng(8)
    circles = [(rng.uniform(55, 145), rng.uniform(50, 110), rng.uniform(18, 30)) for _ in range(n)]
    reference = np.mean([draw(rng, None) for _ in range(4)], axis=0)
    return [draw(rng, c) for c in circles], reference, circles


def names(n: int) -> list[Path]:
    return [Path(f"{i}.png") for i in range(n)]


def test_centres_and_radii_are_found() -> None:
    images, reference, truth = presses(10)
    found = find_balls(images, reference, BALL_PX, names(10))
    apart = np.array([[f.center_x_px, f.center_y_px, f.radius_px] for f in found]) - truth
    assert np.abs(apart[:, :2]).max() < 1.0, apart
    assert np.abs(apart[:, 2]).max() < 3.0, apart


BAD = {
    "untouched": (lambda rest: rest + np.random.default_rng(1).normal(0, 1.5, rest.shape), "ball not found: no more"),
    "black": (np.zeros_like, "is black"),
    "full": (lambda rest: np.full_like(rest, 255), "is overexposed"),
    "size": (lambda rest: rest[:100], "one size is needed"),
    "random colours": (
        lambda rest: (
            rest * (1 + 0.3 * cv2.GaussianBlur(np.random.default_rng(2).normal(0, 8, rest.shape), (0, 0), 8))
        ).clip(0, 250),
        "ball not found: its colours",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_no_press_is_named(what: str) -> None:
    spoil, message = BAD[what]
    images, reference, _ = presses(6)
    with pytest.raises(InputError, match=f"9.png.*{message}"):
        find_balls([*images, spoil(reference)], reference, BALL_PX, [*names(6), Path("9.png")])


def test_a_folder_without_a_table_is_searched_for_a_fit_alone(tmp_path: Path) -> None:
    images, reference, truth = presses(6)
    cv2.imwrite(str(tmp_path / "reference.png"), reference)
    for i, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{i}.png"), image)
    found = load_presses(tmp_path, ball_mm=2 * BALL_PX / 10, px_per_mm=10, may_find=True)
    assert found.is_found
    assert [p.path.name for p in found.presses] == [f"{i}.png" for i in range(6)]
    assert abs(found.presses[3].center_x_px - truth[3][0]) < 1.0
    with pytest.raises(InputError, match=r"presses\.csv is missing"):
        load_presses(tmp_path, ball_mm=2 * BALL_PX / 10, px_per_mm=10)
