"""Where the picture's change tells the force, lamps that drift are followed between touches and never during one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pytest
from pressed_gel import small_wedge

from ruffini.boards import parse_board
from ruffini.core.pipeline import Pipeline

Image = npt.NDArray[np.uint8]
Features = npt.NDArray[np.int64]

BOARD = parse_board(small_wedge(), "gelsight-wedge")
LIGHT = 1024  # FlagBit
ONE = 65536.0  # of the features, relative change
N_RAMP, N_SETTLE, N_HELD = 300, 100, 1200
DRIFT = 0.04
GLOW = -0.005  # of the whole picture while something presses: a skin that darkens is darker around a dent, too


def seen(
    gains: Iterable[float], dent: float = 0.0, rng: np.random.Generator | None = None, daylight: float = 0.0
) -> Iterable[Image]:
    """The gel under lamps of these gains; a fingertip dents a patch by `dent`, a third is lit by `daylight` more."""
    rng = rng or np.random.default_rng(0)
    still = np.full((BOARD.camera.height_px, BOARD.camera.width_px, 3), 100.0)
    if dent:
        still *= 1 + GLOW
    still[60:80, 70:90] *= 1 + dent
    still[:, : BOARD.camera.width_px // 3] *= 1 + daylight
    for gain in gains:
        yield np.round(still * gain + rng.normal(0, 1, still.shape)).clip(0, 255).astype(np.uint8)


def run(pipeline: Pipeline, images: Iterable[Image]) -> tuple[Features, int]:
    """Features of the last picture, and all flags together."""
    flags = 0
    for image in images:
        flags |= int(pipeline.process(image).flags)
    return pipeline.features().astype(np.int64), flags


@pytest.fixture
def at_rest() -> Iterable[Pipeline]:
    with Pipeline(BOARD) as pipeline:
        run(pipeline, seen(np.ones(BOARD.pipeline.n_rest_frames + 1)))
        yield pipeline


def test_lamps_that_age_leave_no_change(at_rest: Pipeline) -> None:
    ramp = np.r_[np.linspace(1, 1 + DRIFT, N_RAMP), np.full(N_SETTLE, 1 + DRIFT)]
    features, flags = run(at_rest, seen(ramp))
    assert np.abs(features).max() < 0.1 * DRIFT * ONE
    assert not flags & LIGHT


def test_a_held_touch_is_never_learned(at_rest: Pipeline) -> None:
    first, _ = run(at_rest, seen(np.ones(3), dent=0.2))
    last, flags = run(at_rest, seen(np.ones(N_HELD), dent=0.2))
    released, _ = run(at_rest, seen(np.ones(1)))
    assert np.abs(first).max() > 0.03 * ONE
    assert abs(np.mean(last - first)) < 0.1 * abs(GLOW) * ONE
    assert abs(np.mean(released)) < 0.1 * abs(GLOW) * ONE
    assert not flags & LIGHT


def test_lamps_that_change_at_a_stroke_are_flagged(at_rest: Pipeline) -> None:
    assert run(at_rest, seen([1.08]))[1] & LIGHT


@pytest.mark.parametrize(("daylight", "is_flagged"), [(0.02, False), (0.03, True)])  # limit: 2.5 %
def test_daylight_on_a_third_of_the_picture(at_rest: Pipeline, daylight: float, is_flagged: bool) -> None:
    rng = np.random.default_rng(1)
    assert bool(run(at_rest, seen([1.0] * 3, rng=rng, daylight=daylight))[1] & LIGHT) == is_flagged
