"""Markers that go together against the mirror: dots painted over by chance, through the whole path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import convolve

from ruffini.boards import parse_board
from ruffini.core import Pipeline

BASE = Path(__file__).parents[1] / "data" / "boards" / "base.toml"
MARKERS_LOST = 8
Ints = npt.NDArray[np.int64]


def has_hole(lost: Ints, quality: Ints, place: Ints, rest: Ints, size: tuple[int, int], pitch_um: int) -> bool:
    """`lost` 2: never seen; `place` and `rest` (n_y, n_x, 2) px, Q16."""
    n_y, n_x = lost.shape
    margin = (rest[0, -1, 0] - rest[0, 0, 0]) // (2 * (n_x - 1)), (rest[-1, 0, 1] - rest[0, 0, 1]) // (2 * (n_y - 1))
    is_inside = ((place >= margin) & (place + margin <= (np.array(size) - 1) << 16)).all(axis=-1)
    bad = (((lost == 1) | (quality < 40)) & (lost < 2) & is_inside)[1:-1, 1:-1]
    gone = bad & (lost == 1)[1:-1, 1:-1]
    if pitch_um >= 1400 and ((gone[1:] & gone[:-1]).any() or (gone[:, 1:] & gone[:, :-1]).any()):
        return True
    side, count = (5, 10) if pitch_um < 750 else (3, 4)
    return bool((convolve(bad.astype(int), np.ones((side, side), int), mode="constant") >= count).any())


MIDDLE = ("n_x = 19", "n_y = 15", "pitch_x_um = 1000", "pitch_y_um = 1000", "first_x_um = 1000", "first_y_um = 1000")
NARROW = ("n_x = 27", "n_y = 21", "pitch_x_um = 740", "pitch_y_um = 740", "first_x_um = 380", "first_y_um = 600")
WIDE = ("n_x = 9", "n_y = 7", "pitch_x_um = 2000", "pitch_y_um = 2000", "first_x_um = 2000", "first_y_um = 2000")


@pytest.mark.parametrize("lines", [NARROW, MIDDLE, WIDE], ids=["narrow", "middle", "wide"])
def test_the_flag_is_the_mirrors(lines: tuple[str, ...]) -> None:
    text = BASE.read_text().replace("max_lost = 30", "max_lost = 285")
    for before, after in zip(MIDDLE, lines, strict=True):
        assert before in text
        text = text.replace(before, after)
    board = parse_board(text.encode(), "sample")
    camera, markers, rng = board.camera, board.markers, np.random.default_rng(4)
    px_per_um = camera.focal_mpx / 1e3 / camera.standoff_um
    lattice = np.stack(np.meshgrid(
        (markers.first_x_um + np.arange(markers.n_x) * markers.pitch_x_um - board.pad.size_x_um / 2) * px_per_um,
        (markers.first_y_um + np.arange(markers.n_y) * markers.pitch_y_um - board.pad.size_y_um / 2) * px_per_um,
    ), axis=-1).reshape(-1, 2) + np.array([camera.center_x_mpx, camera.center_y_mpx]) / 1e3  # fmt: skip
    reach_px = markers.diameter_um / 2 * px_per_um + 0.5

    def picture(places: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
        level = np.full((camera.height_px, camera.width_px), 120.0)
        for at_x, at_y in places:
            first_x, first_y = (max(int(at - reach_px), 0) for at in (at_x, at_y))
            seen = level[first_y : max(int(at_y + reach_px) + 1, 0), first_x : max(int(at_x + reach_px) + 1, 0)]
            y, x = np.mgrid[: seen.shape[0], : seen.shape[1]]
            seen *= 1 - 0.6 * np.clip(reach_px - np.hypot(x + first_x - at_x, y + first_y - at_y), 0, 1)
        noisy = level[..., None] + rng.normal(0, 0.7, (*level.shape, 3))
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8)

    said = []
    with Pipeline(board) as core:
        for _ in range(board.pipeline.n_rest_frames):
            core.process(picture(lattice))
        for turn in range(24):
            size = (camera.width_px, camera.height_px)
            if turn < 12:  # dirt
                kept = rng.random(len(lattice)) > 0.01 * turn
            else:  # a hole
                kept = (
                    np.hypot(*(lattice - rng.uniform(0, size)).T)
                    > rng.uniform(0.5, 2.0) * max(markers.pitch_x_um, 1250) * px_per_um
                )
            flags = core.process(picture(lattice[kept] + rng.uniform(-2, 2, 2))).flags
            rest, moved, lost = core.markers()
            raw_rest, place = (np.round(65536 * v).astype(np.int64) for v in (rest, rest + moved))
            expected = has_hole(lost.astype(np.int64), core.marker_quality().astype(np.int64), place, raw_rest, size,
                                markers.pitch_x_um)  # fmt: skip
            assert bool(flags & MARKERS_LOST) == expected, turn
            said.append(expected)
    assert not any(said[:4])
    assert 6 <= sum(said) <= 20, said
