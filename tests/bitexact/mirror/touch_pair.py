"""Two fingers or one: firmware/stages/skin/touch_pair.h."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations, product
from math import isqrt
from typing import NamedTuple

import numpy as np

from mirror.fixed import I64

ROWS, COLUMNS = 7, 5
NOISE, PART_Q8 = 82, 13
HALF, GRID_STEP, HALVINGS, ROUNDS = 6, 2, 3, 2
ON_TAXEL, NEAR, FAR, EVEN, LEAST, SLACK = 5, 4, 8, (8, 5), 205, 3
MOST_FEATURE, MOST_STRENGTH, TURN = (1 << 15) - 1, 1 << 20, 1024
ONE = 4096


class Tables(NamedTuple):
    """place (n, 2) um, near (n, 8), way round (0: none), reach Q14 at an offset, its step, and `pair` Q12."""

    place: I64
    near: I64
    round: int
    reach: Callable[[int, int], int]
    step: int
    pair: int


class Stand(NamedTuple):
    """A place from the taxel, what a touch there makes, its products with itself and with what is seen."""

    x: int
    y: int
    made: I64
    own: int
    with_seen: int

    @property
    def gain(self) -> int:
        return self.with_seen**2 // self.own if self.with_seen > 0 and self.own > 0 else 0


class Pair(NamedTuple):
    gain: int
    at: tuple[Stand, Stand]
    strength: tuple[int, int]


def times(a: I64, b: I64) -> int:
    return int((a * b).sum()) >> 10


class Patch:
    def __init__(self, tables: Tables, sink: list[int], taxel: int) -> None:
        self.t, self.taxel = tables, taxel
        self.node = np.full((ROWS, COLUMNS), -1)
        for row, column in product(range(ROWS), range(COLUMNS)):
            up, aside = row - ROWS // 2, column - COLUMNS // 2
            start = self.walk(taxel, 2 if up < 0 else 3, abs(up))
            self.node[row, column] = self.walk(start, 0 if aside < 0 else 1, abs(aside))
        limited = np.clip(np.array(sink, np.int64), -ONE, 16 * ONE)
        value = np.where(self.node >= 0, limited[self.node], 0)
        self.weight = np.zeros((ROWS - 2, COLUMNS), np.int64)
        for cell in product(range(ROWS - 2), range(COLUMNS)):
            if self.node[cell[0] + 1, cell[1]] >= 0:
                part = PART_Q8 * max(int(value[cell[0] + 1, cell[1]]), 0) >> 8
                self.weight[cell] = 16 * ONE // isqrt(NOISE**2 + part**2)
        self.n = int((self.node[1:-1] >= 0).sum())
        self.seen = self.described(value, 9)

    def walk(self, start: int, way: int, steps: int) -> int:
        for _ in range(steps):
            start = int(self.t.near[start, way]) if start >= 0 else -1
        return start

    def described(self, value: I64, shift: int) -> I64:
        above, here, below = value[:-2], value[1:-1], value[2:]
        has_above, has_below = self.node[:-2] >= 0, self.node[2:] >= 0
        up = np.where(has_above, above, np.where(has_below, below, here))
        down = np.where(has_below, below, np.where(has_above, above, here))
        both = np.concatenate([(self.weight * here).ravel(), (self.weight * (2 * here - up - down)).ravel()])
        return np.asarray(np.clip((both + (1 << (shift - 1))) >> shift, -MOST_FEATURE, MOST_FEATURE))

    def stand(self, x: int, y: int) -> Stand:
        reach, is_on_skin = np.zeros((ROWS, COLUMNS), np.int64), False
        for cell, taxel in np.ndenumerate(self.node):
            if taxel >= 0:
                dx, dy = (int(v) for v in self.t.place[taxel] - self.t.place[self.taxel] - (x, y))
                reach[cell] = self.t.reach(dx, dy)
                aside = min(abs(dx), abs(self.t.round - abs(dx))) if self.t.round else abs(dx)
                is_on_skin |= 2 * max(aside, abs(dy)) <= ON_TAXEL * self.t.step
        made = self.described(reach * is_on_skin, 11)
        return Stand(x, y, made, times(made, made), times(made, self.seen))

    def around(self, middle: Stand, step: int) -> list[Stand]:
        return [self.stand(middle.x + dx * step, middle.y + dy * step) for dy, dx in product((-1, 0, 1), repeat=2)]

    def pair(self, a: Stand, b: Stand) -> Pair | None:
        away2 = (a.x - b.x) ** 2 + (a.y - b.y) ** 2
        if not (NEAR * self.t.step) ** 2 <= away2 <= (FAR * self.t.step) ** 2:
            return None
        both = times(a.made, b.made)
        turn = a.own * b.own - both**2
        if turn <= 0 or turn * TURN < a.own * b.own:
            return None
        first = (a.with_seen * b.own - b.with_seen * both) * ONE // turn
        second = (b.with_seen * a.own - a.with_seen * both) * ONE // turn
        low, high = sorted((first, second))
        if low < LEAST or high > MOST_STRENGTH or EVEN[1] * high > EVEN[0] * low:
            return None
        return Pair((first * a.with_seen + second * b.with_seen) >> 12, (a, b), (first, second))


def find(tables: Tables, sink: list[int], taxel: int) -> list[tuple[int, int, int]]:
    """Places and strengths of the two; nothing where it is one."""
    patch = Patch(tables, sink, taxel)
    sides = range(-HALF, HALF + 1, GRID_STEP)
    grid = [patch.stand(x * tables.step, y * tables.step) for y, x in product(sides, sides)]
    finer = [tables.step * GRID_STEP >> (1 + k // ROUNDS) for k in range(HALVINGS * ROUNDS)]
    single = max(grid, key=lambda stand: stand.gain)
    for step in finer:
        single = max([single, *patch.around(single, step)], key=lambda stand: stand.gain)
    all_, slack = times(patch.seen, patch.seen), SLACK * patch.n << 6
    one = all_ - single.gain
    if one * SLACK * ONE <= tables.pair * slack:
        return []
    best = _best([], combinations(grid, 2), patch)
    for step in finer if best else []:
        a, b = (patch.around(stand, step) for stand in best[0].at)
        best = _best(best, product(a, b), patch)
    if not best:
        return []
    two = all_ - best[0].gain
    if (one - two) * SLACK * ONE <= tables.pair * (two + slack):
        return []
    x, y = (int(v) for v in tables.place[taxel])
    return [(x + stand.x, y + stand.y, s) for stand, s in zip(best[0].at, best[0].strength, strict=True)]


def _best(best: list[Pair], pairs: Iterable[tuple[Stand, Stand]], patch: Patch) -> list[Pair]:
    for a, b in pairs:
        found = patch.pair(a, b)
        if found is not None and found.gain > (best[0].gain if best else -1):
            best = [found]
    return best
