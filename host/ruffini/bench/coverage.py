"""How honest the stated uncertainty is: how often the truth lies within one and two sigma. SIMULATED.

On states of their own (UNSEEN), whose mechanics and contacts the error model has never seen and on which nothing was
chosen, on pads whose material is off by what `cal fit --only material` leaves, with white noise alone and with noise of
long correlation beside it.

A node counts where something is at stake: where it has, in truth or as reported, a force above 1/16 of the contact
threshold. Anywhere else both are zero or next to it and any sigma would cover. Of these nodes, `inside` are those that
are truly pressed and reported; `outside` are the others: force reported where nothing touches, or missed where
something does. Both kinds can fail in both directions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.states import State
from ruffini.estimators.operator.error_model import NodePlaces
from ruffini.fem.uncertainty import NodeSample, at_stake
from ruffini.sim.unit import PadError
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]

# `cal fit --only material` leaves pads that have, between them, the standard deviations 1 % of Poisson's ratio and
# 1.5 % of the thickness; the modulus is drawn for every frame (a linear pad's forces are proportional to it).
RESIDUAL_ERRORS = (
    PadError(poisson=1.014),
    PadError(poisson=0.986),
    PadError(thickness=1.021),
    PadError(thickness=0.979),
)
RESIDUAL_MODULUS = 0.015
WRENCH_AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
ZONES = ("inside", "outside")


@dataclass(frozen=True)
class Stated:
    """What a method says of one frame: force (n_y, n_x, 3) N, sigma of the same shape, covariance (6, 6) N and N m."""

    force: Array
    sigma: Array
    covariance: Array


@dataclass
class Tally:
    """Errors over sigma, and sigmas, of one column of the table."""

    ratio: list[float] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)

    def add(self, error: Array, sigma: Array) -> None:
        self.ratio += (np.abs(error) / sigma).ravel().tolist()
        self.sigma += sigma.ravel().tolist()

    def summary(self) -> dict[str, float]:
        """Percent within one and two sigma, mean sigma (N or N m), number of values."""
        ratio = np.array(self.ratio)
        within = {f"within_{k}": float(100 * np.mean(ratio < k)) if len(ratio) else float("nan") for k in (1, 2)}
        return {**within, "mean_sigma": float(np.mean(self.sigma)) if self.sigma else float("nan"), "n": len(ratio)}


class Coverage:
    """Collects the columns: shear and normal force inside and outside contacts, each axis of the wrench."""

    def __init__(self, places: NodePlaces, force_step_n: float, threshold_n: float) -> None:
        self._places, self._step_n, self._threshold_n = places, force_step_n, threshold_n
        self.n_states = 0  # that are independent: contact, depth and pad, not noise
        self.columns: dict[str, Tally] = {
            **{f"{what} {zone}": Tally() for zone in ZONES for what in ("shear", "normal")},
            **{axis: Tally() for axis in WRENCH_AXES},
        }

    def add(self, stated: Stated, truth: Array) -> None:
        """Judge one frame against the true nodal force (n_y, n_x, 3) N."""
        error = stated.force - truth
        sample = NodeSample(stated.force / self._step_n, truth / self._step_n)
        counts = at_stake(sample, self._threshold_n / self._step_n)
        is_inside = (truth[..., 2] < 0) & (stated.force[..., 2] != 0)
        for zone, chosen in (("inside", counts & is_inside), ("outside", counts & ~is_inside)):
            self.columns[f"shear {zone}"].add(error[chosen, :2], stated.sigma[chosen, :2])
            self.columns[f"normal {zone}"].add(error[chosen, 2], stated.sigma[chosen, 2])
        wrench = self._places.wrench(error, np.zeros(2))
        for axis, e, variance in zip(WRENCH_AXES, wrench, np.diag(stated.covariance), strict=True):
            self.columns[axis].add(np.array(e), np.sqrt(variance))

    def summary(self) -> dict[str, dict[str, float]]:
        return {name: tally.summary() for name, tally in self.columns.items()}


def drawn_modulus(rng: np.random.Generator, sigma: float = RESIDUAL_MODULUS) -> float:
    """A pad's modulus over the assumed one; by default as a fit leaves it."""
    return 1 + sigma * float(np.clip(rng.normal(), -2.5, 2.5))


def judge(
    coverage: Coverage,
    estimate: Callable[[Array], Stated],
    states: Iterable[State],
    disturb: Callable[[np.random.Generator], Array],
    rng: np.random.Generator,
) -> None:
    """Add every state once, with noise from `disturb` (metres) and a modulus of its own."""
    for state in states:
        modulus = drawn_modulus(rng)
        coverage.add(estimate(state.displacement + disturb(rng)), modulus * state.force)


def table(result: dict[str, Any]) -> str:
    """The columns as text."""
    lines = [f"{result['states']} independent states (contact, depth, pad), each with two kinds of noise"]
    lines += aligned(("", "within 1 sigma", "within 2 sigma", "mean sigma", "values"), [
        (name, f"{s['within_1']:.1f} %", f"{s['within_2']:.1f} %",
         f"{1e3 * s['mean_sigma']:.3f} {'N mm' if name.startswith('t') else 'mN'}", s["n"])
        for name, s in result["columns"].items()
    ], "  ")  # fmt: skip
    return "\n".join(lines)
