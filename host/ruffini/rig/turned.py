"""A reference whose axes are not the pad's, or that stands elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.rig.reference import Facts, Reading, Reference, lost_packets

Array = npt.NDArray[np.float64]


def turn_of(axes: Sequence[str], *, is_inverted: bool = False) -> Array:
    """(3, 3) from the reference's axes to the pad's, e.g. of ("+y", "-x", "+z"); inverted: it measures what acts on it.

    Raises
    ------
    InputError
        They are no turn of right-handed axes.
    """
    matrix = np.array([[(-1.0 if a[0] == "-" else 1.0) * (a[1] == name) for name in "xyz"] for a in axes])
    if not np.isclose(np.linalg.det(matrix), 1):
        raise InputError(f"axes {', '.join(axes)} of the reference are no turn: each axis once, and right-handed: "
                         "where only the sign of every force is wrong, give is_inverted = true")  # fmt: skip
    return -matrix if is_inverted else matrix


class Turned:
    """Readings of another reference, in the pad's axes and about its centre.

    arm_m : where the pad's centre is from the reference's origin, in the pad's axes, (3,).
    """

    def __init__(self, reference: Reference, matrix: Array, arm_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self._reference, self._matrix, self._arm_m = reference, matrix, np.array(arm_m)
        facts, mix = reference.facts, abs(matrix)
        full_scale, sigma = (np.concatenate([mix @ v[:3], mix @ v[3:]]) for v in (facts.full_scale, facts.sigma))
        self.facts: Facts = replace(facts, full_scale=full_scale, sigma=sigma)

    def read(self, timeout_s: float) -> list[Reading]:
        return [r._replace(wrench=self._carried(r.wrench)) for r in self._reference.read(timeout_s)]

    @property
    def n_lost(self) -> int | None:
        return lost_packets(self._reference)

    def _carried(self, wrench: Array) -> Array:
        force = self._matrix @ wrench[:3]
        return np.concatenate([force, self._matrix @ wrench[3:] - np.cross(self._arm_m, force)])

    def close(self) -> None:
        self._reference.close()
