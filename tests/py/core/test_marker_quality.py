"""A dot that is torn, dirty, half under a glint or a shadow, or merged with another says so, and is masked where it is
surely wrong; whole ones keep their good name."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.stats import spearmanr

from ruffini.boards import find_board
from ruffini.core import Pipeline

Array = npt.NDArray[np.float64]
BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
RADIUS_PX, PITCH_PX = 5.5, 31.0
WHOLE, TORN, DIRTY, GLINT, SHADOW, MERGED = range(6)
N_SCENES = 10


def covered(away: Array, radius: float, edge: float = 1.0) -> Array:
    return np.asarray(np.clip((radius - away) / edge + 0.5, 0, 1))


def scene(rng: np.random.Generator, places: Array, damage: npt.NDArray[np.int_], noise: float) -> Array:
    """Grey levels of dark dots at (n, 2) places, each with its damage."""
    y, x = np.mgrid[:240, :320].astype(float)
    light = 135 + 25 * (y / 240 - 0.5)
    ink, spots = np.zeros_like(light), np.zeros_like(light)
    for (at_x, at_y), kind in zip(places, damage, strict=True):
        away, angle = np.hypot(x - at_x, y - at_y), rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(angle), np.sin(angle)])
        along = (x - at_x) * way[0] + (y - at_y) * way[1]
        dot = 85 * covered(away, RADIUS_PX, 1.6)
        if kind == TORN:
            dot = dot * (along < rng.uniform(0, RADIUS_PX))
        ink += dot
        beside = {DIRTY: (3, 9), GLINT: (0, 7), MERGED: (8, 13)}.get(int(kind))
        if beside is not None:
            distance = rng.uniform(*beside)
            size = RADIUS_PX if kind == MERGED else rng.uniform(1, 4)
            strength = {DIRTY: rng.uniform(20, 90), GLINT: -rng.uniform(30, 110), MERGED: 85.0}[int(kind)]
            spots += strength * covered(np.hypot(x - at_x - distance * way[0], y - at_y - distance * way[1]), size)
        if kind == SHADOW:
            light = light * (
                1 - rng.uniform(0.05, 0.3) * (away < 15) / (1 + np.exp(-(along - rng.uniform(-6, 6)) / 1.5))
            )
    return np.asarray(np.clip(light - ink - spots, 3, 255) + rng.normal(0, noise, x.shape))


def frame(levels: Array) -> npt.NDArray[np.uint8]:
    return np.asarray(np.clip(np.round(np.repeat(levels[..., None], 3, axis=2)), 0, 255), np.uint8)


@cache
def judged() -> tuple[Array, Array, npt.NDArray[np.int_]]:
    """Quality, error (px) and damage of every marker that had a dot; quality 0 is masked."""
    rows = []
    with Pipeline(BOARD) as pipeline:
        for seed in range(1000, 1000 + N_SCENES):
            rng = np.random.default_rng(seed)
            column, row = np.meshgrid(np.arange(10) - 4.5, np.arange(7) - 3)
            rest = np.array([159.5, 119.5]) + PITCH_PX * np.stack([column.ravel(), row.ravel()], axis=1)
            share = np.exp(-((rest - rng.uniform([80, 60], [240, 180])) ** 2).sum(axis=1) / (2 * 55.0**2))
            moved = rest + rng.uniform(-4, 4, 2) + share[:, None] * rng.uniform(-7, 7, 2)
            damage = np.where(rng.random(70) < 0.25, rng.integers(TORN, MERGED + 1, 70), WHOLE)
            pipeline.set_rest(frame(scene(rng, rest, np.zeros(70, int), 0.3)))
            pipeline.process(frame(scene(rng, moved, damage, rng.uniform(0.5, 2.0))))
            at, found, state = pipeline.markers()
            quality = pipeline.marker_quality().ravel()
            assert np.array_equal(quality == 0, state.ravel() > 0)
            error = np.linalg.norm((at + found).reshape(-1, 2) - moved, axis=1)
            inside = ((moved > 12) & (moved < [308, 228])).all(axis=1)
            rows.append(
                np.stack([quality, error, damage], axis=1)[inside & (np.abs(at.reshape(-1, 2) - rest).max(axis=1) < 1)]
            )
    quality, error, damage = np.concatenate(rows).T
    return quality, error, damage.astype(int)


def rms(error: Array) -> float:
    return float(np.sqrt((error**2).mean()))


def test_quality_foretells_the_error() -> None:
    quality, error, _ = judged()
    stated = 0.1 * np.sqrt(255 / np.maximum(quality, 1) - 1)
    classes = [(quality > 0) & (stated >= low) & (stated < high) for low, high in ((0, 0.03), (0.03, 0.08), (0.08, 1))]
    assert all(one.sum() > 40 for one in classes)
    errors = [rms(error[one]) for one in classes]
    assert errors[0] < 0.05
    assert errors[1] > 1.5 * errors[0]
    assert errors[2] > 5 * errors[1]
    assert spearmanr(stated[quality > 0], error[quality > 0])[0] > 0.5


def test_whole_dots_keep_their_good_name_and_are_better_than_their_weighted_centres() -> None:
    quality, error, damage = judged()
    whole = damage == WHOLE
    assert (quality[whole] == 0).mean() < 0.01
    assert np.median(quality[whole]) > 220
    assert rms(error[whole]) < 0.022  # 0.024 by weighted centres alone


def test_what_is_far_off_is_masked_or_doubted() -> None:
    quality, error, damage = judged()
    lowest = np.quantile(quality[damage == WHOLE], 0.05)
    far = (error > 0.5) & (quality > 0)
    assert (quality[far] < lowest).mean() > 0.85
    assert (quality[damage == MERGED] == 0).mean() > 0.4  # two dots in one: the others lie nearly in one another
