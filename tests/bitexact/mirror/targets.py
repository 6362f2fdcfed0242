"""Round targets: coarse spots, identity by place, edges on rays, centre and area."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mirror.board import Board, center_q16
from mirror.dots import dots_of, weigh
from mirror.fixed import I64, round_shift

RAYS = 128
MARGIN_PX = 28
COARSE = 4


@dataclass(frozen=True)
class Sight:
    """Place (Q16 px), radius (Q12), area (Q8), light round it (Q8)."""

    x: int
    y: int
    radius: int
    area: int = 0
    bright: int = 0
    is_seen: bool = False


def _length_q16(board: Board, um: int) -> int:
    distance = board["camera"]["standoff_um"] - board["targets"]["below_um"]
    return int(um * board["camera"]["focal_mpx"] * 65536 // (distance * 1000))


def nominal(board: Board) -> list[Sight]:
    """Where the board says that the targets are."""
    out = []
    for x_um, y_um in board["targets"]["places_um"]:
        x = center_q16(board, "x") + (_length_q16(board, 2 * x_um - board["pad"]["size_x_um"]) >> 1)
        y = center_q16(board, "y") + (_length_q16(board, 2 * y_um - board["pad"]["size_y_um"]) >> 1)
        out.append(Sight(x, y, _length_q16(board, board["targets"]["diameter_um"]) >> 5))
    return out


def spots(board: Board, grey: I64) -> list[tuple[int, int]]:
    """Places of dark spots, Q16 px, in the order of their first pixels."""
    n_y, n_x = (n // COARSE for n in grey.shape)
    cells = grey[: n_y * COARSE, : n_x * COARSE].reshape(n_y, COARSE, n_x, COARSE)
    coarse = (cells.sum(axis=(1, 3)) + 8) // 16
    radius = _radius_px(board)
    area = radius * radius * 201 // (64 * COARSE * COARSE)
    weight = weigh(coarse, 2 * radius // COARSE, board["targets"]["threshold_1e3"], "dark")
    rows = dots_of(weight, area // 3, 3 * area)
    return [(COARSE * int(x) + 98304, COARSE * int(y) + 98304) for x, y, _ in rows]


def _radius_px(board: Board) -> int:
    return min(max(_length_q16(board, board["targets"]["diameter_um"]) >> 17, 16), 200)


def _filtered(rows: I64) -> I64:
    """(1 4 6 4 1) / 16 along the last axis, half up; two fewer at each end."""
    total = rows[..., :-4] + rows[..., 4:] + 4 * (rows[..., 1:-3] + rows[..., 3:-1]) + 6 * rows[..., 2:-2]
    return np.asarray((total + 8) >> 4)


def directions() -> I64:
    """(rays, 2) cos and sin, Q14, as the core rounds them: cos to Q30, then half up."""
    angle = np.arange(RAYS) * 2 * np.pi / RAYS
    q30 = np.round(np.stack([np.cos(angle), np.sin(angle)], axis=1) * 2**30).astype(np.int64)
    return round_shift(q30, 16)


class Patch:
    """The smoothed picture round a pixel."""

    def __init__(self, grey: I64, radius_px: int, x: int, y: int) -> None:
        self.side = 2 * (radius_px + MARGIN_PX) + 1
        self.left, self.top = x - self.side // 2, y - self.side // 2
        self.height, self.width = grey.shape
        rows = np.clip(np.arange(self.top - 2, self.top + self.side + 2), 0, self.height - 1)
        columns = np.clip(np.arange(self.left - 2, self.left + self.side + 2), 0, self.width - 1)
        self.grey = _filtered(_filtered(grey[np.ix_(rows, columns)]).T).T

    def is_inside(self, x: I64, y: I64) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        u, v = x >> 16, y >> 16
        out = (u >= 0) & (u < self.width - 1) & (v >= 0) & (v < self.height - 1)
        out &= (u >= self.left) & (u < self.left + self.side - 1)
        return np.asarray(out & (v >= self.top) & (v < self.top + self.side - 1))

    def at(self, x: I64, y: I64) -> I64:
        """Bilinear, Q8."""
        x, y = x - (self.left << 16), y - (self.top << 16)
        u, v, fx, fy = x >> 16, y >> 16, x >> 8 & 255, y >> 8 & 255
        upper = self.grey[v, u] * (256 - fx) + self.grey[v, u + 1] * fx
        lower = self.grey[v + 1, u] * (256 - fx) + self.grey[v + 1, u + 1] * fx
        return np.asarray((upper * (256 - fy) + lower * fy) >> 8)


def look(grey: I64, radius_px: int, about: Sight) -> Sight:
    """One target, from roughly where it is."""
    x, y = (int(round_shift(np.int64(v), 16)) for v in (about.x, about.y))
    patch = Patch(grey, radius_px, x, y)
    found = _measure(patch, about, 4, 12, 9)
    return _measure(patch, found, 1, 8, 5) if found.is_seen else found


def _measure(patch: Patch, about: Sight, every: int, far: int, near: int) -> Sight:
    rays = directions()[::every]

    def sample(ray: I64, r: int) -> int:
        x, y = about.x + (r * ray[0] >> 10), about.y + (r * ray[1] >> 10)
        return int(patch.at(x, y))

    edges, brights = [], []
    for ray in rays:
        edge, bright = None, 0
        outer, inner = about.radius + (far << 12), about.radius - (far << 12)
        if patch.is_inside(about.x + (outer * ray[0] >> 10), about.y + (outer * ray[1] >> 10)):
            dark = sum(sample(ray, inner + (i << 12)) for i in range(3))
            bright = sum(sample(ray, outer - (i << 12)) for i in range(3))
            level, r = (dark + bright + 3) // 6, about.radius - (near << 12)
            before = sample(ray, r)
            if 2 * dark < bright and before <= level:
                for _ in range(4 * near):
                    r += 2048
                    now = sample(ray, r)
                    if now > level:
                        edge = r - 2048 + (level - before) * 2048 // (now - before)
                        break
                    before = now
        edges.append(edge)
        brights.append(bright)
    seen = [i for i, edge in enumerate(edges) if edge is not None]
    if 4 * len(seen) < 3 * len(rays):
        return replace(about, is_seen=False)
    total, n = sum(int(edges[i]) for i in seen), len(seen)  # type: ignore[arg-type]
    radius = (2 * total + n) // (2 * n)
    r_all = np.array([radius if edge is None else edge for edge in edges], np.int64)
    log_n = len(rays).bit_length() - 1
    return Sight(
        x=about.x + int(round_shift((r_all * rays[:, 0]).sum(), 9 + log_n)),
        y=about.y + int(round_shift((r_all * rays[:, 1]).sum(), 9 + log_n)),
        radius=radius,
        area=int(round_shift((r_all * r_all).sum() * 3217, 26 + log_n)),
        bright=sum(brights[i] for i in seen) // (3 * n),
        is_seen=True,
    )


class Targets:
    """Every target of a board: rest, then frame by frame."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self.rest = nominal(board)
        self.now = list(self.rest)
        self.is_lost = [True] * len(self.rest)

    def _sight(self, grey: I64, found: list[tuple[int, int]], expected: Sight) -> Sight:
        least, about = (expected.radius << 4) ** 2, None
        for x, y in found:
            distance = (x - expected.x) ** 2 + (y - expected.y) ** 2
            if distance < least:
                least, about = distance, replace(expected, x=x, y=y)
        return replace(expected, is_seen=False) if about is None else look(grey, _radius_px(self._board), about)

    def learn(self, grey: I64) -> None:
        found = spots(self._board, grey)
        self.rest = [self._sight(grey, found, place) for place in nominal(self._board)]
        self.now = list(self.rest)
        self.is_lost = [not sight.is_seen for sight in self.rest]

    def track(self, grey: I64) -> None:
        found = spots(self._board, grey)
        for i, rest in enumerate(self.rest):
            sight = self._sight(grey, found, rest) if rest.is_seen else rest
            self.is_lost[i] = not sight.is_seen
            if sight.is_seen:
                self.now[i] = sight

    def is_light_wrong(self) -> bool:
        pairs = [(a.bright, b.bright) for a, b, lost in zip(self.now, self.rest, self.is_lost, strict=True) if not lost]
        n_off = sum(4 * abs(now - rest) > rest for now, rest in pairs)
        return n_off > 0 and 2 * n_off >= len(pairs)

    def features(self) -> I64:
        rows = [
            (now.x - rest.x, now.y - rest.y, now.area - rest.area)
            for now, rest in zip(self.now, self.rest, strict=True)
        ]
        return np.array(rows, np.int64).ravel()
