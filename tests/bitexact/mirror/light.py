"""rest, difference, grey, drift of the light: what happens to pixels before anything is recognised."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64, round_shift
from mirror.light_map import LightMap, between_nodes, limited
from mirror.markers import DX, DY, LOST

DARK_LEVEL = 8


def without_ambient(lit: npt.NDArray[np.uint8], dark: npt.NDArray[np.uint8]) -> I64:
    """Lit less dark, not below 0; full stays full."""
    less = np.maximum(lit.astype(np.int64) - dark.astype(np.int64), 0)
    return np.asarray(np.where(lit == 255, 255, less))


def rest_image(frames: npt.NDArray[np.uint8]) -> I64:
    """(16 sum + n / 2) / n per channel, in 1/16 grey levels."""
    n = len(frames)
    return np.asarray((16 * frames.sum(axis=0, dtype=np.int64) + n // 2) // n)


def reciprocal(rest: I64) -> I64:
    limited = np.maximum(rest, 512)
    return np.minimum(((1 << 24) + limited // 2) // limited, 32767)


def difference(frame: npt.NDArray[np.uint8], rest: I64, reciprocal_q24: I64) -> tuple[I64, tuple[int, int]]:
    """Relative change Q12, and how many pixels are dark, full."""
    change = relative_change(frame, 8 * rest, reciprocal_q24)
    dark = int((frame < DARK_LEVEL).all(axis=2).sum())
    full = int((frame == 255).any(axis=2).sum())
    return change, (dark, full)


def relative_change(frame: npt.NDArray[np.uint8], rest8: I64, reciprocal_q24: I64) -> I64:
    """Q12, against rest in 1/128 grey levels."""
    return round_shift((128 * frame.astype(np.int64) - rest8) * reciprocal_q24, 15)


def grey(frame: npt.NDArray[np.uint8]) -> I64:
    """B + 2 G + R in 1/16 levels of three channels."""
    return np.asarray(12 * (frame @ np.array([1, 2, 1], np.int64)))


def grey_of_rest(rest: npt.NDArray[np.uint16]) -> I64:
    """The same of a rest image in 1/16 levels."""
    return np.asarray((3 * (rest @ np.array([1, 2, 1], np.int64)) + 2) >> 2)


UNIT_GAIN = 1 << 20


def _is_usable(row: I64) -> bool:
    least, most = row.min(axis=0), row.max(axis=0)
    return bool(((least >= 16 * 32) & (most <= 16 * 220) & (4 * least >= 3 * most)).all())


def light_level(sample: I64, median: I64) -> tuple[I64, bool]:
    """Q16 level of one frame's light from (n, 3) samples in Q12, and whether enough of them agree."""
    level = 16 * median
    for _ in range(3):
        near = (np.abs(16 * sample - level) <= 16 * 328).all(axis=1)
        n = int(near.sum())
        if 8 * n < len(sample):
            return np.clip(level, -16384, 16384), False
        level = (32 * sample[near].sum(axis=0) + n) // (2 * n)
    return np.clip(level, -16384, 16384), bool(np.abs(level).max() <= 16384)


