"""Black, white and reflective dots: the same accuracy, and the wrong kind is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board, find_board, parse_board
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.evaluate.markers import evaluate

Array = npt.NDArray[np.float64]
DARK = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
PITCH_PX, RADIUS_PX = 31.0, 5.5
KINDS = {"black": "dark", "white": "light", "reflective": "light"}


def board(kind: str) -> Board:
    text = DARK.text.replace('polarity = "dark"', f'polarity = "{KINDS[kind]}"')
    return parse_board(text.replace("threshold_1e3 = 200", "threshold_1e3 = 300"), kind)


def places() -> Array:
    column, row = np.meshgrid(np.arange(10) - 4.5, np.arange(7) - 3)
    return np.array([159.5, 119.5]) + PITCH_PX * np.stack([column.ravel(), row.ravel()], axis=1)


def lit(kind: str, at: Array) -> Array:
    """Without noise. Reflective: far beyond white in the middle, which saturates, and a halo of three radii."""
    y, x = np.mgrid[:240, :320].astype(float)
    level = {"black": 140.0, "white": 90.0, "reflective": 50.0}[kind] * (1 + 0.1 * (x / 320 - 0.5))
    for place in at:
        away = np.hypot(x - place[0], y - place[1])
        disc = np.clip((RADIUS_PX - away) / 1.5 + 0.5, 0, 1)
        level = level + {"black": -85.0, "white": 100.0, "reflective": 420.0}[kind] * disc
        if kind == "reflective":
            level = level + 60 * np.exp(-np.clip(away - RADIUS_PX, 0, None) / 3)
    return np.asarray(level)


def picture(level: Array, seed: int) -> npt.NDArray[np.uint8]:
    noise = np.random.default_rng(seed).normal(0, 1.0, (*level.shape, 3))
    return np.asarray(np.clip(np.round(level[..., None] + noise), 0, 255), np.uint8)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_followed(kind: str) -> None:
    rest = places()
    errors = []
    with Pipeline(board(kind)) as pipeline:
        pipeline.set_rest(picture(lit(kind, rest), 0))
        for seed in range(1, 7):
            rng = np.random.default_rng(seed)
            share = np.exp(-((rest - rng.uniform([80, 60], [240, 180])) ** 2).sum(axis=1) / (2 * 55.0**2))
            moved = rest + rng.uniform(-4, 4, 2) + share[:, None] * rng.uniform(-7, 7, 2)
            result = pipeline.process(picture(lit(kind, moved), 10 + seed))
            assert result.n_markers_at_rest == 70
            assert result.n_markers_lost == 0
            at, found, _ = pipeline.markers()
            assert np.median(pipeline.marker_quality()) > 200
            errors.append((at + found).reshape(-1, 2) - moved)
    error = np.linalg.norm(np.concatenate(errors), axis=1)
    assert np.sqrt((error**2).mean()) < 0.04  # 0.031 where halos overlap
    assert error.max() < 0.12


@pytest.mark.parametrize(("kind", "wrong"), [("black", "white"), ("white", "black"), ("reflective", "black")])
def test_the_wrong_kind_is_told(kind: str, wrong: str) -> None:
    level = lit(kind, places())
    frames = [picture(level, seed) for seed in range(26)]
    with pytest.raises(InputError, match=r"no markers of board|polarity"):
        evaluate(board(wrong), frames, n_fields=1)
