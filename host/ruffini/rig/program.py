"""Which touches are collected: a plan that is the same whenever it is made, so that it can be gone on with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ruffini.boards import Board
from ruffini.errors import InputError

BORDER = 0.25  # of the window's half side stays untouched: there the camera sees a part of the dent only
PROGRAMS = ("grid", "balls")


class Touch(NamedTuple):
    """One press: place, depth below the contact, and how far the tip then goes sideways, metres."""

    x_m: float
    y_m: float
    depth_m: float
    shear_x_m: float = 0.0
    shear_y_m: float = 0.0


class Span(NamedTuple):
    """Where a program touches and how deep, metres."""

    half_x_m: float
    half_y_m: float
    deepest_m: float
    shear_m: float


def span_of(board: Board, deepest_m: float, shear_m: float) -> Span:
    """The part of a board's pad that is touched: about its centre, well inside what the camera sees."""
    pad, window = board.pad, board.window
    half_x_um = min(pad.size_x_um / 2 - window.min_x_um, window.max_x_um - pad.size_x_um / 2)
    half_y_um = min(pad.size_y_um / 2 - window.min_y_um, window.max_y_um - pad.size_y_um / 2)
    inside = 1e-6 * (1 - BORDER)
    return Span(inside * half_x_um, inside * half_y_um, deepest_m, shear_m)


def plan(program: str, span: Span, n: int, seed: int) -> list[Touch]:
    """The touches of a program.

    `grid`: places in rows and columns, at each a depth and a shear of their own. `balls`: places and depths spread
    over the pad, without shear.

    Raises
    ------
    InputError
        No such program, or nothing to do.
    """
    if program not in PROGRAMS or n < 1:
        raise InputError(
            f"program {program!r} with {n} touches: choose {' or '.join(PROGRAMS)}, and one touch at least"
        )
    rng = np.random.default_rng(seed)
    return _grid(span, n, rng) if program == "grid" else _balls(span, n, rng)


def _grid(span: Span, n: int, rng: np.random.Generator) -> list[Touch]:
    n_x = max(1, round(np.sqrt(n * span.half_x_m / span.half_y_m)))
    n_y = -(-n // n_x)
    x = span.half_x_m * np.linspace(-1, 1, n_x) if n_x > 1 else np.zeros(1)
    y = span.half_y_m * np.linspace(-1, 1, n_y) if n_y > 1 else np.zeros(1)
    places = [(float(a), float(b)) for b in y for a in x][:n]
    levels = rng.permutation(np.linspace(0.4, 1.0, n))
    angles = rng.permutation(np.arange(n) * (2 * np.pi / n))
    way = np.where(np.arange(n) % 3 == 0, 0.0, span.shear_m)  # every third is straight
    return [
        Touch(*place, span.deepest_m * float(level), float(w * np.cos(a)), float(w * np.sin(a)))
        for place, level, a, w in zip(places, levels, angles, way, strict=True)
    ]


def _balls(span: Span, n: int, rng: np.random.Generator) -> list[Touch]:
    offset = rng.uniform(size=3)
    steps = np.array([0.8191725134, 0.6710436067, 0.5497004779])  # low discrepancy in three dimensions
    u = (offset + np.arange(n)[:, None] * steps) % 1
    return [
        Touch(
            float(span.half_x_m * (2 * a - 1)),
            float(span.half_y_m * (2 * b - 1)),
            float(span.deepest_m * (0.4 + 0.6 * c)),
        )
        for a, b, c in u
    ]
