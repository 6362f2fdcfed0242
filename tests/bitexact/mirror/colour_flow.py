"""The last step of a texture's flow, over B, G and R: patches that are blind to light and to linear deformation."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64, round_shift

Bools = npt.NDArray[np.bool_]

SIDE, BLOCKS, STEP, REACH = 8, 3, 3, 22
COLUMNS = SIDE * BLOCKS
H_LIMIT, MAX_STEP = 2047, 1 << 16
MIN_CONTRAST = 36  # of sums over 16
BITS, LEAST_BITS = 15, 8  # of a nuisance, and of what must be left of it


def smoothed(levels: npt.NDArray[np.integer]) -> I64:
    """(h, w, 3) of 1/16 levels, by (1 2 1) both ways."""
    wide = np.pad(levels.astype(np.int64), ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]
    return np.asarray((rows[:-2] + 2 * rows[1:-1] + rows[2:] + 8) >> 4)


def bilinear(picture: I64, at: I64, row: I64, column: I64) -> I64:
    """(n, rows * columns) of the picture at patches whose first pixels are `at`, (n, 2) in Q16 px."""
    i, f = at >> 16, (at & 0xFFFF) >> 1
    yy, xx = i[:, 1, None, None] + row[:, None], i[:, 0, None, None] + column
    fx, fy = f[:, 0, None, None], f[:, 1, None, None]

    def between(a: I64, b: I64, q15: I64) -> I64:
        return a + round_shift((b - a) * q15, 15)

    upper = between(picture[yy, xx], picture[yy, xx + 1], fx)
    lower = between(picture[yy + 1, xx], picture[yy + 1, xx + 1], fx)
    return between(upper, lower, fy).reshape(len(at), -1)


def _scaled(v: I64) -> tuple[I64, int]:
    bits = int(np.abs(v).max()).bit_length()
    return (v >> (bits - BITS), bits) if bits > BITS else (v << (BITS - bits), bits)


def _without(g: I64, directions: list[I64]) -> I64:
    for q in directions:
        share = (int(g @ q) << 20) // int(q @ q)
        g = g - round_shift(share * q, 20)
    return g


def directions_of(nuisances: list[I64]) -> list[I64]:
    """What the nuisances span, each less what those before it explain."""
    out: list[I64] = []
    for raw in nuisances:
        v, bits = _scaled(raw)
        if bits == 0:
            continue
        v, bits = _scaled(_without(v, out))
        if bits >= LEAST_BITS:
            out.append(_without(v, out))
    return out


class ColourFlow:
    """Patches about places (n, 2), Q16 px, of the rest image (h, w, 3), 1/16 levels."""

    def __init__(self, rest: npt.NDArray[np.uint16], places_q16: I64) -> None:
        height, width = rest.shape[:2]
        middle = (places_q16 + 32768) >> 16
        self.x = np.clip(middle[:, 0] - COLUMNS // 2, 1, width - COLUMNS - 2)
        self.y = np.clip(middle[:, 1] - REACH // 2, 1, height - REACH - 2)
        self.limit = np.array([width - COLUMNS - 1, height - (SIDE - 1) * STEP - 2]) << 16
        self.row, self.column = np.arange(SIDE) * STEP, np.arange(COLUMNS)
        pictures = smoothed(rest)
        yy, xx = self.y[:, None, None] + self.row[:, None], self.x[:, None, None] + self.column
        away = [
            np.broadcast_to(((at << 16) - places_q16[:, c, None, None]) >> 12, np.broadcast_shapes(yy.shape, xx.shape))
            for c, at in ((0, xx), (1, yy))
        ]
        n = len(self.x)
        self.h = np.zeros((n, 3, 2, SIDE * COLUMNS), np.int64)
        self.s0, information = np.zeros((n, 2), np.int64), np.zeros((n, 2, 2), np.int64)
        for c in range(3):
            p = pictures[..., c]
            value = p[yy, xx]
            g = [(p[yy, xx + 1] - p[yy, xx - 1]) >> 1, (p[yy + 1, xx] - p[yy - 1, xx]) >> 1]
            for i in range(n):
                t, gi = value[i].ravel(), [one[i].ravel() for one in g]
                directions = directions_of([np.ones_like(t), t, *(one * a[i].ravel() for one in gi for a in away)])
                for axis in (0, 1):
                    h = np.clip(round_shift(_without(16 * gi[axis], directions), 4), -H_LIMIT, H_LIMIT)
                    self.h[i, c, axis] = h
                    self.s0[i, axis] += int((h * t).sum())
                    information[i, axis] += [int((h * one).sum()) for one in gi]
        self._invert(information >> 4)

    def _invert(self, a: I64) -> None:
        self.k, self.shift = np.zeros((len(a), 4), np.int64), np.zeros(len(a), np.int64)
        for i, ((xx, xy), (yx, yy)) in enumerate(a.tolist()):
            det = xx * yy - xy * yx
            if min(xx, yy, det) <= 0 or det // (xx + yy) < MIN_CONTRAST * 3 * SIDE * COLUMNS:
                continue
            b = max(det.bit_length() - 33, 0)
            k = [(v << 33) // (det >> b) for v in (yy, -xy, -yx, xx)]
            if max(abs(v) for v in k) < 1 << 30:
                self.k[i], self.shift[i] = k, 33 + b - 16
        self.is_sound: Bools = self.shift > 0

    def _sample(self, picture: I64, u: I64) -> I64:
        at = np.clip((np.stack([self.x, self.y], axis=1) << 16) + u, 0, self.limit)
        return bilinear(picture, at, self.row, self.column)

    def step(self, frame: npt.NDArray[np.uint8], u: I64, quality: I64) -> tuple[I64, Bools, I64]:
        """u after one step, where the step was cut to a pixel, and the quality that then holds."""
        pictures = smoothed(frame.astype(np.int64) << 4)
        seen = np.stack([self._sample(pictures[..., c], u) for c in range(3)], axis=1)
        ds = (self.h * seen[:, :, None]).sum(axis=(1, 3)) - self.s0
        way = np.zeros_like(u)
        at = (np.stack([self.x, self.y], axis=1) << 16) + u
        is_inside = ((at >= 0) & (at <= self.limit)).all(axis=1)
        for i in np.flatnonzero(self.is_sound & is_inside):
            for axis in (0, 1):
                wide = int(self.k[i, 2 * axis]) * int(ds[i, 0]) + int(self.k[i, 2 * axis + 1]) * int(ds[i, 1])
                shift = int(self.shift[i]) + 4
                way[i, axis] = (wide + (1 << (shift - 1))) >> shift
        is_cut = (np.abs(way) >= MAX_STEP).any(axis=1)
        better = 255 * 9 * quality // (5 * quality + 4 * 255)
        return u - np.clip(way, -MAX_STEP, MAX_STEP), is_cut, np.where(self.is_sound & is_inside, better, quality)
