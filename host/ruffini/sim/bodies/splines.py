"""Cubic B-splines on a rectangle: values and derivatives at points, element by element."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.interpolate import BSpline, make_interp_spline

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

DEGREE = 3
N_GAUSS = 3  # points along each side of an element
ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1))  # derivatives by a and by b


@dataclass(frozen=True)
class Line:
    """Splines over the intervals between `edges`, clamped at both ends."""

    edges: Array

    @property
    def n(self) -> int:
        """Number of functions."""
        return len(self.edges) - 1 + DEGREE

    @property
    def knots(self) -> Array:
        """Edges with both ends repeated."""
        return np.concatenate([[self.edges[0]] * DEGREE, self.edges, [self.edges[-1]] * DEGREE])

    def greville(self) -> Array:
        """Where each function is at home, (n,)."""
        return np.array([self.knots[i + 1 : i + 1 + DEGREE].mean() for i in range(self.n)])

    def interpolation(self) -> Array:
        """From values at the Greville points to coefficients, (n, n)."""
        return np.asarray(make_interp_spline(self.greville(), np.eye(self.n), k=DEGREE, t=self.knots).c)

    def matrix(self, at: Array, order: int = 0) -> sp.csr_matrix:
        """Derivatives of all functions at points inside, (m, n)."""
        spline = BSpline(self.knots, np.eye(self.n), DEGREE)
        return sp.csr_matrix(spline(at, nu=order) if order else spline(at))

    def gauss(self) -> tuple[Array, Array, Array]:
        """As `sampled`, at Gauss points."""
        return self.sampled(*np.polynomial.legendre.leggauss(N_GAUSS))

    def sampled(self, t: Array, w: Array) -> tuple[Array, Array, Array]:
        """Points t in -1 to 1 of every element with weights w: places and weights (elements, points).

        And the 4 functions' derivatives 0 to 2 there, (3 orders, elements, points, 4).
        """
        half = np.diff(self.edges)[:, None] / 2
        at = self.edges[:-1, None] + half * (t + 1)
        spline = BSpline(self.knots, np.eye(self.n), DEGREE)
        parts = []
        for order in range(3):
            full = spline(at.ravel(), nu=order).reshape(*at.shape, self.n)
            parts.append(np.stack([full[i, :, i : i + DEGREE + 1] for i in range(len(half))]))
        return at, half * w, np.stack(parts)


@dataclass(frozen=True)
class Patch:
    """Functions N_ij = N_i(a) N_j(b), number j * n_a + i, at the Gauss points of every element.

    functions : (elements, 16) numbers; values : (6 ORDERS, elements, 9, 16); weights : (elements, 9) of da db.
    """

    a: Line
    b: Line
    functions: Indices
    values: Array
    weights: Array

    @classmethod
    def of(cls, a: Line, b: Line) -> Patch:
        (_, w_a, n_a), (_, w_b, n_b) = a.gauss(), b.gauss()
        m = len(w_a) * len(w_b)
        values = np.stack([np.einsum("xpi,yqj->yxqpji", n_a[i], n_b[j]).reshape(m, 9, 16) for i, j in ORDERS])
        near_a = np.arange(len(w_a))[:, None] + np.arange(DEGREE + 1)
        near_b = np.arange(len(w_b))[:, None] + np.arange(DEGREE + 1)
        functions = (near_b[:, None, :, None] * a.n + near_a[None, :, None, :]).reshape(m, 16)
        weights = np.einsum("xp,yq->yxqp", w_a, w_b).reshape(m, 9)
        return cls(a, b, functions, values, weights)

    @property
    def n(self) -> int:
        """Number of functions."""
        return self.a.n * self.b.n

    def samples(self, n: int) -> tuple[Array, Array]:
        """n x n even samples of every element: values, first derivatives (3, elements, n^2, 16); weights of da db."""
        t, w = (np.arange(n) + 0.5) * 2 / n - 1, np.full(n, 2 / n)
        (_, w_a, n_a), (_, w_b, n_b) = self.a.sampled(t, w), self.b.sampled(t, w)
        m = len(self.functions)
        values = np.stack([np.einsum("xpi,yqj->yxqpji", n_a[i], n_b[j]).reshape(m, n * n, 16) for i, j in ORDERS[:3]])
        return values, np.einsum("xp,yq->yxqp", w_a, w_b).reshape(m, n * n)

    def spread(self, values: Array) -> sp.csr_matrix:
        """From coefficients to values at samples (elements, m, 16), element after element, (m elements, n)."""
        n_samples = values.shape[0] * values.shape[1]
        rows = np.repeat(np.arange(n_samples), 16)
        columns = np.repeat(self.functions, values.shape[1], axis=0).ravel()
        return sp.csr_matrix((values.ravel(), (rows, columns)), shape=(n_samples, self.n))

    def at_places(self, a: Array, b: Array) -> sp.csr_matrix:
        """From coefficients to values at single places, (m, n)."""
        along_a, along_b = self.a.matrix(a), self.b.matrix(b)
        return sp.csr_matrix(sp.vstack([sp.kron(along_b[i], along_a[i]) for i in range(len(a))]))

    def on_grid(self, a: Array, b: Array) -> sp.csr_matrix:
        """From coefficients to values on a grid of lines, rows of a, (n_b n_a, n)."""
        return sp.csr_matrix(sp.kron(self.b.matrix(b), self.a.matrix(a)))

    def interpolated(self, values: Array) -> Array:
        """Coefficients (n, k) of the splines with these values (n_b, n_a, k) at the Greville points."""
        out = np.einsum("ij,jak->iak", self.b.interpolation(), np.einsum("ij,bjk->bik", self.a.interpolation(), values))
        return np.asarray(out.reshape(self.n, -1))
