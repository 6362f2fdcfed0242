"""How a glowing skin answers a touch: fitted to presses with known force and place. Not in the paper.

With u = ln(1 + ratio) of each taxel: by Beer and Lambert the way that its rubber was pressed, in attenuation lengths.

    force    E = sum over taxels of (P(u) - sum_k g_k h_k),   tau_k dh_k/dt = P(u) - h_k,
             P(u) = p (c(a u + b) - c(b)), c the force of a pyramid (`skin_rubber`), b how far the skin's hug presses it
    gain     F = E gain(kind of the taxel, |q_x|, |q_y|, E): what the mask and the panel's edge bear (`skin_gain`)
    place    taxel + shift + turn + cubic(q) of its column's and of its row's kind; q by its neighbours
    reach    u at an offset from a touch over its strength: a table, the same all over the skin

Columns and rows that mirror each other in a panel are of one kind (board.toml [skin] n_panels).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.skin.gain import COLUMNS, Gain, fit_gain, no_gain
from ruffini.estimators.skin.presses import Press
from ruffini.estimators.skin.rubber import pyramid_force
from ruffini.estimators.viscoelastic import relaxation_states

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.intp]

TIMES_S = (0.08, 0.5, 4.0, 30.0)  # of the memory: what presses of a tenth of a second to a minute can tell
START = (0.5, 0.1, 0.15, 0.15, 0.15, 0.15)  # a, b, g_k where the search begins: soft rubber
FLOOR = 0.02  # of u: below, a taxel is not touched
FORCE_N = (1.5, 10.0)  # of presses that the force is fitted to
SOFT_N = 7.0  # up to here the taxels bear nearly all
ODD = 0.3  # relative error beyond which a frame counts no more: a tool on a seam
GAIN_N = (0.9, 11.0)  # of presses that the gain is fitted to
PLACED_N = 0.8  # places are fitted above this load
KINDS = 4  # of columns, and of rows
SEARCH_ROUNDS = 300


@dataclass(frozen=True)
class Layout:
    """Taxels: places (n, 2) mm, neighbours (n, 8) or -1, kind and mirror sign of each one's column and row."""

    places_mm: Array
    near: Numbers
    kind: Numbers  # (n, 2)
    sign: Array  # (n, 2)
    round_mm: float  # way once round a tube, else 0

    def away(self, place_mm: Array) -> Array:
        """Offset (n, 2) of a place from each taxel, round a tube the shorter way."""
        away = place_mm - self.places_mm
        if self.round_mm:
            away[:, 0] = (away[:, 0] + self.round_mm / 2) % self.round_mm - self.round_mm / 2
        return np.asarray(away)


def layout_of(board: Board, places_mm: Array) -> Layout:
    """Neighbours and kinds of taxels at `places_mm` of the unrolled skin."""
    skin, markers = board.skin, board.markers
    assert skin is not None
    assert markers is not None
    pitch = np.array([markers.pitch_x_um, markers.pitch_y_um]) * 1e-3
    size = np.array([board.pad.size_x_um, board.pad.size_y_um]) * 1e-3
    round_mm = size[0] if skin.shape == "tube" else 0.0
    near = np.full((len(places_mm), 8), -1)
    steps = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)]
    empty = Layout(places_mm, near, np.zeros_like(near[:, :2]), np.ones((len(near), 2)), round_mm)
    for i, place in enumerate(places_mm):
        for k, step in enumerate(steps):
            off = np.linalg.norm(empty.away(place + np.array(step) * pitch) / pitch, axis=1)
            j = int(np.argmin(off))
            near[i, k] = j if off[j] < 0.5 and j != i else -1
    kind, sign = np.zeros((len(near), 2), dtype=np.intp), np.ones((len(near), 2))
    for axis, n_parts in ((0, skin.n_panels), (1, 1)):
        within = (places_mm[:, axis] + size[axis] / 2) % (size[axis] / n_parts)
        mirrored = within > size[axis] / n_parts / 2
        to_edge = np.where(mirrored, size[axis] / n_parts - within, within)
        kind[:, axis] = np.minimum(to_edge / pitch[axis], 3).astype(np.intp)
        sign[:, axis] = np.where(mirrored, -1, 1)
    return Layout(places_mm, near, kind, sign, float(round_mm))


def sinks(press: Press) -> Array:
    """u of every taxel and frame, (t, n)."""
    return np.asarray(np.log1p(np.maximum(press.ratio, -0.9)))


@dataclass(frozen=True)
class Peak:
    """The taxel that each frame of a press sinks most, (t,); q along x and y, (t, 2); u there, (t,)."""

    taxel: Numbers
    q: Array
    u: Array


def peaks(u: Array, layout: Layout) -> Peak:
    """As firmware/stages/skin/taxel_touches.h has them, of one touch."""
    frames, taxel = np.arange(len(u)), u.argmax(axis=1)
    here = u[frames, taxel]
    q = np.zeros((len(u), 2))
    for axis in (0, 1):
        before, behind = (layout.near[taxel, 2 * axis + side] for side in (0, 1))
        a, b = (np.where(near >= 0, u[frames, near], np.nan) for near in (before, behind))
        both = (b - a) / np.maximum(here - np.fmin(a, b), 1e-3)
        one = np.fmax(a, b) / np.maximum(here, 1e-3)
        q[:, axis] = np.where(np.isfinite(both), both, np.nan_to_num(one))
    return Peak(taxel, np.clip(q, -1, 1), here)


