"""Finds touches in a continuous record: start and end of the force, and the time near its maximum."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.rig.guarded_stage import CONTACT_N

Array = npt.NDArray[np.float64]

N_REST = 10  # rows at the start in which nothing touches: they are the tare
END_N = CONTACT_N / 2
HELD_PART = 0.8  # of a touch's largest force: it counts as held there
MARGIN_S = 0.5  # of rest that is kept before and after


class Cut(NamedTuple):
    """One touch, in seconds: the part that is kept, and the hold."""

    start_s: float
    touched_s: float
    held_s: float
    lifted_s: float
    end_s: float


def tare_of(where: str, wrench: Array, sigma: float = CONTACT_N / 3) -> Array:
    """The unloaded reading of a reference, (6,), from the first rows of a record.

    Raises
    ------
    InputError
        The record begins during a touch, or is too short.
    """
    first = np.nan_to_num(wrench[:N_REST])
    if len(first) < N_REST or first[:, :3].std(axis=0).max() > sigma:
        raise InputError(
            f"{where}: nothing may touch in the first {N_REST} rows: they are what the force is counted from"
        )
    return np.asarray(first.mean(axis=0))


def cut(where: str, time_s: Array, wrench: Array) -> list[Cut]:
    """Touches of a record whose tare was taken off.

    Raises
    ------
    InputError
        There is none.
    """
    size = np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1)
    found, i = [], 0
    while i < len(size):
        if size[i] < CONTACT_N:
            i += 1
            continue
        after = np.flatnonzero(size[i:] < END_N)
        end = i + int(after[0]) if len(after) else len(size)
        before = np.flatnonzero(size[:i] < END_N)
        begin = int(before[-1]) if len(before) else 0
        high = i + np.flatnonzero(size[i:end] >= HELD_PART * size[i:end].max())
        # Strictly between two samples, so that the samples at both ends of the hold belong to it.
        step_s = float(np.median(np.diff(time_s))) / 2
        found.append(Cut(time_s[begin] - MARGIN_S, time_s[begin], time_s[high[0]] - step_s, time_s[high[-1]] + step_s,
                         time_s[min(end, len(size) - 1)] + MARGIN_S))  # fmt: skip
        i = end
    if not found:
        raise InputError(f"{where}: no touch of {CONTACT_N} N or more: is the force in the unit that its column says?")
    return found
