"""Softness of squeezed objects: firmware/stages/softness/softness.h in floats, its fit and its tables.

A fit needs squeezes of rigid objects, whose dent is as sharp as the gel allows, and of any others, whose repeated
squeezes show by how much a result scatters. Its scale is the gel's modulus by the board's numbers, or that which
objects of known modulus show.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import erfc, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import Tensors
from ruffini.errors import InputError
from ruffini.estimators.wrench.log import FeatureRun

Array = npt.NDArray[np.float64]

RIM, BLOCKS, CHANNELS = 2, 6, 3  # cells, blocks, planes: those of firmware/stages/softness/softness.h
HARDEST = 0.9  # share of a rigid object's curvature from which on an object cannot be told from it
LEAST_SIGMA = 0.05  # octaves: few repeated squeezes may agree by chance
MAX_FORCE_UN, MAX_GEL_PA = 1 << 30, 1_000_000_000  # of firmware/stages/softness/softness.cpp
MICRO, ONE, LN2 = 1e6, 65536.0, float(np.log(2.0))
Z = 2  # axis of the force


class Grid(NamedTuple):
    """Cells of a board's [picture_features]."""

    n_x: int
    n_y: int


class Share(NamedTuple):
    """A squeeze: log2 of the curvature of its dent over that of a rigid object, and its standard deviation."""

    log: float
    sigma: float


class Squeezed(NamedTuple):
    """The frames of a rise: log2 of the dent's curvature, and of the force in newtons (t,)."""

    dent: Array
    force: Array


@dataclass(frozen=True)
class Softness:
    """low_n, high_n : forces between which a squeeze is judged. slope : octaves of curvature an octave of force.
    rigid : log2 of a rigid object's curvature at 1 N. sigma : octaves, between squeezes of one object.
    gel_pa : modulus over 1 - nu^2 at which an object gives way as much as the gel.
    """

    low_n: float
    high_n: float
    slope: float
    rigid: float
    sigma: float
    gel_pa: float

    def share(self, dent: Array, force: Array, sigma: Array | float = 0.0) -> Share | None:
        """Of frames (t,): log2 of the dent, force and its standard deviation, N; None if they hold no squeeze."""
        rise = rise_of(force, self.low_n, self.high_n)
        if rise is None:
            return None
        log = float(np.mean(dent[rise] - self.slope * np.log2(force[rise])) - self.rigid)
        relative = np.minimum(np.broadcast_to(sigma, force.shape)[rise] / force[rise], 1.0)
        return Share(log, float(np.hypot(self.sigma, self.slope * relative.mean() / LN2)))

    def modulus_pa(self, log_share: float) -> float:
        """Modulus of the object over 1 - nu^2; infinite if it cannot be told from a rigid one."""
        share = 2.0**log_share
        return inf if share > HARDEST else self.gel_pa * share / (1 - share)

    def interval_pa(self, share: Share) -> tuple[float, float]:
        """One standard deviation below and above."""
        return self.modulus_pa(min(share.log - share.sigma, float(np.log2(HARDEST)))), self.modulus_pa(
            share.log + share.sigma
        )

    def tables(self) -> Tensors:
        """Kind `softness` of proto/CALIBRATION.md."""
        rigid_at_un = self.rigid - self.slope * np.log2(MICRO)
        values = (self.low_n * MICRO, self.high_n * MICRO, self.slope * ONE, rigid_at_un * ONE, self.sigma * ONE,
                  self.gel_pa)  # fmt: skip
        return {"softness.map": np.round(values).astype(np.int32)}

    def text(self) -> str:
        """In one line, for a person."""
        return (
            f"  softness of squeezes from {self.low_n:g} to {self.high_n:g} N: squeezes of one object differ by "
            f"{100 * (2**self.sigma - 1):.0f} % (standard deviation); the gel's scale: {self.gel_pa / 1000:.3g} kPa"
        )

    def report(self) -> dict[str, Any]:
        """For a manifest and JSON."""
        return {"force_n": [self.low_n, self.high_n], "slope": self.slope, "sigma_octaves": self.sigma,
                "gel_pa": self.gel_pa}  # fmt: skip


def grid_of(board: Board) -> Grid:
    """The cells of a board's pictures.

    Raises
    ------
    InputError
        It has no such section, or too few cells inside their rim.
    """
    cells = board.picture_features
    if cells is None:
        raise InputError(f"board {board.name!r} has no [picture_features]: softness is fitted to its cells")
    n_blocks = max(cells.n_x - 2 * RIM - 1, 0) * max(cells.n_y - 2 * RIM - 1, 0)
    if n_blocks < BLOCKS:
        raise InputError(f"board {board.name!r}: [picture_features] has {cells.n_x} x {cells.n_y} cells; softness "
                         "needs 8 x 7 or more, since two at each edge do not count")  # fmt: skip
    return Grid(cells.n_x, cells.n_y)


