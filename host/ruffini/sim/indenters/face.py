"""The face of an elastic indenter at a pose: how it gives way to the tractions on the pad's nodes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.sim.indenters.body import IndenterBody
from ruffini.sim.pose import Pose

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


def _turn(pose: Pose) -> Array:
    c, s = np.cos(pose.turn_rad), np.sin(pose.turn_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@dataclass
class ElasticFace:
    """Displacement of the face so far, in the indenter's axes, which turn with it. Forces are those ON the pad."""

    body: IndenterBody
    _moved: Array = field(init=False)  # (n, 3) metres
    _kept: tuple[tuple[bytes, Pose], Array] | None = field(init=False, default=None)  # the last compliance

    def __post_init__(self) -> None:
        self.release()

    def release(self) -> None:
        """Nothing touches: the face springs back."""
        self._moved = np.zeros((self.body.compliance.shape[0], 3))

    def _shares(self, near: Indices, pose: Pose, place: Array) -> sp.csr_matrix:
        own = (place[near] - (pose.x_m, pose.y_m, 0.0)) @ _turn(pose)
        return self.body.shares(own[:, :2])

    def compliance(self, near: Indices, pose: Pose, place: Array) -> Array:
        """Retreat from the pad at nodes `near` per force there, in the pad's axes, (m, 3, m, 3).

        The last one is kept: it depends neither on the depth nor on a tilt, and a press straight down asks for the
        same one step after step.
        """
        told = (near.tobytes(), Pose(pose.x_m, pose.y_m, 0.0, pose.turn_rad))
        if self._kept is None or self._kept[0] != told:
            self._kept = (told, self._compliance(near, pose, place))
        return self._kept[1]

    def _compliance(self, near: Indices, pose: Pose, place: Array) -> Array:
        shares, turn = self._shares(near, pose, place), _turn(pose)
        n, m = self.body.compliance.shape[0], len(near)
        half = (shares @ self.body.compliance.reshape(n, -1)).reshape(m, 3, n, 3)
        full = (shares @ half.transpose(2, 3, 0, 1).reshape(n, -1)).reshape(m, 3, m, 3).transpose(2, 3, 0, 1)
        return np.asarray(np.einsum("ia,manb,jb->minj", turn, full, turn, optimize=True))

    def _pushed_face(self, near: Indices, force: Array, pose: Pose, place: Array) -> Array:
        load = self._shares(near, pose, place).T @ (-force @ _turn(pose))  # the pad pushes back
        return np.asarray(np.einsum("manb,nb->ma", self.body.compliance, load, optimize=True))

    def push(self, near: Indices, force: Array, pose: Pose, place: Array) -> None:
        """From now on these forces (m, 3) on the pad's nodes `near` are there."""
        self._moved = self._pushed_face(near, force, pose, place)

    def pushed(self, near: Indices, force: Array, pose: Pose, place: Array) -> Array:
        """Displacement that these forces would give the face over every node of the pad, (all, 3)."""
        face = self._pushed_face(near, force, pose, place)
        return np.asarray(self._shares(np.arange(len(place)), pose, place) @ face @ _turn(pose).T)

    def displacement(self, near: Indices, pose: Pose, place: Array) -> Array:
        """Displacement so far of the face over nodes `near`, in the pad's axes, (m, 3)."""
        return np.asarray(self._shares(near, pose, place) @ self._moved @ _turn(pose).T)
