"""Standard deviations of a touch's force and place, by kind of taxel: of presses that were left out of the fit.

    force    sqrt(a^2 + (b F)^2)          firmware/stages/skin/taxel_touches.h
    place    c + d threshold / F, along each axis

A panel's free edges make the force of a touch beside a seam, and of one at a rim, err three times as much as of one
inside. One deviation for all of them is too wide where most touches are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.estimators.skin.gain import COLUMNS

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.intp]

HARD_N = 2.0  # above it relative errors count, below it absolute ones
LEAST_PRESSES = 3  # fewer in a zone say nothing of it: the figures of all zones stand for it
LIGHT_N, FAR_MM = 0.2, 5.0  # where no press at all tells: of a light force, of a place


class Errors(NamedTuple):
    """Rows of pressed frames: reference force N, error of force N, errors of place (t, 2) mm along both axes, the kind
    of the taxel that sinks most, the number of the press.
    """

    load_n: Array
    off_n: Array
    off_mm: Array
    kind: Numbers
    press: Numbers

    @property
    def away_mm(self) -> Array:
        """Distance from the true place, (t,) mm."""
        return np.asarray(np.linalg.norm(self.off_mm, axis=1))

    def of(self, rows: npt.NDArray[np.bool_]) -> Errors:
        return Errors(self.load_n[rows], self.off_n[rows], self.off_mm[rows], self.kind[rows], self.press[rows])

    @classmethod
    def joined(cls, parts: list[Errors]) -> Errors:
        return cls(
            np.concatenate([p.load_n for p in parts]), np.concatenate([p.off_n for p in parts]),
            np.concatenate([p.off_mm for p in parts]), np.concatenate([p.kind for p in parts]),
            np.concatenate([p.press for p in parts]),
        )  # fmt: skip


class Spread(NamedTuple):
    """a in N, b over the force, c and d in mm."""

    force_n: float
    force_part: float
    place_mm: float
    faint_place_mm: float


def spread_of(errors: Errors, threshold_n: float) -> Spread:
    """Of errors of any kind.

    The parts are told apart by light and hard touches: what both have in common is in neither twice. threshold_n : the
    board's contact threshold.
    """
    hard = errors.load_n > HARD_N
    light, heavy = errors.of(~hard), errors.of(hard)
    part, constant = _rms(heavy.off_n / heavy.load_n, 0.0), _rms(light.off_n, LIGHT_N)
    if len(light.load_n) and len(heavy.load_n):
        at_light, at_heavy = _rms(light.load_n) ** 2, _rms(1 / heavy.load_n) ** 2
        constant_2 = (constant**2 - part**2 * at_light) / (1 - at_light * at_heavy)
        constant = max(constant_2, 0.0) ** 0.5  # errors that grow faster than the force leave none
        part = max(part**2 - constant**2 * at_heavy, 0.0) ** 0.5
    place, faint = _rms(heavy.off_mm, _rms(light.off_mm, FAR_MM)), 0.0
    if len(light.load_n) and len(heavy.load_n):
        share_light, share_heavy = (threshold_n * float(np.mean(1 / e.load_n)) for e in (light, heavy))
        faint = max((_rms(light.off_mm) - place) / (share_light - share_heavy), 0.0)
        place = max(place - faint * share_heavy, 0.0)
    return Spread(constant, part, place, faint)


def spread_by_kind(errors: Errors, threshold_n: float, n_kinds: int) -> list[Spread]:
    """One of each kind of `gain_kinds`: force inside, beside a seam and at a rim; place at a rim and elsewhere.

    Finer zones did not predict presses that they had not seen any better.
    """
    of_force = _by_zone(errors, _force_zones, threshold_n, n_kinds)
    of_place = _by_zone(errors, _place_zones, threshold_n, n_kinds)
    return [Spread(*force[:2], *place[2:]) for force, place in zip(of_force, of_place, strict=True)]


def _by_zone(errors: Errors, zones: Callable[[Numbers], Numbers], threshold_n: float, n_kinds: int) -> list[Spread]:
    zone, of_all = zones(errors.kind), spread_of(errors, threshold_n)
    own = {}
    for number in np.unique(zone):
        rows = errors.of(zone == number)
        hard = rows.load_n > HARD_N
        n_presses = min(len(np.unique(rows.press[hard])), len(np.unique(rows.press[~hard])))
        own[int(number)] = spread_of(rows, threshold_n) if n_presses >= LEAST_PRESSES else of_all
    return [own.get(int(number), of_all) for number in zones(np.arange(n_kinds))]


def _force_zones(kind: Numbers) -> Numbers:
    return np.asarray(np.where(kind >= COLUMNS, 2, kind % COLUMNS == 0))


def _place_zones(kind: Numbers) -> Numbers:
    return np.asarray(np.where(kind >= COLUMNS, 1, 0))


def _rms(values: Array, otherwise: float = 0.0) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else otherwise
