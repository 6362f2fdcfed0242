"""Relaxation states of loads, stepped as the firmware steps them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def relaxation_states(load: Array, part: Array, first: npt.NDArray[np.intp], n: npt.NDArray[np.intp]) -> Array:
    """h of tau dh/dt = load - h, (terms, *load.shape), from zero in each of several recordings, stored in a row.

    Parameters
    ----------
    load : (t,) or (t, k); between two frames it is their mean.
    part : (terms, t) 1 - exp(-dt / tau) of the step to each frame.
    first, n : each recording's first frame, and how many it has.
    """
    part = part.reshape(*part.shape, *[1] * (load.ndim - 1))
    out = np.zeros((len(part), *load.shape))
    for i in range(1, n.max(initial=0)):  # all recordings at once
        now = first[n > i] + i
        before = out[:, now - 1]
        out[:, now] = before + part[:, now] * ((load[now] + load[now - 1]) / 2 - before)
    return out
