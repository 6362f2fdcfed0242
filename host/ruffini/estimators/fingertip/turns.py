"""A dome is a body of revolution: a press on it, turned about its axis or mirrored, is another press that could be.

Displacements are read between the pins by thin plates over the nearest of them; the pins' own places stay. What is not
round of a unit (its rim, its mould) is not in presses made so: they are added to the real ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ruffini.estimators.fingertip.presses import PITCH, ROLL, X, Y, axes

Array = npt.NDArray[np.float64]

NEAREST = 24  # pins that a place between them is read from


@dataclass(frozen=True)
class Samples:
    """Frames: displacements (t, n, 3) mm of the pins, and told (t, 7) as of `tip_presses.COLUMNS`."""

    moved: Array
    told: Array


def _plate(distance: Array) -> Array:
    return np.asarray(np.where(distance > 0, distance**2 * np.log(np.maximum(distance, 1e-12)), 0.0))


def between(normal: Array, at: Array) -> Array:
    """Weights (m, n) that read a field known at directions (n, 3) at other directions (m, 3)."""
    out = np.zeros((len(at), len(normal)))
    n_near = min(NEAREST, len(normal))
    for i, place in enumerate(at):
        first = np.cross(place, [0.3, 1.0, 0.2])
        first /= np.linalg.norm(first)
        away = normal - place
        near = np.argsort((away**2).sum(axis=1), kind="stable")[:n_near]
        flat = np.stack([away[near] @ first, away[near] @ np.cross(place, first)], axis=1)
        level = np.column_stack([np.ones(n_near), flat])
        apart = _plate(np.linalg.norm(flat[:, None] - flat[None], axis=2))
        system = np.block([[apart, level], [level.T, np.zeros((3, 3))]])
        right = np.concatenate([_plate(np.linalg.norm(flat, axis=1)), [1, 0, 0]])
        out[i, near] = np.linalg.solve(system, right)[:n_near]
    return out


@lru_cache(maxsize=128)
def _turning(pins: bytes, angle_rad: float, is_mirrored: bool) -> tuple[Array, Array]:
    """The turn (3, 3), and where each pin's new displacement is read from."""
    normal = np.frombuffer(pins).reshape(-1, 3)
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    if is_mirrored:
        turn = turn @ np.diag([1, -1, 1.0])
    return turn, between(normal, normal @ turn)


def turned(samples: Samples, normal: Array, angle_rad: float, *, is_mirrored: bool) -> Samples:
    """The same presses after the bench was mirrored in y (or not), then turned about the dome's axis."""
    turn, weights = _turning(np.ascontiguousarray(normal).tobytes(), angle_rad, is_mirrored)
    moved = np.einsum("mn,tnc->tmc", weights, samples.moved) @ turn.T
    told = samples.told.copy()
    mirror = np.diag([1, -1, 1.0]) if is_mirrored else np.eye(3)
    for row in told:
        tool = turn @ axes(*np.deg2rad(row[[ROLL, PITCH]])) @ mirror
        roll, pitch = np.arcsin(-tool[1, 2]), np.arctan2(tool[0, 2], tool[2, 2])
        spin = axes(roll, pitch).T @ tool  # of the tool about its own axis
        row[[X, Y]] = (spin @ mirror @ [row[X], row[Y], 0.0])[:2]
        row[[ROLL, PITCH]] = np.rad2deg([roll, pitch])
    return Samples(moved, told)
