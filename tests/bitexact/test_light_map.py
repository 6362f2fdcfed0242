"""Uneven drift of the light: the core's map against the mirror's, every frame's change bit for bit."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
from mirror.light import Light, relative_change, rest_image
from mirror.markers import DX, DY, LOST
from odd_boards import small_board
from test_frame_path import photometric_tables

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline

WIDTH, HEIGHT, N_REST = 202, 150, 3
LIGHT = 1024
DOTS_PX = np.stack(np.meshgrid(33.2 + 12.13 * (np.arange(5) - 2), 20.8 + 12.42 * (np.arange(3) - 1)), axis=-1)
NO_MARKERS = np.zeros((0, 6), np.int64)
Array = npt.NDArray[np.float64]


@functools.cache
def drift_shape() -> Array:
    v, u = np.meshgrid(np.linspace(-1, 1, HEIGHT), np.linspace(-1, 1, WIDTH), indexing="ij")
    return np.stack([1 + u, -0.5 + u * v + 0.5 * v**3, 0.3 - u**4 + 0.5 * u**2], axis=-1)


def drift(t: float) -> Array:
    """Relative change of the light of each channel (h, w, 3): straight, bent and mixed over the picture."""
    return np.asarray(t * drift_shape())


@functools.cache
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


@functools.cache
def dots(moved_px: float) -> Array:
    """Share of the light that the board's printed dots leave, (h, w, 1)."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    distance = np.min([np.hypot(x - at[0] - moved_px, y - at[1]) for at in DOTS_PX.reshape(-1, 2)], axis=0)
    return np.asarray(1 - 0.6 * np.clip(3 - distance, 0, 1))[..., None]


@functools.cache
def failed() -> Array:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.asarray(-0.1 * np.exp(-((x - 150) ** 2 + (y - 60) ** 2) / 1500)[..., None] * [0, 0, 1])


def test_markers_tell_a_lamp_from_a_contact_bit_for_bit() -> None:
    """With markers at rest a jump is followed and part of a lamp that fails is said; off their rest neither is."""
    text = small_board(width=WIDTH, height=HEIGHT)
    stages = 'stages = ["difference", "markers", "photometric", "poisson"]\n'
    typed, rng = parse_board((text[: text.index("stages = ")] + stages).encode(), "small"), np.random.default_rng(6)
    file = pack(photometric_tables(rng), base_metadata(typed))

    def frame(light: Array | float, moved_px: float) -> npt.NDArray[np.uint8]:
        seen = 110 * dots(moved_px) * (1 + light) + rng.normal(0, 0.7, (HEIGHT, WIDTH, 3))
        return np.clip(np.round(seen), 0, 255).astype(np.uint8)

    rest = np.stack([frame(0.0, 0.0) for _ in range(N_REST)])
    mirror = Light(rest_image(rest))
    learned, is_off = [], []
    with Pipeline(typed, file.data) as core:
        for picture in rest:
            core.process(picture)
        for t in range(448):
            moved_px = 0.8 if 160 <= t < 240 else 0.0
            light = (drift(0.003) if t >= 16 else 0) + (drift(0.03) if moved_px else 0) + (failed() if t >= 400 else 0)
            picture = frame(light, moved_px)
            result = core.process(picture)
            _, moved, lost = core.markers()
            markers = np.zeros((lost.size, 6), np.int64)
            markers[:, [DX, DY]] = np.round(moved * 65536).reshape(-1, 2)
            markers[:, LOST] = lost.ravel() > 0
            assert not lost.any(), t
            change = relative_change(picture, mirror.rest8, mirror.reciprocal)
            mirror.follow(change, markers)
            assert np.array_equal(core.raw("change").reshape(change.shape), change), t
            is_lit = mirror.is_lit_from_outside or mirror.is_lit_from_one_side
            assert bool(result.flags & LIGHT) == (mirror.is_off or is_lit), t
            learned.append(mirror.map.n_learned)
            is_off.append(mirror.map.is_off)
    assert is_off[40]
    assert not is_off[159]
    assert learned[159] == 10
    assert learned[239] == 10
    assert learned[399] > 18
    assert not is_off[399]
    assert is_off[447]
    assert learned[447] == learned[399]
