"""Noise and the curve of grey levels against the mirror: pictures with drawn offsets, gammas, gains and lost bits."""

from __future__ import annotations

import ctypes

import numpy as np
import numpy.typing as npt

from ruffini.core import native_folder

N_WINDOWS, COARSE, OFF_CURVE = 240, 1, 2
UNIT_GAIN = 1 << 20
Ints = npt.NDArray[np.int64]


class Mirror:
    """firmware/image/pixel_statistics.h."""

    def __init__(self, width: int, height: int) -> None:
        lot = 1

        def draw(n: int) -> int:
            nonlocal lot
            drawn, lot = (lot >> 16) % n, (lot * 1103515245 + 12345) % 2**32
            return drawn

        self.places = np.array([(draw(width - 3), draw(height - 1)) for _ in range(N_WINDOWS)])

    def windows(self, picture: npt.NDArray[np.generic]) -> Ints:
        """(n, 2, 4, 3)."""
        return np.array([picture[y : y + 2, x : x + 4] for x, y in self.places]).astype(np.int64)

    def ties(self, picture: npt.NDArray[np.uint8]) -> tuple[int, int]:
        here = self.windows(picture)
        counts = (here[:, :, 1:] > 2) & (here[:, :, 1:] < 253)
        return int((counts & (here[:, :, 1:] == here[:, :, :-1])).sum()), int(counts.sum())

    def colour(self, picture: npt.NDArray[np.uint8]) -> int:
        step = np.diff(self.windows(picture), axis=2)
        return int(np.abs(step[..., [0, 2]] - step[..., [1]]).sum())

    def learn(self, rest: npt.NDArray[np.uint16], frames: npt.NDArray[np.uint8]) -> None:
        ties = [self.ties(frame) for frame in frames]
        self.rest_ties = sum(t[0] for t in ties), sum(t[1] for t in ties)
        self.rest_colour, self.n_rest = sum(map(self.colour, frames)), len(frames)
        here = self.windows(rest)
        low, high = here.min(axis=(1, 2)), here.max(axis=(1, 2))
        is_usable = (low >= 256) & (high <= 3840) & (4 * low >= 3 * high)
        self.thirds, self.level, self.has_levels = [], here.sum(axis=(1, 2)), True
        for c in range(3):
            found = np.flatnonzero(is_usable[:, c])
            found = found[np.argsort(self.level[found, c], kind="stable")]
            third = len(found) // 3
            self.thirds.append((found[:third], found[len(found) - third :]))
            self.has_levels &= third >= 24
            if self.has_levels:
                dark, bright = self.level[found[third // 2], c], self.level[found[len(found) - 1 - third // 2], c]
                self.has_levels &= bool(5 * bright >= 6 * dark)

    def said(self, picture: npt.NDArray[np.uint8], gain: Ints) -> int:
        n_equal, n = self.ties(picture)
        was_equal, was = self.rest_ties
        coarse = was > 0 and n > 0 and 100 * n_equal * was > (120 * was_equal + was) * n
        coarse |= 100 * self.colour(picture) * self.n_rest < 70 * self.rest_colour
        off, apart = [], 0
        sums = self.windows(picture).sum(axis=(1, 2))
        for c in range(3) if self.has_levels else ():
            level = self.level[:, c]
            change = (16 * sums[:, c] - level) * (2**24 // level) >> 12
            dark, bright = (int(np.sort(change[t])[len(t) // 2]) for t in self.thirds[c])
            off.append(dark + bright - (int(gain[c] - UNIT_GAIN) >> 7))
            apart += bright - dark
        both = sum(off)
        more, less = bool(off) and min(off) > 66, bool(off) and max(off) < -66
        curve = (more and -20 * apart > both) or (less and 20 * apart > -both)
        return COARSE * coarse + OFF_CURVE * curve


def test_the_verdicts_are_the_mirrors() -> None:
    door = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_pixel_statistics
    rng, said = np.random.default_rng(12), []
    for turn in range(24):
        width, height = (int(n) for n in rng.integers((40, 28), (200, 130)))
        y, x = np.mgrid[:height, :width]
        slope = rng.uniform(0, 90) if turn % 4 else 0.0  # without: nothing to compare levels with
        light = np.stack([70 + slope * x / width, 80 + slope * y / height, 150 - slope * x / width], axis=2)
        light[rng.random(light.shape[:2]) < 0.02] = 8

        def picture(light: npt.NDArray[np.float64] = light) -> npt.NDArray[np.float64]:
            return light + rng.normal(0, 1.3, light.shape)

        frames = np.clip(np.round([picture() for _ in range(4)]), 0, 255).astype(np.uint8)
        rest = (4 * frames.astype(np.uint16).sum(axis=0, dtype=np.uint16)).astype(np.uint16)
        gain = (UNIT_GAIN * (1 + rng.choice([0.0, 0.03]) * rng.normal(size=3))).astype(np.int32)
        shown = []
        for _ in range(12):
            curve = 255 * (np.clip(picture(), 0, 255) / 255) ** (1 + rng.choice([0.0, 0.01, 0.03]) * rng.normal())
            bright = curve * (1 + rng.choice([0.0, 0.02]) * rng.normal()) + rng.choice([0.0, 1.0, 4.0]) * rng.normal()
            grey = bright.mean(axis=2, keepdims=True)
            if rng.random() < 0.4:  # colours lost; noise of the grey keeps the levels of neighbours apart
                bright = grey + rng.uniform(0.4, 1) * (bright - grey) + rng.normal(0, 2, grey.shape)
            levels, n_lost = np.clip(np.round(bright), 0, 255).astype(np.uint8), int(rng.integers(3))
            shown.append((levels >> n_lost) << n_lost)
        pictures, out = np.array(shown), np.zeros(len(shown), np.int32)
        door(width, height, *(a.ctypes.data_as(ctypes.c_void_p) for a in (frames,)), len(frames),
             rest.ctypes.data_as(ctypes.c_void_p), gain.ctypes.data_as(ctypes.c_void_p),
             pictures.ctypes.data_as(ctypes.c_void_p), len(pictures), out.ctypes.data_as(ctypes.c_void_p))  # fmt: skip
        mirror = Mirror(width, height)
        mirror.learn(rest, frames)
        expected = [mirror.said(p, gain.astype(np.int64)) for p in pictures]
        assert out.tolist() == expected, turn
        said += expected
    for bit in (COARSE, OFF_CURVE):
        assert 20 < sum(bool(v & bit) for v in said) < len(said) - 20, (bit, said)


def test_black_and_white_levels_are_no_ties() -> None:
    """Levels round both limits, copied from the neighbour so often that the verdict hangs on which of them count."""
    door = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_pixel_statistics
    rng, width, height, said = np.random.default_rng(13), 80, 60, []
    levels = np.array([0, 1, 2, 3, 4, 127, 128, 129, 251, 252, 253, 254, 255], np.uint8)
    gain, rest = np.full(3, UNIT_GAIN, np.int32), np.full((height, width, 3), 1_600, np.uint16)
    for _ in range(60):
        weight = rng.dirichlet(np.ones(len(levels)))

        def picture(copied: float, weight: npt.NDArray[np.float64] = weight) -> npt.NDArray[np.uint8]:
            drawn = rng.choice(levels, (height, width, 3), p=weight)
            for x in range(1, width):
                drawn[:, x] = np.where(rng.random((height, 3)) < copied, drawn[:, x - 1], drawn[:, x])
            return drawn

        frames = np.array([picture(0.3) for _ in range(4)])
        pictures = np.array([picture(c) for c in np.linspace(0.3, 0.6, 12)])
        out = np.zeros(len(pictures), np.int32)
        door(width, height, frames.ctypes.data_as(ctypes.c_void_p), len(frames),
             rest.ctypes.data_as(ctypes.c_void_p), gain.ctypes.data_as(ctypes.c_void_p),
             pictures.ctypes.data_as(ctypes.c_void_p), len(pictures), out.ctypes.data_as(ctypes.c_void_p))  # fmt: skip
        mirror = Mirror(width, height)
        mirror.learn(rest, frames)
        expected = [mirror.said(p, gain.astype(np.int64)) for p in pictures]
        assert out.tolist() == expected
        said += expected
    assert 20 < sum(bool(v & COARSE) for v in said) < len(said) - 20, said