class Light:
    """Rest (h, w, 3) under the light of now: gain (3,) Q20, followed while nothing touches."""

    def __init__(self, rest: I64, dark: I64 | None = None, is_balanced: bool = False) -> None:
        height, width, _ = rest.shape
        unlit = np.zeros_like(rest) if dark is None else np.minimum(dark, rest)
        self._unit = np.minimum(rest, 16 * 255), reciprocal(rest - unlit)
        self._unlit = np.minimum(unlit, 16 * 255)
        samples = [(y, x) for y in range(4, height - 1, 8) for x in range(4, width - 7, 16)]
        self._samples = [(y, x) for y, x in samples if all(_is_usable(row) for row in rest[y : y + 2, x : x + 8])]
        self.gain = np.full(3, UNIT_GAIN)
        self._is_balanced = is_balanced
        self._n_still = 0
        self._at = np.array(self._samples).reshape(-1, 2) * 3 // [height, width]  # thirds, by rows and columns
        self.is_off = self.is_lit_from_outside = self.is_lit_from_one_side = False
        self.level = np.zeros(3, np.int64)
        self.level_is_sure = False
        self.map = LightMap((height, width), np.array(self._samples, np.int64).reshape(-1, 2))
        self._factor = self.map.factor
        self.rest8, self.reciprocal = np.zeros_like(rest), np.zeros_like(rest)
        self._next_row = 0
        self._set()

    def _set(self) -> None:
        self._in_force = self.gain.copy()
        self._take_rows(0, len(self.rest8))
        self._next_row = len(self.rest8)

    def _take_rows(self, first: int, last: int) -> None:
        image, unit = self._unit
        node_gain = limited((self._in_force[:, None, None] * self._factor + UNIT_GAIN // 2) >> 20)
        node_inverse_q14 = ((1 << 34) + node_gain // 2) // node_gain
        shape = self.rest8.shape[:2]
        gain = np.stack([between_nodes(channel, shape) for channel in node_gain], axis=2)
        inverse_q14 = np.stack([between_nodes(channel, shape) for channel in node_inverse_q14], axis=2)
        lit = image - self._unlit
        rows = slice(first, last)
        self.rest8[rows] = np.minimum(8 * self._unlit + round_shift(8 * lit * gain, 20), 32767)[rows]
        self.reciprocal[rows] = np.minimum(round_shift(unit * inverse_q14, 14), 32767)[rows]

    def _advance(self) -> None:
        height = len(self.rest8)
        if self._next_row < height:
            last = min(self._next_row + (height + 15) // 16, height)
            self._take_rows(self._next_row, last)
            self._next_row = last

    @staticmethod
    def _is_tilted(sample: I64, third: I64) -> bool:
        first, last = sample[third == 0], sample[third == 2]
        if min(len(first), len(last)) < 4:
            return False
        more = np.sort(first, axis=0)[len(first) // 2] - np.sort(last, axis=0)[len(last) // 2]
        return bool((more > 82).all() or (more < -82).all())

    def follow(self, change: I64, markers: I64) -> None:
        """One frame's change (h, w, 3) Q12 and its markers."""
        self.level = np.zeros(3, np.int64)
        self.level_is_sure = False
        if not self._samples:
            return
        sample = np.array([(change[y : y + 2, x : x + 8].sum(axis=(0, 1)) + 8) >> 4 for y, x in self._samples])
        n = len(sample)
        median = np.sort(sample, axis=0)[n // 2]
        self.level, self.level_is_sure = light_level(sample, median)
        n_level = int((np.abs(sample - median) <= 61).sum(axis=0).min())
        seen = markers[markers[:, LOST] == 0]
        usual = self.level if self._is_balanced else 0
        self.is_lit_from_outside = bool(8 * int(((16 * sample - usual).min(axis=1) > 16 * 102).sum()) >= n)
        self.is_lit_from_one_side = any(self._is_tilted(sample, third) for third in self._at.T)
        is_moved = bool((np.abs(seen[:, [DX, DY]]) > 16384).any())
        pad = 0 if is_moved else 2 if len(seen) else 1
        is_still = 8 * n_level >= 7 * n and not is_moved
        is_uneven = 6 * n_level < 5 * n and pad == 2
        is_far = (is_still and np.abs(median).max() > 164) or (2 * n_level >= n and abs(median.sum()) > 738)
        self.is_off = is_far or is_uneven
        is_free = pad != 1 or 128 * n_level >= 127 * n
        self._n_still = min(self._n_still + 1, 16) if is_still and is_free else 0
        is_followed = self._n_still == 16
        if is_followed:
            self.gain = limited(self.gain + np.clip(median, -32, 32) * 16)
        self._advance()
        if self.map.run(sample, pad, is_followed, self.gain):
            self._factor = self.map.factor
            self._next_row = 0
        self.is_off = bool(self.is_off or self.map.is_off)
        if (np.abs(self.gain - self._in_force) >= UNIT_GAIN // 4096).any():
            self._set()
