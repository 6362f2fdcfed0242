"""Relaxation of rubber as a Prony series: force(t) = integral of g(t - s) d elastic(s).

g(t) = c (1 - sum w_k (1 - exp(-t / tau_k))) with g(1 s) = 1: `elastic` is the response one second after a sudden
strain, when moduli are read. It may be nonlinear (Fung's quasi-linear viscoelasticity). Exact for an elastic response
that goes in a straight line within each step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

REFERENCE_S = 1.0  # after a sudden strain: when g is 1


@dataclass(frozen=True)
class Prony:
    """Terms (w_k, tau_k): part of the instantaneous response, and the time, in seconds, in which it goes."""

    terms: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        parts = [w for w, _ in self.terms]
        if any(w < 0 or tau <= 0 for w, tau in self.terms) or sum(parts) >= 1:
            raise InputError("parts that relax must be positive and sum below 1, and their times positive")

    def part(self, time_s: float) -> float:
        """g(t): stress at a time after a sudden strain over the one after REFERENCE_S."""
        return self._raw(time_s) / self._raw(REFERENCE_S)

    def _raw(self, time_s: float) -> float:
        return 1.0 + sum(w * float(np.expm1(-time_s / tau)) for w, tau in self.terms)

    @property
    def scale(self) -> float:
        """g(0): the instantaneous response over the one after REFERENCE_S."""
        return self.part(0.0)

    @property
    def loss(self) -> float:
        """Part of the instantaneous response that goes in the end."""
        return sum(w for w, _ in self.terms)


class Memory:
    """What one body remembers. `begin` a step: in it, force = `factor` elastic + `held`; `commit` ends it."""

    def __init__(self, prony: Prony) -> None:
        self._scale = prony.scale
        self._w = self._scale * np.array([w for w, _ in prony.terms])
        self._tau = np.array([tau for _, tau in prony.terms])
        self._elastic: Array = np.zeros(())
        self._terms: list[Array] = [np.zeros(()) for _ in prony.terms]  # what of each has not relaxed yet
        self._left, self._fresh = np.ones_like(self._w), self._w
        self.factor = self._scale
        self.held: Array = np.zeros(())

    def begin(self, duration_s: float) -> None:
        """A step of this duration."""
        part = duration_s / self._tau
        self._left = np.exp(-part)
        steady = np.divide(1 - self._left, part, out=np.ones_like(part), where=part > 0)
        self._fresh = self._w * steady
        self.factor = float(self._scale - self._w.sum() + self._fresh.sum())
        self.held = np.zeros(()) - self._fresh.sum() * self._elastic
        for left, term in zip(self._left, self._terms, strict=True):
            self.held = self.held + left * term

    def commit(self, elastic: Array) -> None:
        """The step ends with this elastic response."""
        change = elastic - self._elastic
        self._terms = [
            left * term + fresh * change for left, fresh, term in zip(self._left, self._fresh, self._terms, strict=True)
        ]
        self._elastic = np.array(elastic)
