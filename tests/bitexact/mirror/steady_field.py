"""Field of a contact that does not change, averaged: firmware/solve/steady_field.h."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label

from mirror.block_float import common_shift, ratio, scaled, to_16
from mirror.fixed import I64, Saturations

MOST_CONTACTS, MOST_NODES = 8, 1 << 12
LIMIT = 4
MAX_CHANGE, MAX_SURPRISE, MAX_EVIDENCE = 1 << 20, 1 << 20, 1 << 40
CHANGE_LIMIT = 1 << 32


def _clamp(x: int, limit: int) -> int:
    return max(-limit, min(limit, x))


def _rounded(x: int, n: int) -> int:
    return (2 * x + n) // (2 * n)


def _parts(numerator: int, denominator: int, pattern: list[int]) -> list[int]:
    """numerator / denominator times the pattern."""
    if numerator == 0 or denominator <= 0:
        return [0] * len(pattern)
    quotient = ratio(abs(numerator), denominator, 0)
    return [scaled(v, quotient, 0) * (-1 if numerator < 0 else 1) for v in pattern]


def _less(values: list[int], parts: list[int]) -> list[int]:
    return [_clamp(v - p, CHANGE_LIMIT) for v, p in zip(values, parts, strict=True)]


def _dot(*vectors: list[int]) -> int:
    return sum(int(np.prod(np.array(row, dtype=object))) for row in zip(*vectors, strict=True))


class SteadyField:
    def __init__(self, places: list[tuple[int, int]], frames: int) -> None:
        self.places, self.frames = places, frames
        self.forget()

    def forget(self) -> None:
        n = len(self.places)
        self.n = [0] * n
        self.force = [[0, 0, 0] for _ in range(n)]
        self.evidence = [[0, 0, 0] for _ in range(n)]

    def run(self, mask: I64, evidence: I64, force: I64, saturations: Saturations) -> I64:
        """Averaged force of `force`, (n_nodes, 3) as `evidence`, `support.project` u."""
        touched = np.flatnonzero(mask.ravel() > 0).tolist()
        of_node = {node: [_clamp(b, MAX_EVIDENCE) for b in evidence[node].tolist()] for node in touched}
        self.n = [n if node in of_node else 0 for node, n in enumerate(self.n)]
        labels, count = label(mask > 0, structure=np.ones((3, 3)))
        out = [[int(v) for v in f] for f in force.reshape(-1, 3)]
        for c in range(1, count + 1):
            nodes = np.flatnonzero(labels.ravel() == c).tolist()
            change = [
                [(out[i][a] << 4) - self.force[i][a] if self.n[i] else 0 for i in nodes] for a in range(3)
            ]  # fmt: skip
            n = 1
            before = self._steady_frames(nodes, of_node, change) if c <= MOST_CONTACTS else 0
            pressure = [max(-out[i][2], 0) for i in nodes]
            pressure = to_16(pressure, common_shift(pressure))
            if before and sum(pressure):
                n = min(before + 1, self.frames)
                change = self._without_patterns(nodes, pressure, change)
            self._update(nodes, of_node, change, n, out, saturations)
        return np.array(out, np.int64).reshape(force.shape)

    def _steady_frames(self, nodes: list[int], evidence: dict[int, list[int]], change: list[list[int]]) -> int:
        known = [(k, i) for k, i in enumerate(nodes) if self.n[i]]
        if 4 * len(known) < 3 * len(nodes) or len(nodes) > MOST_NODES:
            return 0
        n = min(self.frames, *(self.n[i] for _, i in known))
        for k, i in known:
            for a in range(3):
                surprise = _clamp(evidence[i][a] - self.evidence[i][a], MAX_SURPRISE)
                if n * surprise**2 > LIMIT**2 * (n + 1) << 28 or abs(change[a][k]) > MAX_CHANGE:
                    return 0
        return n

    def _without_patterns(self, nodes: list[int], q: list[int], change: list[list[int]]) -> list[list[int]]:
        total = sum(q)
        from_center = []
        for axis in range(2):
            at = [self.places[i][axis] for i in nodes]
            center = sum(p * v for p, v in zip(q, at, strict=True)) // total
            from_center.append([v - center for v in at])
        shift = common_shift(from_center[0] + from_center[1])
        x, y = (to_16(v, shift) for v in from_center)
        gx, gy, gz = change
        gx, gy = _less(gx, _parts(sum(gx), total, q)), _less(gy, _parts(sum(gy), total, q))
        twist, spread = _dot(x, gy) - _dot(y, gx), _dot(q, x, x) + _dot(q, y, y)
        gx = _less(gx, _parts(twist, spread, [-p * v for p, v in zip(q, y, strict=True)]))
        gy = _less(gy, _parts(twist, spread, [p * v for p, v in zip(q, x, strict=True)]))
        xx, yy = _dot(q, x, x), _dot(q, y, y)
        wide, narrow = (x, y) if xx >= yy else (y, x)
        narrow = [v - p for v, p in zip(narrow, _parts(_dot(q, x, y), max(xx, yy), wide), strict=True)]
        gz = _less(gz, _parts(sum(gz), total, q))
        by_wide = _parts(_dot(wide, gz), max(xx, yy), [p * v for p, v in zip(q, wide, strict=True)])
        by_narrow = _parts(_dot(narrow, gz), _dot(q, narrow, narrow), [p * v for p, v in zip(q, narrow, strict=True)])
        return [gx, gy, _less(_less(gz, by_wide), by_narrow)]

    def _update(
        self, nodes: list[int], evidence: dict[int, list[int]], change: list[list[int]], n: int,
        out: list[list[int]], saturations: Saturations,
    ) -> None:  # fmt: skip
        strongest, rounding = nodes[0], [0, 0, 0]
        for k, i in enumerate(nodes):
            if out[i][2] < out[strongest][2]:
                strongest = i
            for a in range(3):
                now, b = out[i][a], self.evidence[i][a]
                self.evidence[i][a] = b + _rounded(evidence[i][a] - b, n) if self.n[i] else evidence[i][a]
                self.force[i][a] = now << 4
                if n > 1:
                    self.force[i][a] -= change[a][k] - _rounded(change[a][k], n)
                    out[i][a] = int(saturations.int32(np.array([(self.force[i][a] + 8) >> 4]))[0])
                    rounding[a] += now - out[i][a]
            self.n[i] = n
        for a in range(3):
            out[strongest][a] = int(saturations.int32(np.array([out[strongest][a] + rounding[a]]))[0])
            self.force[strongest][a] += rounding[a] << 4
