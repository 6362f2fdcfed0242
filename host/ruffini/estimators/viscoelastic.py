"""Relaxation states of loads, stepped as the firmware steps them."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.intp]


class _Steps(NamedTuple):
    """Frames `row` of recordings lie in `place` when packed by step, the longest recordings first.

    Step i is the `n_at[i]` frames from `begin[i]` on.
    """

    row: Numbers
    place: Numbers
    begin: Numbers
    n_at: Numbers


@lru_cache(maxsize=16)  # a fit steps the same recordings hundreds of times
def _steps(first_bytes: bytes, n_bytes: bytes) -> _Steps:
    first, n = (np.frombuffer(raw, np.intp) for raw in (first_bytes, n_bytes))
    step = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    longest = np.argsort(-n, kind="stable")
    n_at = np.searchsorted(-n[longest], -np.arange(n.max(initial=0)))
    begin = np.cumsum(n_at) - n_at
    return _Steps(np.repeat(first, n) + step, begin[step] + np.repeat(np.argsort(longest), n), begin, n_at)


def relaxation_states(load: Array, part: Array, first: Numbers, n: Numbers) -> Array:
    """h of tau dh/dt = load - h, (terms, *load.shape), from zero in each of several recordings, stored in a row.

    Parameters
    ----------
    load : (t,) or (t, k); between two frames it is their mean.
    part : (terms, t) 1 - exp(-dt / tau) of the step to each frame.
    first, n : each recording's first frame, and how many it has.
    """
    row, place, begin, n_at = _steps(first.astype(np.intp).tobytes(), n.astype(np.intp).tobytes())
    mean, share = np.empty((len(row), *load.shape[1:])), np.empty((len(row), len(part)))
    mean[place] = (load[row] + load[row - 1]) / 2
    share[place] = part.T[row]
    share = share.reshape(*share.shape, *[1] * (load.ndim - 1))
    h = np.zeros((len(row), len(part), *load.shape[1:]))
    for i in range(1, len(begin)):  # all recordings at once
        before, rows = h[begin[i - 1] : begin[i - 1] + n_at[i]], slice(begin[i], begin[i] + n_at[i])
        now = np.subtract(mean[rows, None], before, out=h[rows])
        now *= share[rows]
        now += before
    out = np.zeros((len(part), *load.shape))
    out[:, row] = np.moveaxis(h[place], 1, 0)
    return out