def rims(layout: Layout, axis: int) -> npt.NDArray[np.bool_]:
    """Taxels (n,) without a neighbour on one side along an axis."""
    return np.asarray((layout.near[:, 2 * axis] < 0) | (layout.near[:, 2 * axis + 1] < 0))


def gain_kinds(layout: Layout) -> Numbers:
    """Which gain touches on each taxel take, (n,); see `skin_gain`."""
    at_rim = rims(layout, 0) | rims(layout, 1)
    return np.asarray(np.minimum(layout.kind[:, 0], COLUMNS - 1) + COLUMNS * at_rim)


@dataclass(frozen=True)
class ForceFit:
    """p (N), a, b, g (4,), and the gain."""

    scale: float
    sink: float
    hug: float
    parts: Array
    gain: Gain

    def press(self, u: Array) -> Array:
        """P(u), N."""
        return np.asarray(self.scale * self._raised(np.maximum(u, 0.0)))

    def _raised(self, u: Array) -> Array:
        """P(u) / p of u >= 0."""
        return np.asarray(pyramid_force(self.sink * u + self.hug) - pyramid_force(np.array(self.hug)))

    def rise(self, u: Array) -> Array:
        """P(u) / p of touched taxels, 0 of the others."""
        out, touched = np.zeros_like(u), u >= FLOOR
        out[touched] = self._raised(u[touched])
        return out

    def elastic(self, u: Array, time_s: Array) -> Array:
        """E of every frame, (t,) N."""
        return self.elastic_of(self.rise(u), Memory.of([time_s]))

    def elastic_of(self, rise: Array, memory: Memory) -> Array:
        """The same of several presses, one after the other."""
        total = (self.scale * rise).sum(axis=1)
        return np.asarray(total - (self.parts[:, None] * memory.of_load(total)).sum(axis=0))

    def force(self, press: Press, layout: Layout) -> Array:
        """Estimate of every frame of a press with one touch, (t,) N."""
        u = sinks(press)
        elastic, at = self.elastic(u, press.time_s), peaks(u, layout)
        return np.asarray(elastic * self.gain.at(gain_kinds(layout)[at.taxel], elastic, at.q))


@dataclass(frozen=True)
class Memory:
    """Steps of the relaxation of presses stored in a row, as `relaxation_states` wants them."""

    part: Array
    first: Numbers
    n: Numbers

    @classmethod
    def of(cls, times_s: list[Array]) -> Memory:
        """Of presses with these times of their frames."""
        step_s = np.concatenate([np.diff(time_s, prepend=time_s[0]) for time_s in times_s])
        n = np.array([len(time_s) for time_s in times_s])
        return cls(-np.expm1(-step_s / np.array(TIMES_S)[:, None]), np.cumsum(n) - n, n)

    def of_load(self, load: Array) -> Array:
        """h of every frame (terms, t) as the firmware steps it, from zero in every press."""
        return relaxation_states(load, self.part, self.first, self.n)


def fit_force(presses: list[Press], layout: Layout, like: ForceFit | None = None) -> ForceFit:
    """The rubber by a simplex search over soft presses away from the rims, then the gain; relative errors.

    like : where the search begins, and need not go on for long.
    """
    u_of, force = [sinks(p) for p in presses], np.concatenate([p.force_n for p in presses])
    at = [peaks(u, layout) for u in u_of]
    kind, q = gain_kinds(layout)[np.concatenate([a.taxel for a in at])], np.concatenate([a.q for a in at])
    number = np.repeat(np.arange(len(presses)), [len(p.force_n) for p in presses])
    u, memory = np.concatenate(u_of), Memory.of([p.time_s for p in presses])
    soft = (force > FORCE_N[0]) & (force < SOFT_N)
    if not soft.any():
        raise InputError(f"no press is between {FORCE_N[0]:g} and {SOFT_N:g} N: the skin's rubber cannot be fitted")
    if (soft & (kind < COLUMNS)).any():  # a rim bears a part of its own
        soft &= kind < COLUMNS

    def made(v: Array) -> tuple[ForceFit, Array]:
        """A fit, and E of every frame by it."""
        fit = ForceFit(1.0, float(np.exp(v[0])), float(np.exp(v[1])), np.clip(v[2:], 0, 0.4), no_gain())
        rise = fit.rise(u)
        part = fit.elastic_of(rise, memory)
        fit = replace(fit, scale=1 / max(float(np.median(part[soft] / force[soft])), 1e-9))
        return fit, fit.elastic_of(rise, memory)

    start = np.array([*np.log(START[:2]), *START[2:]])

    def wrong(v: Array) -> float:
        off = (made(v)[1][soft] - force[soft]) / force[soft]
        outside = float(np.sum((v[2:] - np.clip(v[2:], 0, 0.4)) ** 2))
        return float(np.mean(np.minimum(off**2, ODD**2))) + outside + 1e-3 * float(np.sum((v - start) ** 2))

    begin = start if like is None else np.array([np.log(like.sink), np.log(like.hug), *like.parts])
    rounds = SEARCH_ROUNDS if like is None else SEARCH_ROUNDS // 5
    best = minimize(wrong, begin, method="Nelder-Mead", options={"maxiter": rounds, "adaptive": True})
    fit, elastic = made(best.x)
    used = (force > GAIN_N[0]) & (force < GAIN_N[1]) & (elastic > 0)
    return replace(fit, gain=fit_gain(kind[used], elastic[used], q[used], force[used], number[used]))
