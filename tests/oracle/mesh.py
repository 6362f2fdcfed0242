"""Meshes of the oracle's decks: a pad of 20-node bricks, finer under the contact, and a rigid sheet that presses on it.

Millimetres; the pad's free surface is z = 0 and its base is below. Node numbers start at 0 here and at 1 in a deck.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Height = Callable[[Array, Array], Array]

GROWTH = 1.5  # of one element over the one before, outside the fine part
# Half steps (x, y, z) of the 20 nodes of a brick from its lowest corner, in the order of the solver's manual.
HALF_STEPS = np.array([
    (0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2),
    (1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2),
    (0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1),
])  # fmt: skip
TOP_NODES = (4, 5, 6, 7, 12, 13, 14, 15)  # of a brick: the eight of its upper face


def graded(low: float, high: float, fine_low: float, fine_high: float, step: float) -> Array:
    """Element borders from `low` to `high`: about `step` apart between the fine limits, growing outside."""
    fine_low, fine_high = max(fine_low, low), min(fine_high, high)
    fine = np.linspace(fine_low, fine_high, max(1, round((fine_high - fine_low) / step)) + 1)

    def outside(length: float) -> Array:
        if length <= 0:
            return np.empty(0)
        steps, size = [], step
        while sum(steps) < length:
            size *= GROWTH
            steps.append(size)
        if len(steps) > 1 and sum(steps[:-1]) > 0.75 * length:
            steps.pop()
        return np.cumsum(steps) * (length / sum(steps))

    return np.concatenate([(fine_low - outside(fine_low - low))[::-1], fine, fine_high + outside(high - fine_high)])


@dataclass
class PadMesh:
    """Bricks between element borders x, y and z (upwards, the last is 0).

    `nodes` (n, 3) mm; `elements` (m, 20); `top` the nodes of the free surface, `base` those of the bonded one;
    `faces` (x elements * y elements, 8): the upper faces, x fastest, in the numbers of `nodes`.
    """

    x: Array
    y: Array
    z: Array
    nodes: Array = field(init=False)
    elements: Indices = field(init=False)

    def __post_init__(self) -> None:
        lines = [_with_middles(line) for line in (self.x, self.y, self.z)]
        k, j, i = np.meshgrid(*(np.arange(len(line)) for line in reversed(lines)), indexing="ij")
        is_node = (i % 2 + j % 2 + k % 2) <= 1  # no nodes within faces and bricks
        number = np.full(is_node.shape, -1)
        number[is_node] = np.arange(is_node.sum())
        self.nodes = np.column_stack([line[at[is_node]] for line, at in zip(lines, (i, j, k), strict=True)])
        k, j, i = np.meshgrid(*(2 * np.arange(len(line) - 1) for line in (self.z, self.y, self.x)), indexing="ij")
        corner = np.stack([i, j, k], axis=-1).reshape(-1, 1, 3) + HALF_STEPS
        self.elements = number[corner[..., 2], corner[..., 1], corner[..., 0]]

    @property
    def top(self) -> Indices:
        return np.flatnonzero(self.nodes[:, 2] == self.z[-1])

    @property
    def base(self) -> Indices:
        return np.flatnonzero(self.nodes[:, 2] == self.z[0])

    @property
    def top_elements(self) -> Indices:
        """Numbers of the bricks of the uppermost layer, x fastest."""
        n_layer = (len(self.x) - 1) * (len(self.y) - 1)
        return np.arange(len(self.elements) - n_layer, len(self.elements))

    @property
    def faces(self) -> Indices:
        return self.elements[self.top_elements][:, TOP_NODES]


def _with_middles(line: Array) -> Array:
    out = np.empty(2 * len(line) - 1)
    out[::2], out[1::2] = line, (line[1:] + line[:-1]) / 2
    return out


@dataclass
class Sheet:
    """A rigid sheet of 8-node bricks whose lower side presses: `nodes` (n, 3) mm, `elements` (m, 8)."""

    nodes: Array
    elements: Indices


def sheet(height: Height, half_x: float, half_y: float, step: float) -> Sheet:
    """The lower side of an indenter, z = height(x, y) within +-half_x, +-half_y."""
    lines = (np.linspace(-half, half, 2 * max(2, round(half / step)) + 1) for half in (half_x, half_y))
    x, y = np.meshgrid(*lines)
    return _sheet(x, y, height(x, y))


def punch(radius: float, flank: float, step: float) -> Sheet:
    """The lower side of a flat punch: a disc, and around it a flank of 45 degrees, `flank` wide."""
    n = max(2, round(radius / step))
    line = np.concatenate([np.linspace(0, radius, n + 1), radius + flank * np.array([0.5, 1.0])])
    u, v = np.meshgrid(*[np.concatenate([-line[:0:-1], line])] * 2)
    ring, distance = np.maximum(abs(u), abs(v)), np.hypot(u, v)
    scale = np.divide(ring, distance, out=np.ones_like(ring), where=distance > 0)  # squares become circles
    return _sheet(scale * u, scale * v, np.maximum(ring - radius, 0.0))


def _sheet(x: Array, y: Array, z: Array) -> Sheet:
    n_x = x.shape[1]
    lower = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    i, j = np.meshgrid(np.arange(n_x - 1), np.arange(len(x) - 1))
    corner = (j * n_x + i).ravel()[:, None] + np.array([0, 1, n_x + 1, n_x])
    return Sheet(np.vstack([lower, lower + np.array([0, 0, 0.5])]), np.hstack([corner, corner + len(lower)]))
