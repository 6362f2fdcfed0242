"""Uneven drift of the light: the core's map against the mirror's, every frame's change bit for bit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mirror.light import Light, relative_change, rest_image
from odd_boards import small_board
from test_frame_path import photometric_tables

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline

WIDTH, HEIGHT, N_REST = 202, 150, 3
LIGHT = 1024
NO_MARKERS = np.zeros((0, 6), np.int64)
Array = npt.NDArray[np.float64]


def drift(t: float) -> Array:
    """Relative change of the light of each channel (h, w, 3): straight, bent and mixed over the picture."""
    v, u = np.meshgrid(np.linspace(-1, 1, HEIGHT), np.linspace(-1, 1, WIDTH), indexing="ij")
    shape = [1 + u, -0.5 + u * v + 0.5 * v**3, 0.3 - u**4 + 0.5 * u**2]
    return np.asarray(t * np.stack(shape, axis=-1))


def pressed() -> Array:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    dent = 0.3 * np.exp(-((x - 90.0) ** 2 + (y - 70.0) ** 2) / 900)
    return np.asarray(dent[..., None] * np.stack([(x - 90) / 30, (y - 70) / 30, (70 - y) / 60], axis=-1))


def test_uneven_drift_is_followed_bit_for_bit_and_a_contact_is_not_learned() -> None:
    text = small_board(width=WIDTH, height=HEIGHT)
    text = text[: text.index("stages = ")] + 'stages = ["difference", "photometric", "poisson"]\n'
    typed, rng = parse_board(text.encode(), "small"), np.random.default_rng(5)
    base = np.stack(np.broadcast_arrays(*[np.linspace(60, 160, WIDTH)] * 3), axis=-1) + np.zeros((HEIGHT, 1, 1))
    base[:20, :40] = 12  # too dark to tell anything
    dark = np.full(base.shape, 40, np.uint16)
    file = pack({**photometric_tables(rng), "dark.image": dark}, base_metadata(typed))

    def frame(light: Array | float) -> npt.NDArray[np.uint8]:
        return np.clip(np.round(base * (1 + light) + rng.normal(0, 0.7, base.shape)), 0, 255).astype(np.uint8)

    rest = np.stack([frame(0.0) for _ in range(N_REST)])
    mirror = Light(rest_image(rest), dark.astype(np.int64))
    assert mirror.map.exists
    n_off, late, coefficient = 0, np.zeros(base.shape), []
    with Pipeline(typed, file.data) as core:
        for picture in rest:
            core.process(picture)
        for t in range(640):
            gone = 1e-5 * t if t < 560 else 0.015 if t < 600 else 0.4  # follows, a jump, then far beyond
            light = drift(gone) + (pressed() if 400 <= t < 480 else 0)
            picture = frame(light)
            result = core.process(picture)
            change = relative_change(picture, mirror.rest8, mirror.reciprocal)
            mirror.follow(change, NO_MARKERS)
            assert np.array_equal(core.raw("change").reshape(change.shape), change), t
            is_lit = mirror.is_lit_from_outside or mirror.is_lit_from_one_side
            assert bool(result.flags & LIGHT) == (mirror.is_off or is_lit), t
            n_off += mirror.map.is_off
            coefficient.append(mirror.map._coefficient.copy())
            if 336 <= t < 400:
                late += change / 4096 / 64
    assert mirror.map.n_learned > 20
    assert mirror.map.n_extrapolated >= 5
    is_told = np.s_[24:144, :192]  # means of 8 x 8 pixels: the noise of rest is left
    unfollowed, left = (d[is_told].reshape(15, 8, 24, 8, 3).mean(axis=(1, 3)) for d in (drift(1e-5 * 368), late))
    assert np.std(left, axis=(0, 1)).max() < 0.4 * np.std(unfollowed, axis=(0, 1)).max()
    # What moves during the contact is the extrapolation of the drift before, in its direction.
    moved, before = coefficient[479] - coefficient[399], coefficient[399]
    assert 0 <= (moved * before).sum() <= 0.6 * (before**2).sum()
    assert n_off > 16
