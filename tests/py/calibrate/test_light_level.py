"""The light of one frame: what the host takes off in a fit is what the device takes off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.photometric.light_level import light_level
from ruffini.estimators.photometric.presses import relative_change

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
LIGHT = np.array([1.12, 0.97, 0.9])
SHAPE = (240, 320)


def picture(rng: np.random.Generator, light: np.ndarray, dent: float) -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    shade = dent * np.exp(-((x - 150) ** 2 + (y - 110) ** 2) / 900)[..., None] * np.array([1, -0.6, 0.4])
    level = 130 * (1 + shade) * light + rng.normal(0, 1, (*SHAPE, 3))
    return np.asarray(np.clip(np.round(level), 0, 255), np.uint8)


def test_the_level_of_a_contact_under_another_light_is_the_lights() -> None:
    rng = np.random.default_rng(1)
    rest = np.mean([picture(rng, np.ones(3), 0) for _ in range(8)], axis=0)
    level = light_level(relative_change(picture(rng, LIGHT, 0.5).astype(float), rest), rest)
    assert level == pytest.approx(LIGHT - 1, abs=0.01)


def test_a_picture_that_tells_nothing_has_no_level() -> None:
    dark = np.full((40, 50, 3), 10.0)
    assert not light_level(np.full((40, 50, 3), 0.2), dark).any()


@pytest.mark.parametrize("is_balanced", [0, 1])
def test_the_device_takes_it_off_where_the_table_says_so(is_balanced: int) -> None:
    rng = np.random.default_rng(2)
    rest = np.mean([picture(rng, np.ones(3), 0) for _ in range(8)], axis=0)
    axis = np.linspace(-1, 1, 65)
    unmix = np.tile(np.array([[4096, 0, 0], [0, 4096, 0]], np.int16), (2, 2, 1, 1))
    slope = np.round(np.stack(np.meshgrid(axis, axis), axis=-1) * 4096).astype(np.int16)
    tables = {
        "photometric.unmix": unmix, "photometric.slope": slope,
        "photometric.balance": np.array([is_balanced], np.int32),
    }  # fmt: skip
    with Pipeline(BOARD, pack(tables, base_metadata(BOARD)).data) as pipeline:
        pipeline.set_rest(rest)
        pipeline.process(picture(rng, LIGHT, 0.0))
        found = np.median(pipeline.raw("slope").reshape(-1, 2), axis=0) / 4096
    expected = np.zeros(2) if is_balanced else LIGHT[:2] - 1
    assert found == pytest.approx(expected, abs=0.006)


def tables_with(**other: np.ndarray) -> dict[str, np.ndarray]:
    tables = {
        "photometric.unmix": np.zeros((2, 2, 2, 3), np.int16), "photometric.slope": np.zeros((65, 65, 2), np.int16),
        "photometric.bend": np.zeros((9, 9, 9, 2), np.int16),
        "photometric.bend_axis": np.array([[-2048] * 3, [9] * 3], np.int32),
    }  # fmt: skip
    return tables | {f"photometric.{name}": value for name, value in other.items()}


BAD = {
    "lines closer than the integers": ({"bend_axis": np.array([[-2048] * 3, [5, 9, 9]], np.int32)}, "bend_axis"),
    "lines where no change is": ({"bend_axis": np.array([[-40000, 0, 0], [9] * 3], np.int32)}, "bend_axis"),
    "a lattice of another size": ({"bend": np.zeros((8, 9, 9, 2), np.int16)}, "photometric.bend"),
    "neither on nor off": ({"balance": np.array([2], np.int32)}, "photometric.balance"),
    "depth beside slopes": ({"depth": np.zeros(257, np.int16)}, "photometric.depth"),
}


@pytest.mark.parametrize("case", BAD, ids=str)
def test_a_table_that_cannot_be_is_refused(case: str) -> None:
    other, words = BAD[case]
    with pytest.raises(InputError, match=words):
        Pipeline(BOARD, pack(tables_with(**other), base_metadata(BOARD)).data)
    with Pipeline(BOARD, pack(tables_with(), base_metadata(BOARD)).data):
        pass
