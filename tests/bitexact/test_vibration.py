"""The stage vibration is the mirror's, bit for bit, and its level is that of what moves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import read_board
from mirror.log2 import log2_q16
from mirror.vibration import level_cdb
from test_skin_stage import N_REST, calibration, picture, skin_text

from ruffini.boards import parse_board
from ruffini.core.pipeline import Pipeline

VALID, NOT_MEASURED = 1, 0


def with_vibration(text: str) -> str:
    head, _, tail = text.partition("stages = [")
    return head + 'stages = ["difference", "skin", "vibration"]' + tail.partition("]")[2]


def pressed(rng: np.random.Generator, strength: float) -> npt.NDArray[np.uint8]:
    """Between the openings it is not so dark that the stage difference takes the lens for covered."""
    return np.clip(picture(rng, [(2.3, 1.6, strength)]).astype(int) + 12, 0, 255).astype(np.uint8)


def test_levels_are_those_of_the_mirror_while_something_touches() -> None:
    text, rng = with_vibration(skin_text("tube", "auto")), np.random.default_rng(8)
    file = calibration(read_board(text), text, rng)
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for _ in range(N_REST):
            before = pressed(rng, 0.0)
            core.process(before)
        said = []
        for t, strength in enumerate([0.0, 0.0, 2.0, 2.0, 2.6, 2.0, 3.0, 0.0, 2.0, 2.0]):
            frame = pressed(rng, strength)
            result = core.process(frame)
            assert result.flags == 0
            level, validity = core.raw("vibration").tolist()
            assert t == 0 or level == level_cdb(before, frame), t  # the first frame has none before it
            assert validity == (VALID if said and said[-1] and strength else NOT_MEASURED), t
            said.append(strength > 0)
            before = frame


def test_a_zero_begins_anew() -> None:
    text, rng = with_vibration(skin_text("tube", "auto")), np.random.default_rng(9)
    file = calibration(read_board(text), text, rng)
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for _ in range(N_REST):
            core.process(pressed(rng, 0.0))
        for expected in (NOT_MEASURED, VALID):
            core.process(pressed(rng, 2.0))
            assert core.raw("vibration")[1] == expected
        core.zero(1)
        core.process(pressed(rng, 0.0))
        core.process(pressed(rng, 2.0))
        assert core.raw("vibration")[1] == NOT_MEASURED


@pytest.mark.parametrize("sigma", [1.0, 4.0])
def test_independent_noise_is_its_rms_in_decibels(sigma: float) -> None:
    rng = np.random.default_rng(3)
    grey = rng.normal(120, sigma, (2, 240, 320, 1)).round().astype(np.uint8).repeat(3, 3)
    rms = np.std(np.diff(grey[:, ::4, ::4, 0].astype(float), axis=0))
    assert level_cdb(grey[0], grey[1]) / 100 == pytest.approx(20 * np.log10(rms), abs=0.02)


def test_light_that_all_pixels_have_in_common_is_no_vibration() -> None:
    grey = np.full((2, 64, 64, 3), 100, np.uint8)
    grey[1] += 30
    assert level_cdb(grey[0], grey[1]) < -5000


def test_the_logarithm_is_right_to_its_last_bit() -> None:
    for x in [1, 2, 3, 255, 256, 2304, 2**31 - 1, 2**40 + 12345, 2**62]:
        assert 0 <= np.log2(float(x)) * 65536 - log2_q16(x) < 3
