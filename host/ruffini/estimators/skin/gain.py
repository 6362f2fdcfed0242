"""What a touch's force is over the elastic force of its taxels: by where it stands and how hard; see `skin_response`.

Between taxels the mask and the arch of the panel bear a part, at a rim the panel's free edge; the part changes within
millimetres, and no law with few numbers follows it. So log(force / E) is a smooth function of |q_x|, |q_y|, log E and
the kind of column, one for taxels at a rim and one for all others: a Gaussian process whose mean over the presses is
tabulated. Frames of one press err together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.intp]

LOADS_N = np.array([0.5, 1, 2, 4, 8, 16])  # of firmware/stages/skin/taxel_tables.h
LEANS = np.linspace(0, 1, 9)
COLUMNS = 3  # kinds of columns: beside a seam, next to it, others
LEAST, MOST = 0.25, 4.0  # the firmware's limits
FRAMES = 12  # of a press, evenly spread: more are all alike
# Lengths over which it changes along |q_x|, |q_y|, log E and the kind of column; how much; noise of a frame, of a press
RIM = (np.array([1.0, 0.45, 1.2, 1.0]), 0.25, 0.03, 0.03)
INNER = (np.array([0.7, 0.7, 1.0, 1.5]), 0.15, 0.03, 0.04)
ROUNDS = 3  # of giving frames that err more than twice their noise less weight


@dataclass(frozen=True)
class Gain:
    """`table` [kind][load][q_y][q_x]; kinds: columns of others, then those of taxels at a rim."""

    table: Array

    def at(self, kind: Numbers, elastic_n: Array, q: Array) -> Array:
        """Gain of touches on taxels of a kind (t,), as firmware/stages/skin/taxel_tables.h reads it."""
        load = np.clip(elastic_n, LOADS_N[0], LOADS_N[-1])
        k = np.clip(np.searchsorted(LOADS_N, load, side="right") - 1, 0, len(LOADS_N) - 2)
        beyond = (load - LOADS_N[k]) / (LOADS_N[k + 1] - LOADS_N[k])
        place = np.abs(q) * (len(LEANS) - 1)
        line = np.minimum(place.astype(int), len(LEANS) - 2)
        (right, below), (column, row) = (place - line).T, line.T
        out = np.zeros_like(load)
        for i, share in ((0, 1 - beyond), (1, beyond)):
            for dy, of_y in ((0, 1 - below), (1, below)):
                for dx, of_x in ((0, 1 - right), (1, right)):
                    out += share * of_y * of_x * self.table[kind, k + i, row + dy, column + dx]
        return out


def no_gain() -> Gain:
    """Force is elastic force."""
    return Gain(np.ones((2 * COLUMNS, len(LOADS_N), len(LEANS), len(LEANS))))


def fit_gain(kind: Numbers, elastic_n: Array, q: Array, force_n: Array, press: Numbers) -> Gain:
    """Fit to frames (t,): kind, E, q (t, 2), reference force, and the number of the press that each is of."""
    table = no_gain().table
    y, x = np.meshgrid(LEANS, LEANS, indexing="ij")
    for first, (lengths, much, noise, apart) in ((0, INNER), (COLUMNS, RIM)):
        own = np.flatnonzero((kind >= first) & (kind < first + COLUMNS))
        own = np.concatenate([_spread(own[press[own] == p]) for p in np.unique(press[own])] or [own])
        if not len(own):
            continue
        at = np.column_stack([np.abs(q[own]), np.log(elastic_n[own]), kind[own] - first])
        weight, mean = _process(at, np.log(force_n[own] / elastic_n[own]), press[own], lengths, (much, noise, apart))
        for column in range(COLUMNS):
            for i, load in enumerate(np.log(LOADS_N)):
                knots = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, load), np.full(x.size, column)])
                value = mean + _alike(knots, at, lengths, much) @ weight
                table[first + column, i] = np.exp(value).reshape(x.shape)
    return Gain(np.clip(table, LEAST, MOST))


def _spread(frames: Numbers) -> Numbers:
    return np.asarray(frames[np.unique(np.linspace(0, len(frames) - 1, min(FRAMES, len(frames))).round().astype(int))])


def _alike(a: Array, b: Array, lengths: Array, much: float) -> Array:
    away = (a[:, None] - b[None]) / lengths
    return np.asarray(much**2 * np.exp(-0.5 * (away**2).sum(axis=2)))


def _process(
    at: Array, value: Array, press: Numbers, lengths: Array, sizes: tuple[float, float, float]
) -> tuple[Array, float]:
    """Weights of the frames and the constant mean."""
    much, noise, apart = sizes
    common = _alike(at, at, lengths, much) + apart**2 * (press[:, None] == press[None])
    own, ones = np.full(len(value), noise**2), np.ones(len(value))
    weight, mean = np.zeros(len(value)), 0.0
    for _ in range(ROUNDS):
        solved = np.linalg.solve(common + np.diag(own), np.column_stack([value, ones]))
        mean = float(ones @ solved[:, 0] / (ones @ solved[:, 1]))
        weight = solved[:, 0] - mean * solved[:, 1]
        own = noise**2 * np.maximum(1, np.abs(own * weight) / (2 * noise))
    return weight, mean
