"""A glowing skin: firmware/image/glow.h, image/taxels.h, stages/skin/taxel_touches.h, opening_edges.h, skin_image.h."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.block_float import shifted
from mirror.board import Board
from mirror.fixed import I64, Saturations
from mirror.relaxation import Relaxation
from mirror.touch_pair import FAR, Tables, find

TAPS = (6544, 5774, 3969, 2124, 885, 287, 73)
ONE = 4096
MAX_CHANGE = 1 << 15
STEP, SIZE = 64, 577
CURVE_STEP, CURVE_SIZE = 16, 513
ROUNDS, BEYOND, MOST, LEAST_REACH = 3, 3, 8, 1 << 10
LOADS_UN, LEANS, PEAK = [500_000 << k for k in range(6)], 9, 6
Tensors = dict[str, npt.NDArray[np.generic]]
Numbers = dict[str, str]


def base_of(rest: npt.NDArray[np.uint16], board: Board) -> I64:
    weights = np.array([board["skin"][f"weight_{c}"] for c in "bgr"])
    return (np.minimum(rest.astype(np.int64), 4080) @ weights + 2) >> 2


def glow_of(frame: npt.NDArray[np.uint8], base: I64, board: Board) -> I64:
    weights = np.array([board["skin"][f"weight_{c}"] for c in "bgr"])
    return np.asarray(4 * (frame.astype(np.int64) @ weights) - base)


def smoothed(glow: I64) -> I64:
    def along(values: I64, axis: int) -> I64:
        wide = np.pad(values, [(6, 6) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        n = values.shape[axis]
        part = [np.take(wide, range(k, k + n), axis) for k in range(13)]
        out = (part[6] * TAPS[0] + (1 << 14)) >> 15
        for k in range(1, 7):
            out = out + (((part[6 - k] + part[6 + k]) * TAPS[k] + (1 << 14)) >> 15)
        return np.asarray(out)

    return along(along(glow, 0), 1)


class Taxels:
    """Ratio of each taxel, light of all, stray light and dark taxels."""

    def __init__(self, tensors: Tensors, numbers: Numbers) -> None:
        self.runs = [tuple(int(v) for v in row) for row in tensors["skin.run"]]
        self.n, self.n_patches = int(numbers["skin.taxels"]), int(numbers["skin.patches"])

    def sums(self, plane: I64) -> list[int]:
        flat, out = plane.ravel(), [0] * (self.n + self.n_patches)
        for first, length, number in self.runs:
            out[number] += int(flat[first : first + length].sum())
        return out

    def learn(self, base: I64) -> None:
        self.base = [max(s, 1) for s in self.sums(base)[: self.n]]

    def run(self, glow: I64) -> list[int]:
        sums = self.sums(glow)
        change = [min(max(ONE * s // b, -MAX_CHANGE), MAX_CHANGE) for s, b in zip(sums, self.base, strict=False)]
        self.light = max(sorted(change)[self.n // 2], 1 - ONE)
        ratio = [ONE * (c - self.light) // (ONE + self.light) for c in change]
        return [min(max(r, -MAX_CHANGE), MAX_CHANGE) for r in ratio]


class OpeningEdges:
    """Has the camera moved, and has the curve of grey levels changed?"""

    def __init__(self, board: Board, base: I64) -> None:
        height, width = base.shape
        twice = np.zeros((2, height, width), np.int64)
        twice[0, 1:-1, 1:-1] = base[1:-1, 2:] - base[1:-1, :-2]
        twice[1, 1:-1, 1:-1] = base[2:, 1:-1] - base[:-2, 1:-1]
        square = (twice**2).sum(axis=0)
        blocks = square[: height // 8 * 8, : width // 8 * 8].reshape(height // 8, 8, width // 8, 8)
        blocks = blocks.transpose(0, 2, 1, 3).reshape(height // 8, width // 8, 64)
        best = blocks.argmax(axis=2)  # the first one
        by, bx = np.nonzero(blocks.max(axis=2) > 4 * 32**2)
        self.y, self.x = 8 * by + best[by, bx] // 8, 8 * bx + best[by, bx] % 8
        self.base, self.twice = base[self.y, self.x], twice[:, self.y, self.x].T
        self.limit = np.array([math.isqrt(int(s)) // 2 for s in square[self.y, self.x]])
        aside = 1000 * self.x - board["camera"]["center_x_mpx"]
        down = 1000 * self.y - board["camera"]["center_y_mpx"]
        is_beside = np.abs(aside) >= np.abs(down)
        self.sector = np.where(is_beside, np.where(aside > 0, 0, 1), np.where(down > 0, 2, 3))
        self.cell = (self.y // 64) * ((width + 63) // 64) + self.x // 64

    def moved(self, glow: I64, light: int) -> bool:
        r = np.clip((light * self.base >> 12) - glow[self.y, self.x], -self.limit, self.limit)
        for sector in range(4):
            of = self.sector == sector
            t = self.twice[of]
            (xx, xy), (_, yy) = (t.T @ t).tolist()
            shift = max(0, (xx + yy).bit_length() - 28)
            xx, xy, yy = xx >> shift, xy >> shift, yy >> shift
            det = xx * yy - xy * xy
            if of.sum() < 64 or 16 * det <= (xx + yy) ** 2:
                continue
            x, y = (int(m) >> shift for m in t.T @ r[of])
            if 10 * max(abs(yy * x - xy * y), abs(xx * y - xy * x)) > det:
                return True
        return False

    def off_curve(self, glow: I64, light: int) -> bool:
        count, sums, bases = (
            np.bincount(self.cell, w).astype(np.int64) for w in (None, glow[self.y, self.x], self.base)
        )
        known = (count >= 4) & (bases > 0)
        edge = sorted((ONE * sums[known] // bases[known]).tolist())
        return len(edge) >= 24 and abs(edge[len(edge) // 2] - light) > 33


@dataclass
class Touch:
    taxel: int
    x: int = 0
    y: int = 0
    strength: int = 0
    q: tuple[int, int] = (0, 0)
    of_pair: int = 0


class TaxelTouches:
    """Touches of ratios: rows (x um, y um, press uN), hardest first."""

    def __init__(self, board: Board, tensors: Tensors, numbers: Numbers) -> None:
        self.t = {name.removeprefix("skin."): value.astype(np.int64) for name, value in tensors.items()}
        self.n = {name.removeprefix("skin."): int(value) for name, value in numbers.items() if name.startswith("skin.")}
        self.round = board["pad"]["size_x_um"] if board["skin"]["shape"] == "tube" else 0
        self.lsb, self.threshold = board["field"]["force_lsb_un"], board["contact"]["threshold_un"]
        self.is_single = board["skin"]["mode"] == "single"
        self.pair = Tables(
            self.t["taxel_place"],
            self.t["taxel_near"],
            self.round,
            self.reach,
            self.n["reach_step_um"],
            self.n["pair_q12"],
        )
        self.memory = Relaxation(tensors["relaxation.part"], tensors["relaxation.time_ms"], self.n["taxels"])

    def read(self, table: I64, ratio: int) -> int:
        at = min(max(ratio + ONE, 0), STEP * (SIZE - 1))
        i = min(at // STEP, SIZE - 2)
        part = at - i * STEP
        return shifted(int(table[i]) * (STEP - part) + int(table[i + 1]) * part, 6)

    def reach(self, dx: int, dy: int) -> int:
        dx, dy, step, table = abs(dx), abs(dy), self.n["reach_step_um"], self.t["reach"]
        if self.round:
            dx = min(dx, abs(self.round - dx))
        c, r = dx // step, dy // step
        if c > table.shape[1] - 2 or r > table.shape[0] - 2:
            return 0
        right, below = dx - c * step, dy - r * step
        rows = [int(table[r + k, c]) * (step - right) + int(table[r + k, c + 1]) * right for k in (0, 1)]
        return (rows[0] * (step - below) + rows[1] * below) // (step * step)

    def explained(self, i: int, touch: Touch) -> int:
        x, y = (int(v) for v in self.t["taxel_place"][i])
        return shifted(touch.strength * self.reach(x - touch.x, y - touch.y), 14)

    def left(self, i: int, but: Touch | None) -> int:
        return self.sink[i] - sum(self.explained(i, t) for t in self.touches if t is not but)

    def lean(self, touch: Touch, axis: int, here: int) -> int:
        before, behind = (int(self.t["taxel_near"][touch.taxel, 2 * axis + side]) for side in (0, 1))
        q = 0
        if before >= 0 and behind >= 0:
            a, b = self.left(before, touch), self.left(behind, touch)
            q = (b - a) * ONE // max(here - min(a, b), 1)
        elif before >= 0 or behind >= 0:
            q = self.left(max(before, behind), touch) * ONE // max(here, 1)
        return min(max(q, -ONE), ONE)

    def within(self, x: int) -> int:
        return x + self.round * ((2 * x < -self.round) - (2 * x > self.round)) if self.round else x

    def fit(self, touch: Touch) -> None:
        here = self.left(touch.taxel, touch)
        if touch.of_pair:
            touch.q = (self.lean(touch, 0, here), self.lean(touch, 1, here))
            return
        for other in self.t["taxel_near"][touch.taxel].tolist():
            if other >= 0 and (there := self.left(other, touch)) > here:
                here, touch.taxel = there, other
        touch.q = (self.lean(touch, 0, here), self.lean(touch, 1, here))
        shift = []
        for axis, q in enumerate(touch.q):
            c = [int(v) for v in self.t["taxel_shift"][touch.taxel, axis]]
            value = c[3]
            for k in (2, 1, 0):
                value = shifted(value * q, 12) + c[k]
            shift.append(shifted(value, 8))
        x, y = (int(v) + s for v, s in zip(self.t["taxel_place"][touch.taxel], shift, strict=True))
        touch.x, touch.y = self.within(x), y
        touch.strength = max(here * 16384 // max(self.reach(*shift), LEAST_REACH), 0)

    def is_peak(self, i: int) -> bool:
        for axis in (0, 1):
            pair = [int(n) for n in self.t["taxel_near"][i, 2 * axis : 2 * axis + 2]]
            there = [n for n in pair if n >= 0]
            two = sum(self.sink[n] for n in there) * 2 // len(there) if there else 0
            if (2 * self.sink[i] - two) * PEAK < self.sink[i]:
                return False
        return True

    def next_taxel(self) -> int | None:
        if len(self.touches) == MOST or (self.is_single and self.touches):
            return None
        best, most = 0, self.n["floor_q12"] - 1
        for i, sink in enumerate(self.sink):
            unexplained = self.left(i, None)
            if sink <= most or unexplained <= most:
                continue
            strong = [max(t.strength, t.of_pair) for t in self.touches]
            reached = [self.explained(i, t) > 0 for t in self.touches]
            parts = [s if on else s // BEYOND for s, on in zip(strong, reached, strict=True)]
            if self.touches and not self.is_peak(i):
                continue
            if unexplained * ONE >= self.n["apart_q12"] * max([sink, *parts]):
                best, most = i, unexplained
        return None if most < self.n["floor_q12"] else best

    def find_another(self) -> bool:
        best = self.next_taxel()
        if best is None:
            return False
        self.touches.append(Touch(best))
        self.fit(self.touches[-1])
        self.split_last()
        return True

    def split_last(self) -> None:
        if self.is_single or len(self.touches) == MOST:
            return
        whole, other = self.touches[-1], self.next_taxel()
        if other is not None:
            x, y = (int(v) for v in self.t["taxel_place"][other])
            aside = min(abs(x - whole.x), abs(self.round - abs(x - whole.x))) if self.round else abs(x - whole.x)
            if aside**2 + (y - whole.y) ** 2 <= (FAR * self.n["reach_step_um"]) ** 2:
                return
        pair = find(self.pair, [self.left(i, whole) for i in range(len(self.sink))], whole.taxel)
        if not pair:
            return
        self.touches.pop()
        for x, y, strength in pair:
            x = self.within(x)
            reach = [self.reach(int(px) - x, int(py) - y) for px, py in self.t["taxel_place"]]
            self.touches.append(Touch(reach.index(max(reach)), x, y, strength, of_pair=sum(s for *_, s in pair)))
        for touch in self.touches[-2:]:
            self.fit(touch)

    def force(self, touch: Touch, elastic_lsb: int) -> int:
        elastic = elastic_lsb * self.lsb
        load = min(max(elastic, LOADS_UN[0]), LOADS_UN[-1])
        k = max(i for i in range(len(LOADS_UN) - 1) if load >= LOADS_UN[i])
        beyond = (load - LOADS_UN[k]) * ONE // (LOADS_UN[k + 1] - LOADS_UN[k])
        (column, right), (row, below) = (
            (min(at >> 12, LEANS - 2), at) for at in (abs(q) * (LEANS - 1) for q in touch.q)
        )
        right, below = right - column * ONE, below - row * ONE
        table = self.t["gain"][int(self.t["taxel_kind"][touch.taxel])]
        gain = []
        for corner in table[k : k + 2, row : row + 2, column : column + 2].tolist():
            along = [a * (ONE - right) + b * right for a, b in corner]
            gain.append(shifted(along[0] * (ONE - below) + along[1] * below, 24))
        return shifted(elastic * shifted(gain[0] * (ONE - beyond) + gain[1] * beyond, 12), 16)

    def run(self, ratio: list[int], capture_us: int, saturations: Saturations) -> list[tuple[int, int, int]]:
        self.sink = [self.read(self.t["sink"], r) for r in ratio]
        is_touched = [s >= self.n["floor_q12"] for s in self.sink]
        press = [self.read(self.t["press"], r) if on else 0 for r, on in zip(ratio, is_touched, strict=True)]
        elastic = np.stack([np.zeros(len(press)), np.zeros(len(press)), press], axis=1).astype(np.int64)
        real = self.memory.run(capture_us, np.ones(len(press), np.int64), elastic, saturations)[:, 2].tolist()
        self.touches: list[Touch] = []
        while self.find_another():
            for _ in range(ROUNDS if len(self.touches) > 1 else 0):
                for touch in self.touches:
                    self.fit(touch)
        force = [0] * len(self.touches)
        for i, on in enumerate(is_touched):
            parts = [self.explained(i, t) for t in self.touches]
            if on and sum(parts):
                for k, part in enumerate(parts):
                    force[k] += real[i] * part // sum(parts)
        rows = [(t.x, t.y, self.force(t, f)) for t, f in zip(self.touches, force, strict=True)]
        return sorted((row for row in rows if row[2] >= self.threshold), key=lambda row: -row[2])


def image_force(curve: I64, brightness: int) -> int:
    """firmware/stages/skin/skin_image.h."""
    at = min(max(brightness, 0), CURVE_STEP * (CURVE_SIZE - 1))
    i = min(at // CURVE_STEP, CURVE_SIZE - 2)
    part = at - CURVE_STEP * i
    return (int(curve[i]) * (CURVE_STEP - part) + int(curve[i + 1]) * part + CURVE_STEP // 2) // CURVE_STEP