def dent_of(features: Array, grid: Grid) -> Array:
    """log2 of the curvature of the dent of each frame (t,), from its features (t, n) in the core's integers."""
    f = features.reshape(-1, CHANNELS, grid.n_y, grid.n_x)[:, :, RIM : grid.n_y - RIM, RIM : grid.n_x - RIM]
    down, up = f[..., 1:, 1:] - f[..., :-1, :-1], f[..., :-1, 1:] - f[..., 1:, :-1]
    blocks = np.sort((2 * (down**2 + up**2)).sum(axis=1).reshape(len(f), -1), axis=1)
    return np.asarray(0.5 * np.log2(blocks[:, -BLOCKS:].mean(axis=1) + 1.0))


def rise_of(force: Array, low_n: float, high_n: float) -> npt.NDArray[np.intp] | None:
    """Frames of the first squeeze: from low_n on until high_n is reached; a release to half of low_n ends one.

    A jump from below low_n beyond high_n is none.
    """
    frames, is_over = list[int](), False
    for i, one in enumerate(force):
        if one < low_n / 2:
            frames, is_over = [], False
        is_over |= not frames and one >= high_n
        if not is_over and (frames or one >= low_n):
            frames.append(i)
            if one >= high_n:
                return np.array(frames)
    return None


def fit_softness(
    runs: Sequence[FeatureRun], grid: Grid, rigid: Iterable[str], force_n: tuple[float, float], gel_pa: float,
    moduli_pa: Mapping[str, float] | None = None,
) -> Softness:  # fmt: skip
    """Fit to squeezes whose force a load cell read.

    Parameters
    ----------
    rigid : recordings of rigid objects.
    force_n : lower and upper force of the rise.
    gel_pa : the gel's modulus over 1 - nu^2; used without `moduli_pa`.
    moduli_pa : moduli over 1 - nu^2 of recordings' objects.

    Raises
    ------
    InputError
        No squeeze of a rigid object, or no object that was squeezed twice.
    """
    low_n, high_n = force_n
    squeezes = dict[str, list[Squeezed]]()
    for run in runs:
        force = -run.reference[:, Z]
        if (rise := rise_of(force, low_n, high_n)) is not None:
            dent = dent_of(run.features, grid)[rise]
            squeezes.setdefault(run.recording, []).append(Squeezed(dent, np.log2(force[rise])))
    known = set(rigid)
    if not known & squeezes.keys():
        raise InputError(f"softness: no recording of a rigid object ({', '.join(sorted(known)) or 'none is named'}) "
                         f"rises from {low_n:g} to {high_n:g} N")  # fmt: skip
    if not any(len(parts) > 1 for parts in squeezes.values()):
        raise InputError("softness: no object was squeezed twice, so that nothing shows by how much a result scatters: "
                         "record at least two squeezes of each")  # fmt: skip
    every = [one for parts in squeezes.values() for one in parts]
    force = np.concatenate([one.force - one.force.mean() for one in every])
    dent = np.concatenate([one.dent - one.dent.mean() for one in every])
    slope = float(np.clip(float(force @ dent) / max(float(force @ force), 1e-9), 0.0, 2.0))
    level = {name: [float((one.dent - slope * one.force).mean()) for one in parts] for name, parts in squeezes.items()}
    n_repeats = sum(len(values) - 1 for values in level.values())
    variance = sum(float(np.var(values)) * len(values) for values in level.values()) / n_repeats
    rigid_level = float(np.mean([value for name in known & level.keys() for value in level[name]]))
    scale = [
        np.log2(pa * (2.0 ** (rigid_level - value) - 1))
        for name, pa in (moduli_pa or {}).items()
        for value in level.get(name, [])
        if value - rigid_level < np.log2(HARDEST)
    ]
    found = float(2.0 ** np.mean(scale)) if scale else gel_pa
    if not 1 <= found <= MAX_GEL_PA:
        raise InputError(f"softness: the gel's scale would be {found:g} Pa, beyond 1 to {MAX_GEL_PA:g}: are the moduli "
                         "of modulus_pa in Pa?")  # fmt: skip
    if not 1 <= round(low_n * MICRO) < round(high_n * MICRO) <= MAX_FORCE_UN:
        raise InputError(f"softness: squeeze_n of {low_n:g} and {high_n:g} N: they must rise from 1e-6 N to at most "
                         f"{MAX_FORCE_UN / MICRO:.0f} N")  # fmt: skip
    return Softness(low_n, high_n, slope, rigid_level, max(sqrt(variance), LEAST_SIGMA), found)


def mean_of(shares: Sequence[Share]) -> Share:
    """Of squeezes of one object, each with an error of its own."""
    n = len(shares)
    return Share(float(np.mean([s.log for s in shares])), sqrt(sum(s.sigma**2 for s in shares)) / n)


def chance_of_wrong(softer: Share, harder: Share) -> float:
    """Probability that the one with the larger share is the softer one after all, whichever that is; at most 0.5."""
    return 0.5 * erfc(abs(harder.log - softer.log) / sqrt(2 * (softer.sigma**2 + harder.sigma**2)))


def gel_pa_of(board: Board) -> float:
    """Modulus of the board's pad over 1 - nu^2."""
    return float(board.pad.modulus_pa / (1 - (board.pad.poisson_1e4 / 1e4) ** 2))
