"""Places in clusters: halves of halves along the longer side, as the hierarchy and the dense blocks need them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

ORDER_LEAF = 16  # places within which the order no longer matters


def halves(place_m: Array, index: Index) -> list[Index]:
    """`index` cut in two near the middle across its longest side, never between equal coordinates.

    One part only where all places are equal.
    """
    places = place_m[index]
    axis = int(np.argmax(np.ptp(places, axis=0)))
    order = np.argsort(places[:, axis], kind="stable")
    along = places[order, axis]
    cuts = np.flatnonzero(np.diff(along) > 1e-9 * max(float(np.abs(along).max()), 1e-300)) + 1
    if not len(cuts):
        return [index]
    cut = cuts[np.argmin(np.abs(cuts - len(order) // 2))]
    return [index[order[:cut]], index[order[cut:]]]


def cluster_order(place_m: Array) -> Index:
    """All indices, neighbours close to each other."""
    parts, done = [np.arange(len(place_m))], []
    while parts:
        part = parts.pop()
        split = halves(place_m, part) if len(part) > ORDER_LEAF else [part]
        if len(split) == 1:
            done.append(np.sort(split[0]))
        else:
            parts += reversed(split)
    return np.concatenate(done)
