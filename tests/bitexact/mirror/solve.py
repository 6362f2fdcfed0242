"""Displacement -> nodal force: program, contact mask, second pass on the contact's support."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64, Saturations
from mirror.program import Program

LIMIT = (1 << 31) - 1
IMAGE_LIMIT = 1 << 33
WIDE_LIMIT = 1 << 62
ROUNDS, STEPS = 3, 2
FULL = 128  # a node of the contact mask that is surely touched


def linear_force(program: Program, u: I64, saturations: Saturations) -> I64:
    """(n_nodes, 3) in force steps, of (n_nodes, 3) displacements."""
    return saturations.int32(program.times(u.ravel())).reshape(-1, 3)


def contact_mask(force: I64, shape: tuple[int, int], threshold_lsb: int, min_nodes: int) -> I64:
    """How surely each node is touched, 0..128: grey opening by 2 x 2 nodes, grey growth by one."""
    beyond = np.clip(-force[:, 2].reshape(shape) - threshold_lsb, 0, threshold_lsb)
    pressed = -(-beyond * FULL // threshold_lsb)
    square = np.minimum(np.minimum(pressed[1:, 1:], pressed[:-1, 1:]), np.minimum(pressed[1:, :-1], pressed[:-1, :-1]))
    opened = np.zeros(shape, np.int64)
    for dy in (0, 1):
        for dx in (0, 1):
            at = np.s_[dy : dy + shape[0] - 1, dx : dx + shape[1] - 1]
            opened[at] = np.maximum(opened[at], square)
    if np.count_nonzero(opened) < min_nodes:
        return np.zeros(shape, np.int64)
    padded = np.pad(opened, 1)
    grown = [padded[dy : dy + shape[0], dx : dx + shape[1]] for dy in range(3) for dx in range(3)]
    return np.asarray(np.max(grown, axis=0))


# ---- second pass: conjugate gradients in block floating point, on Python's unbounded integers -------


@dataclass(frozen=True)
class SupportTables:
    normal: Program
    project: Program
    scale: npt.NDArray[np.int32]


class _Pass:
    """Vectors over the support's unknowns; lists of int, so that an overflow would show."""

    def __init__(self, saturations: Saturations) -> None:
        self.saturations = saturations

    def limited(self, x: int, limit: int = LIMIT) -> int:
        if abs(x) > limit:
            self.saturations.count += 1
            return limit if x > 0 else -limit
        return x


def _shifted(x: int, right: int) -> int:
    if right > 0:
        return 0 if right > 62 else (x + (1 << (right - 1))) >> right
    return max(-WIDE_LIMIT, min(WIDE_LIMIT, x << -right))


def _common_shift(values: list[int]) -> int:
    largest = max((abs(v) for v in values), default=0)
    return max((largest + (largest >> 14)).bit_length() - 15, 0)


def _to_16(values: list[int], shift: int) -> list[int]:
    return values if shift == 0 else [_shifted(v, shift) for v in values]


def _ratio(numerator: int, denominator: int, exponent: int) -> tuple[int, int]:
    """Mantissa of 24 bits and exponent of numerator / denominator 2^exponent."""
    up = 62 - numerator.bit_length()
    down = max(denominator.bit_length() - 38, 0)
    mantissa = (numerator << up) // (denominator >> down)
    extra = mantissa.bit_length() - 24
    return mantissa >> extra, exponent - up - down + extra


def _scaled(value: int, scale: tuple[int, int], exponent: int) -> int:
    return _shifted(value * scale[0], -(scale[1] + exponent))


def _energy(v: list[int]) -> tuple[int, int]:
    shift = _common_shift(v)
    return sum(x * x for x in _to_16(v, shift)), shift


def _times(a: list[int], weight: list[int]) -> list[int]:
    """Product with weights of 7 fraction bits, rounded."""
    return [(x * w + 64) >> 7 for x, w in zip(a, weight, strict=True)]


def support_force(
    tables: SupportTables,
    u: I64,
    mask: I64,
    force: I64,
    threshold_lsb: int,
    saturations: Saturations,
) -> I64:
    """Second pass over `force`; zero outside the mask."""
    index = np.flatnonzero(np.repeat(mask.ravel() > 0, 3))
    weight = [int(w) for w in np.repeat(mask.ravel(), 3)[index]]
    limited = _Pass(saturations).limited
    scale = [int(s) for s in tables.scale[index]]

    def image_of(values: list[int]) -> list[int]:
        full = np.zeros(force.size, np.int64)
        full[index] = values
        return [limited(int(v), IMAGE_LIMIT) for v in tables.normal.times(full)[index]]

    def steps(y: list[int]) -> list[int]:
        """One round of conjugate gradients from y."""
        shift = _common_shift(y)
        y16 = _to_16(y, shift)
        y = [v << shift for v in y16]
        r = [limited(int(b_i) - _shifted(h, 8 - shift)) for b_i, h in zip(b, image_of(y16), strict=True)]
        v = _times(r, weight)
        p = _times(v, weight)
        energy, energy_shift = _energy(v)
        for _ in range(STEPS):
            if energy == 0:
                break
            shift = _common_shift(p)
            p16 = _to_16(p, shift)
            image = image_of(p16)
            curvature = sum(a * h for a, h in zip(p16, image, strict=True))
            if curvature <= 0:
                break
            step = _ratio(energy, curvature, 2 * (energy_shift - shift) + 8)
            y = [limited(a + _scaled(d, step, shift)) for a, d in zip(y, p16, strict=True)]
            r = [limited(a - _scaled(h, step, shift - 8)) for a, h in zip(r, image, strict=True)]
            v = _times(r, weight)
            next_energy, next_shift = _energy(v)
            if next_energy == 0:
                break
            beta = _ratio(next_energy, energy, 2 * (next_shift - energy_shift))
            p = [limited(a + _scaled(d, beta, 0)) for a, d in zip(_times(v, weight), p, strict=True)]
            energy, energy_shift = next_energy, next_shift
        return y

    b = tables.project.times(u.ravel())[index]
    y = [limited((int(f) << 30) // s) for f, s in zip(force.ravel()[index], scale, strict=True)]
    y = _times(y, weight)
    for i in range(ROUNDS):
        if i:
            pressure = [-_shifted(y[k] * scale[k], 30) for k in range(2, len(y), 3)]
            kept = [min(max(p, 0), threshold_lsb) * FULL // threshold_lsb for p in pressure for _ in range(3)]
            weight = [(w * k) >> 7 for w, k in zip(weight, kept, strict=True)]
            y = _times(y, kept)
        y = steps(y)
    out = np.zeros(force.size, np.int64)
    out[index] = [_shifted(v * s, 30) for v, s in zip(y, scale, strict=True)]
    return saturations.int32(out).reshape(-1, 3)
