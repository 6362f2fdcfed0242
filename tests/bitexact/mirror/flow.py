"""Texture flow: patches of the rest image found again, coarse to fine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, center_q16
from mirror.colour_flow import ColourFlow, bilinear
from mirror.fixed import I64, round_shift
from mirror.markers import ABSENT, DX, DY, LOST, X, Y

Bools = npt.NDArray[np.bool_]

SIDE = 8  # rows and columns of a block
LEVELS = 3
SEARCH = 4  # pixels of the coarsest level
MARGIN = (1, 1, 4)  # of templates to the picture's border, per level
ROW_STEP = (2, 1, 1)
BLOCKS = (2, 1, 1)
H_LIMIT = 2047
MIN_CONTRAST = 576  # squared Q4 gradient per pixel
MAX_STEP = 1 << 16  # Q16 px
HALF_ERROR2 = 10486  # (0.1 px)^2, Q20: a quality of one half


def pyramid(grey: npt.NDArray[np.integer]) -> list[I64]:
    """Levels 0 to 2 of grey in 1/16 levels of three channels, as mean level Q4, smoothed."""
    mean = (grey.astype(np.int64) * 85 + 128) >> 8
    wide = np.pad(mean, 1, mode="edge")
    rows = wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]
    levels = [(rows[:-2] + 2 * rows[1:-1] + rows[2:] + 8) >> 4]
    for _ in range(LEVELS - 1):
        v = levels[-1]
        v = v[: v.shape[0] // 2 * 2, : v.shape[1] // 2 * 2]
        levels.append((v[::2, ::2] + v[1::2, ::2] + v[::2, 1::2] + v[1::2, 1::2] + 2) >> 2)
    return levels


def _div_round(a: I64, n: int) -> I64:
    return np.asarray((2 * a + n) // (2 * n))


class Templates:
    """Patches of one level: steepest-descent images blind to brightness and contrast, and their inverse."""

    def __init__(self, level: int, picture: I64, places_q16: I64) -> None:
        height, width = picture.shape
        columns, step, margin = SIDE * BLOCKS[level], ROW_STEP[level], MARGIN[level]
        at = (((places_q16 + 32768) >> level) + 0) >> 16
        self.x = np.clip(at[:, 0] - columns // 2, margin, width - columns - margin)
        self.y = np.clip(at[:, 1] - SIDE * step // 2, margin, height - SIDE * step - margin)
        self.limit = np.array([width - columns - 1, height - (SIDE - 1) * step - 2]) << 16
        self.row, self.column = np.arange(SIDE) * step, np.arange(columns)
        yy, xx = self.y[:, None, None] + self.row[:, None], self.x[:, None, None] + self.column
        n = SIDE * columns

        def flat(values: I64) -> I64:
            return values.reshape(len(self.x), n)

        value = flat(picture[yy, xx])
        gx = flat((picture[yy, xx + 1] - picture[yy, xx - 1]) >> 1)
        gy = flat((picture[yy + 1, xx] - picture[yy - 1, xx]) >> 1)
        self.value = value
        self.t = value - _div_round(value.sum(axis=1), n)[:, None]
        self.tt = (self.t**2).sum(axis=1)
        self.hx, self.hy = self._blind(gx), self._blind(gy)
        self.s0 = np.stack([(self.hx * value).sum(axis=1), (self.hy * value).sum(axis=1)], axis=1)
        self._invert(gx, gy, n)
        energy = np.maximum(self.hx * gx + self.hy * gy, 0)
        total = np.maximum(energy.sum(axis=1), 1)
        along = [
            flat(np.broadcast_to(v, (len(yy), SIDE, columns)))
            for v in (self.column[None, None], self.row[None, :, None])
        ]
        self.center = np.stack(
            [(o << 16) + ((energy * a).sum(axis=1) << 16) // total
             for o, a in zip((self.x, self.y), along, strict=True)], axis=1,
        )  # fmt: skip

    def _blind(self, g: I64) -> I64:
        free = g - _div_round(g.sum(axis=1), g.shape[1])[:, None]
        share_q16 = ((free * self.t).sum(axis=1) << 16) // np.maximum(self.tt, 1)
        return np.clip(free - round_shift(self.t * share_q16[:, None], 16), -H_LIMIT, H_LIMIT)

    def _invert(self, gx: I64, gy: I64, n: int) -> None:
        xx, xy = (self.hx * gx).sum(axis=1), (self.hx * gy).sum(axis=1)
        yx, yy = (self.hy * gx).sum(axis=1), (self.hy * gy).sum(axis=1)
        det = xx * yy - xy * yx
        self.is_sound = (xx > 0) & (yy > 0) & (det > 0) & (det // np.maximum(xx + yy, 1) >= MIN_CONTRAST * n)
        self.shift = np.zeros(len(det), np.int64)
        self.k = np.zeros((len(det), 4), np.int64)
        for i in np.flatnonzero(self.is_sound):
            b = max(int(det[i]).bit_length() - 33, 0)
            k = [(int(v) << 33) // (int(det[i]) >> b) for v in (yy[i], -xy[i], -yx[i], xx[i])]
            self.is_sound[i] = max(abs(v) for v in k) < 1 << 30
            if self.is_sound[i]:
                self.k[i], self.shift[i] = k, 33 + b - 16

    def sample(self, picture: I64, u: I64) -> I64:
        at = np.clip((np.stack([self.x, self.y], axis=1) << 16) + u, 0, self.limit)
        return bilinear(picture, at, self.row, self.column)

    def step(self, picture: I64, u: I64) -> tuple[I64, Bools]:
        """u after one step, and where the step was cut to a pixel."""
        seen = self.sample(picture, u)
        ds = np.stack([(self.hx * seen).sum(axis=1), (self.hy * seen).sum(axis=1)], axis=1) - self.s0
        shift = self.shift
        way = np.zeros_like(u)
        for axis in (0, 1):
            wide = self.k[:, 2 * axis] * ds[:, 0] + self.k[:, 2 * axis + 1] * ds[:, 1]
            half = np.where(shift > 0, 1 << np.maximum(shift - 1, 0), 0)
            way[:, axis] = (wide + half) >> shift
        return u - np.clip(way, -MAX_STEP, MAX_STEP), (np.abs(way) >= MAX_STEP).any(axis=1)

    def search(self, picture: I64) -> I64:
        """Whole pixels to where each template fits best, brightness aside."""
        best, u = np.full(len(self.x), 1 << 62), np.zeros((len(self.x), 2), np.int64)
        for dy in range(-SEARCH, SEARCH + 1):
            for dx in range(-SEARCH, SEARCH + 1):
                x, y = self.x + dx, self.y + dy
                e = picture[y[:, None, None] + self.row[:, None], x[:, None, None] + self.column]
                e = e.reshape(len(x), -1) - self.value
                cost = (e**2).sum(axis=1) - (e.sum(axis=1) ** 2 >> 6)
                is_better = cost < best
                best[is_better], u[is_better] = cost[is_better], (dx << 16, dy << 16)
        return u


def _median(u: I64, shape: tuple[int, int]) -> I64:
    wide = np.pad(u.reshape(*shape, 2), ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = [wide[j : j + shape[0], i : i + shape[1]] for j in range(3) for i in range(3)]
    return np.sort(np.stack(around), axis=0)[4].reshape(-1, 2)


class Flow:
    """Virtual markers on the lattice of [markers]; `rows` as mirror.markers has them."""

    def __init__(self, board: Board) -> None:
        m, camera = board["markers"], board["camera"]
        self.shape = (m["n_y"], m["n_x"])
        self.threshold = m["threshold_1e3"]
        n = np.arange(m["n_x"] * m["n_y"])
        scale = camera["focal_mpx"] * 2**32 // (camera["standoff_um"] * 1000)
        lines = (n % m["n_x"], n // m["n_x"])
        self.nominal = np.stack([
            center_q16(board, a) - (board["pad"][f"size_{a}_um"] * scale >> 17)
            + ((m[f"first_{a}_um"] + line * m[f"pitch_{a}_um"]) * scale >> 16)
            for a, line in zip("xy", lines, strict=True)
        ], axis=1)  # fmt: skip
        every_2nd = n.reshape(self.shape)[::2, ::2]
        self.coarse_shape = every_2nd.shape
        self._coarse = every_2nd.ravel()
        row, column = np.divmod(n, m["n_x"])
        self._parent = np.minimum((row + 1) // 2, self.coarse_shape[0] - 1) * self.coarse_shape[1]
        self._parent += np.minimum((column + 1) // 2, self.coarse_shape[1] - 1)

    def learn(self, grey: npt.NDArray[np.integer], rest: npt.NDArray[np.uint16]) -> int:
        """Templates from the rest image (h, w, 3) and its grey; number of patches with texture enough."""
        levels = pyramid(grey)
        places = (self.nominal, self.nominal, self.nominal[self._coarse])
        self.levels = [Templates(i, levels[i], places[i]) for i in range(LEVELS)]
        self.rows = np.zeros((len(self.nominal), 6), np.int64)
        fine = self.levels[0]
        self.colours = ColourFlow(rest, self.nominal)
        self.rows[:, [X, Y]] = np.where(self.colours.is_sound[:, None], self.nominal, fine.center)
        self.rows[:, ABSENT] = self.rows[:, LOST] = ~fine.is_sound
        return int(fine.is_sound.sum())

    def track(self, grey: npt.NDArray[np.integer], frame: npt.NDArray[np.uint8]) -> int:
        """Displacements in one frame; number of patches lost that rest had."""
        pictures = pyramid(grey)
        fine, middle, coarse = self.levels
        u = _median(coarse.search(pictures[2]), self.coarse_shape)
        u = _median(coarse.step(pictures[2], u)[0], self.coarse_shape)
        u = middle.step(pictures[1], 2 * u[self._parent])[0]
        u, is_cut = fine.step(pictures[0], 2 * u)
        graded = self._graded(fine, fine.sample(pictures[0], u))
        u, is_cut_again, graded = self.colours.step(frame, u, graded)
        self.quality = np.where(fine.is_sound & ~is_cut & ~is_cut_again, graded, 0)
        known = self.quality > 0
        self.rows[:, [DX, DY]] = u
        self.rows[:, LOST] = ~known
        self._fill(known)
        return int((~known & (self.rows[:, ABSENT] == 0)).sum())

    def _graded(self, fine: Templates, seen: I64) -> I64:
        """0 for what is not the template, else 255 / (1 + expected error^2 / 0.01 px^2)."""
        n = seen.shape[1]
        product = ((fine.t * seen).sum(axis=1) - seen.sum(axis=1) * fine.t.sum(axis=1) // n) >> 10
        spread = ((seen**2).sum(axis=1) - (seen.sum(axis=1) ** 2 >> (n.bit_length() - 1))) >> 10
        tt = fine.tt >> 10
        is_alike = (product > 0) & (tt > 0) & (product**2 * 1_000_000 >= self.threshold**2 * tt * spread)
        unexplained = np.maximum(spread - product**2 // np.maximum(tt, 1), 0)
        gain = np.maximum(fine.k[:, 0] + fine.k[:, 3], 0)
        error2_q20 = (gain * unexplained >> np.maximum(fine.shift - 16, 0)) // n
        return np.where(is_alike, np.maximum(255 * HALF_ERROR2 // (HALF_ERROR2 + error2_q20), 1), 0)

    def _fill(self, known: Bools) -> None:
        n_y, n_x = self.shape
        grid = self.rows[:, [DX, DY]].reshape(n_y, n_x, 2)
        known = known.reshape(n_y, n_x)
        while known.any() and not known.all():
            reached, filled = known.copy(), grid.copy()
            for y, x in zip(*np.nonzero(~known), strict=True):
                window = np.s_[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
                count = int(known[window].sum())
                if count:
                    filled[y, x] = grid[window][known[window]].sum(axis=0) // count
                    reached[y, x] = True
            known, grid = reached, filled
        self.rows[:, [DX, DY]] = grid.reshape(-1, 2)
