"""Second pass on the contact's support: firmware/solve/support_solver.h."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror import shear_modes
from mirror.block_float import common_shift, limited, ratio, scaled, shifted, squares, to_16
from mirror.fixed import I64, Saturations
from mirror.program import Program
from mirror.solve import FULL

IMAGE_LIMIT = 1 << 33
ROUNDS, STEPS = 3, 2


@dataclass(frozen=True)
class SupportTables:
    normal: Program
    project: Program
    scale: npt.NDArray[np.int32]
    shear_noise: int


def _times(a: list[int], weight: list[int], fraction: list[int]) -> list[int]:
    """Products with weights of so many fraction bits, rounded."""
    return [(x * w + (1 << (f - 1))) >> f for x, w, f in zip(a, weight, fraction, strict=True)]


class _Pass:
    """One contact mask's second pass; vectors over the support's unknowns are lists of int."""

    def __init__(self, tables: SupportTables, u: I64, beyond: I64 | None, mask: I64, saturations: Saturations) -> None:
        self.tables, self.saturations = tables, saturations
        self.nodes = [int(n) for n in np.flatnonzero(mask.ravel() > 0)]
        self.index = np.array([3 * n + c for n in self.nodes for c in range(3)], dtype=np.int64)
        self.n = 3 * mask.size
        self.weight = [int(mask.ravel()[n]) for n in self.nodes for _ in range(3)]
        self.scale = [int(s) for s in tables.scale[self.index]]
        self.b = [int(v) for v in tables.project.times(u.ravel())[self.index]]
        if beyond is not None:
            self.add_to_b(beyond)
        self.contacts = shear_modes.find_contacts(mask, self.nodes)

    def limit(self, x: int, limit: int = (1 << 31) - 1) -> int:
        return limited(x, self.saturations, limit)

    def add_to_b(self, beyond: I64) -> None:
        """H times what finite strain adds, over all unknowns."""
        y = [self.limit((int(f) << 30) // int(s)) for f, s in zip(beyond.ravel(), self.tables.scale, strict=True)]
        self.beyond = y
        shift = common_shift(y)
        image = self.tables.normal.times(np.array(to_16(y, shift), np.int64))[self.index]
        self.b = [b + shifted(self.limit(int(h), IMAGE_LIMIT), 8 - shift) for b, h in zip(self.b, image, strict=True)]

    def image_of(self, values: list[int]) -> list[int]:
        full = np.zeros(self.n, np.int64)
        full[self.index] = values
        return [self.limit(int(v), IMAGE_LIMIT) for v in self.tables.normal.times(full)[self.index]]

    def precondition(self, r: list[int]) -> tuple[list[int], int, int]:
        """z = M r, and r . z with its shift."""
        fraction = [8, 8, 7] * len(self.nodes)
        v = _times(r, self.weight, fraction)
        z = _times(v, self.weight, fraction)
        shift = common_shift(v)
        return z, squares(v, shift) + shear_modes.precondition(self.contacts, r, z, shift), shift

    def size_q12(self, y16: list[int], image: list[int], shift: int) -> int:
        """How much of y explains b best."""
        b_shift = common_shift(self.b)
        explained = sum(v * b for v, b in zip(y16, to_16(self.b, b_shift), strict=True))
        curvature = sum(v * h for v, h in zip(y16, image, strict=True))
        if explained <= 0 or curvature <= 0:
            return 4096
        mantissa, exponent = ratio(explained, curvature, b_shift - shift + 8)
        return max(1024, min(16384, shifted(mantissa, -(exponent + 12))))

    def steps(self, y: list[int], *, is_first: bool) -> list[int]:
        """One round of conjugate gradients from y; the first one makes it as large as explains b best."""
        shift = common_shift(y)
        y16 = to_16(y, shift)
        image = self.image_of(y16)
        size = self.size_q12(y16, image, shift) if is_first else 4096
        y = [self.limit(shifted(v * size, 12 - shift)) for v in y16]
        r = [self.limit(b - shifted(h * size, 20 - shift)) for b, h in zip(self.b, image, strict=True)]
        z, energy, energy_shift = self.precondition(r)
        p = [self.limit(v) for v in z]
        for _ in range(STEPS):
            if energy == 0:
                break
            shift = common_shift(p)
            p16 = to_16(p, shift)
            image = self.image_of(p16)
            curvature = sum(a * h for a, h in zip(p16, image, strict=True))
            if curvature <= 0:
                break
            step = ratio(energy, curvature, 2 * (energy_shift - shift) + 8)
            y = [self.limit(a + scaled(d, step, shift)) for a, d in zip(y, p16, strict=True)]
            r = [self.limit(a - scaled(h, step, shift - 8)) for a, h in zip(r, image, strict=True)]
            z, next_energy, next_shift = self.precondition(r)
            if next_energy == 0:
                break
            beta = ratio(next_energy, energy, 2 * (next_shift - energy_shift))
            p = [self.limit(a + scaled(d, beta, 0)) for a, d in zip(z, p, strict=True)]
            energy, energy_shift = next_energy, next_shift
        return y

    def weaken_pull(self, y: list[int], threshold_lsb: int) -> list[int]:
        pressure = [-shifted(y[k] * self.scale[k], 30) for k in range(2, len(y), 3)]
        kept = [min(max(p, 0), threshold_lsb) * FULL // threshold_lsb for p in pressure for _ in range(3)]
        self.weight = [(w * k) >> 7 for w, k in zip(self.weight, kept, strict=True)]
        return _times(y, kept, [7] * len(y))


def residual(tables: SupportTables, u: I64, explained: I64, saturations: Saturations) -> I64:
    """What forces leave unexplained, (n_nodes, 3) in 1/64 standard deviation.

    explained : (3 n_nodes,) the second pass's y less beyond / d, as `support_force` gives it.
    """

    def limit(x: int, limit: int = (1 << 31) - 1) -> int:
        return limited(x, saturations, limit)

    shift = common_shift([int(v) for v in explained])
    image = tables.normal.times(np.array(to_16([int(v) for v in explained], shift), np.int64))
    imaged = [limit(shifted(limit(int(v), IMAGE_LIMIT), 8 - shift)) for v in image]
    b = [limit(int(v)) for v in tables.project.times(u.ravel())]
    return np.array([shifted(a - v, 8) for a, v in zip(b, imaged, strict=True)], np.int64).reshape(-1, 3)


def support_force(
    tables: SupportTables,
    places: list[tuple[int, int]],
    u: I64,
    beyond: I64 | None,
    mask: I64,
    force: I64,
    threshold_lsb: int,
    saturations: Saturations,
) -> tuple[I64, I64]:
    """Second pass over `force` (n_nodes, 3) with the mask (n_y, n_x); zero outside the mask.

    Beside it y less beyond / d of all unknowns, which `residual` reads.
    """
    solve = _Pass(tables, u, beyond, mask, saturations)
    of_support = [places[n] for n in solve.nodes]
    y = [solve.limit((int(f) << 30) // s) for f, s in zip(force.ravel()[solve.index], solve.scale, strict=True)]
    y = _times(y, solve.weight, [7] * len(y))
    for i in range(ROUNDS):
        if i:
            y = solve.weaken_pull(y, threshold_lsb)
        for contact in solve.contacts:
            shear_modes.learn(contact, y, solve.weight, of_support)
            if i == 0:
                shear_modes.shrink(contact, y, solve.weight, tables.shear_noise)
        y = solve.steps(y, is_first=i == 0)
    out = np.zeros(force.size, np.int64)
    out[solve.index] = [shifted(v * s, 30) for v, s in zip(y, solve.scale, strict=True)]
    explained = -np.array(solve.beyond, np.int64) if beyond is not None else np.zeros(force.size, np.int64)
    explained[solve.index] += np.array(y, np.int64)
    return saturations.int32(out).reshape(-1, 3), explained
