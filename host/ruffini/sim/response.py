"""What a pad has behind its surface: how the surface moves under forces, now and after what was before.

Contact (`ruffini.sim.contact`) sees a linear pad, `rows`, whose unloaded surface is at `free_surface`. A linear
pad is just that. A pad at finite strain is corrected until that linear picture, its tangent, agrees with the
equilibrium inside. One response may serve several indenters, at once or one after another.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.sim.finite import FiniteMesh
from ruffini.sim.pad import BLAS
from ruffini.sim.prony import Memory, Prony

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

HISTORY = 5  # steps that the acceleration combines
PATIENCE = 14  # corrections with one tangent before another is factored


class Response(Protocol):
    """A pad in time. `begin`, then `free_surface`, contact and `correct` until that is small, then `commit`."""

    @property
    def moves_the_arm(self) -> bool:
        """Whether moments count the place to which the forces moved."""

    @property
    def surface(self) -> Array:
        """Displacement of the surface when the last increment ended, (n, 3)."""

    def begin(self, duration_s: float) -> None:
        """Another increment of the path, of this duration."""

    def free_surface(self) -> Array:
        """Where the surface of the linear picture is without load, (n, 3)."""

    def rows(self, nodes: Indices) -> Array:
        """Displacement of the whole surface for unit forces on `nodes` in the linear picture, (3 m, 3 n)."""

    def correct(self, nodal_force: Array, surface: Array) -> float:
        """Towards equilibrium with forces (n, 3), with which the linear picture's surface is at `surface` (n, 3).

        Returns the largest displacement that was lacking, metres.
        """

    def commit(self) -> None:
        """This is how the increment ends."""


class LinearResponse:
    """A pad at small strain, from its surface compliance (3 n, 3 n), with relaxation."""

    moves_the_arm = False

    def __init__(self, compliance: Array, prony: Prony | None = None) -> None:
        self._compliance = compliance
        self._memory = Memory(prony or Prony())  # of C f without relaxation, which is the displacement
        self._free: Array = np.zeros((len(compliance) // 3, 3))
        self._end = self._free

    @property
    def surface(self) -> Array:
        return self._end

    def begin(self, duration_s: float) -> None:
        self._memory.begin(duration_s)
        held = np.broadcast_to(self._memory.held, self._free.shape)
        self._free = -held / self._memory.factor + 0.0

    def free_surface(self) -> Array:
        return self._free

    def rows(self, nodes: Indices) -> Array:
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        rows = self._compliance[dofs]
        return np.asarray(rows if self._memory.factor == 1.0 else rows / self._memory.factor)

    def correct(self, nodal_force: Array, surface: Array) -> float:
        self._end = surface
        return 0.0

    def commit(self) -> None:
        self._memory.commit(self._end)


class Tangent:
    """A factored tangent, and the columns of its surface compliance that were asked for."""

    def __init__(self, mesh: FiniteMesh, u: Array) -> None:
        with BLAS.limit(limits=1):
            self._factor = mesh.tangent(u)
        n = mesh.n_plane
        self._rows, self._has = np.empty((3 * n, 3 * n), np.float32), np.zeros(n, bool)

    def solve(self, force: Array) -> Array:
        """Displacements (planes, n, 3) of forces (planes, n, 3)."""
        return self._factor.solve(force)

    def rows(self, nodes: Indices) -> Array:
        """Displacement of the surface for unit forces on its `nodes`, (3 m, 3 n)."""
        missing = nodes[~self._has[nodes]]
        if missing.size:
            dofs = (3 * missing[:, None] + np.arange(3)).ravel()
            self._rows[dofs] = self._factor.surface_columns(dofs)
            self._has[missing] = True
        return np.asarray(self._rows[(3 * nodes[:, None] + np.arange(3)).ravel()], np.float64)


class FiniteResponse:
    """A slab at finite strain with relaxation: each increment starts from the tangent that served the last one.

    Quasi-linear: the second Piola-Kirchhoff stress relaxes as the series says (Fung, 1972).

    Parameters
    ----------
    mesh : may be shared.
    prony : relaxation.
    at_rest : the tangent of the untouched slab, where there is one already.
    """

    moves_the_arm = True

    def __init__(self, mesh: FiniteMesh, prony: Prony | None = None, at_rest: Tangent | None = None) -> None:
        self._mesh, self._prony = mesh, prony or Prony()
        self._memories = [Memory(self._prony) for _ in mesh.layers]
        self.u = mesh.at_rest()
        self._steps: deque[tuple[Array, Array]] = deque(maxlen=HISTORY)
        self._held, self._n_corrections = mesh.at_rest(), 0
        self._tangent = at_rest or Tangent(mesh, self.u)

    @property
    def surface(self) -> Array:
        return np.asarray(self.u[-1])

    def begin(self, duration_s: float) -> None:
        for memory in self._memories:
            memory.begin(duration_s)
        self._steps.clear()
        self._n_corrections = 0

    def free_surface(self) -> Array:
        if self._n_corrections == PATIENCE:
            self._tangent, self._n_corrections = Tangent(self._mesh, self.u), 0
            self._steps.clear()
        self._held = self._solve(self.internal_force())
        return np.asarray(self.u[-1] - self._held[-1])

    def internal_force(self) -> Array:
        """Nodal forces (planes, n, 3) that hold the displacements as they are now."""
        stresses = []
        for memory, f in zip(self._memories, self._mesh.deformations(self.u), strict=True):
            p = memory.factor * self._mesh.stress(f)
            if self._prony.terms:
                p += np.einsum("miqJ,mJqK->miqK", f, np.broadcast_to(memory.held, f.shape), optimize=True)
            stresses.append(p)
        return self._mesh.force_of(stresses)

    def rows(self, nodes: Indices) -> Array:
        return self._tangent.rows(nodes) / self._factor

    def correct(self, nodal_force: Array, surface: Array) -> float:
        load = self._mesh.at_rest()
        load[-1] = nodal_force
        lack = self._solve(load) - self._held
        self._steps.append((self.u.ravel().copy(), lack.ravel()))
        self.u = _anderson(list(self._steps)).reshape(self.u.shape)
        self._n_corrections += 1
        return float(np.abs(lack).max())

    @property
    def _factor(self) -> float:
        return self._memories[0].factor

    def _solve(self, force: Array) -> Array:
        return self._tangent.solve(force) / self._factor

    def commit(self) -> None:
        if self._prony.terms:
            for memory, f in zip(self._memories, self._mesh.deformations(self.u), strict=True):
                memory.commit(self._mesh.second_stress(f))


def _anderson(steps: list[tuple[Array, Array]]) -> Array:
    """The next iterate: the combination of the last ones whose corrections cancel best (D. G. Anderson, 1965)."""
    u, lack = steps[-1]
    if len(steps) == 1:
        return u + lack
    du = np.stack([b[0] - a[0] for a, b in pairwise(steps)], axis=1)
    dl = np.stack([b[1] - a[1] for a, b in pairwise(steps)], axis=1)
    mix, *_ = np.linalg.lstsq(dl, lack, rcond=1e-10)
    return np.asarray(u + lack - (du + dl) @ mix)
