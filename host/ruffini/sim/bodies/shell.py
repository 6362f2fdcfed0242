"""Thin shell at large displacement: Kirchhoff-Love without rotations, on cubic B-splines.

Koiter's energy of the middle surface (Kiendl, Bletzinger, Linhard and Wuechner, 2009), plane stress, so rubber's
incompressibility locks nothing:

    W = integral of (t / 2 strain : C : strain + t^3 / 24 bend : C : bend) dA,
    strain = (a_ij - A_ij) / 2,   bend = B_ij - b_ij,   a_ij first, b_ij second fundamental form.

Strains are small, displacements and turns may be large. The resultants relax by one Prony series.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.bodies.splines import Patch

Array = npt.NDArray[np.float64]

_LEVI = np.zeros((3, 3, 3))
_LEVI[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
_LEVI[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1
_TWICE = np.array([1.0, 1.0, 2.0])  # components 11, 22, 12: the last stands for two


@dataclass
class _Frame:
    """Geometry at every Gauss point, (elements, 9, ...): a_1, a_2, second derivatives 11 22 12, normal, its length."""

    a1: Array
    a2: Array
    second: Array
    normal: Array
    area: Array

    def first_form(self) -> Array:
        pairs = ((self.a1, self.a1), (self.a2, self.a2), (self.a1, self.a2))
        return np.stack([(p * q).sum(axis=-1) for p, q in pairs], axis=-1)

    def second_form(self) -> Array:
        return np.asarray((self.second @ self.normal[..., None])[..., 0])


@dataclass
class Shell:
    """A shell with control points at rest (n, 3) metres; resultants are (elements, 9, 6): 11 22 12 of force, moment.

    held : what of the resultants is there whatever the strain is now; factor : on the elastic ones (relaxation).
    """

    patch: Patch
    rest: Array
    thickness_m: float
    modulus_pa: float
    poisson: float

    def __post_init__(self) -> None:
        frame = self._frame(self.rest)
        self._first, self._second = frame.first_form(), frame.second_form()
        self.areas = frame.area * self.patch.weights  # (elements, 9) square metres
        det = self._first[..., 0] * self._first[..., 1] - self._first[..., 2] ** 2
        g11, g22, g12 = self._first[..., 1] / det, self._first[..., 0] / det, -self._first[..., 2] / det
        plane, nu = self.modulus_pa / (1 - self.poisson**2), self.poisson
        c = np.empty((*det.shape, 3, 3))
        c[..., 0, 0], c[..., 1, 1] = g11**2, g22**2
        c[..., 0, 1] = c[..., 1, 0] = nu * g11 * g22 + (1 - nu) * g12**2
        c[..., 0, 2] = c[..., 2, 0] = g11 * g12
        c[..., 1, 2] = c[..., 2, 1] = g22 * g12
        c[..., 2, 2] = nu * g12**2 + (1 - nu) / 2 * (g11 * g22 + g12**2)
        self._law = plane * c  # stress from strain 11, 22, 2 x 12

    def _frame(self, place: Array) -> _Frame:
        x = place[self.patch.functions]  # (elements, 16, 3)
        d = [self.patch.values[k] @ x for k in range(1, 6)]
        long = np.cross(d[0], d[1])
        area = np.linalg.norm(long, axis=-1)
        return _Frame(d[0], d[1], np.stack(d[2:], axis=2), long / area[..., None], area)

    def resultants(self, place: Array) -> Array:
        """Elastic forces and moments of control points at `place` (n, 3)."""
        return self._resultants(self._frame(place))

    def _resultants(self, frame: _Frame) -> Array:
        strain = (frame.first_form() - self._first) / 2 * _TWICE
        bend = (self._second - frame.second_form()) * _TWICE
        t = self.thickness_m
        force, moment = ((self._law @ e[..., None])[..., 0] for e in (strain, bend))
        return np.concatenate([t * force, t**3 / 12 * moment], axis=-1)

    def energy(self, place: Array) -> float:
        """Elastic energy, joules."""
        frame = self._frame(place)
        strain = (frame.first_form() - self._first) / 2 * _TWICE
        bend = (self._second - frame.second_form()) * _TWICE
        return float((self._resultants(frame) * np.concatenate([strain, bend], axis=-1)).sum(axis=-1).ravel()
                     @ self.areas.ravel()) / 2  # fmt: skip

    def balance(
        self, place: Array, factor: float = 1.0, held: Array | float = 0.0
    ) -> tuple[Array, Callable[[], Array]]:
        """Nodal forces (n, 3) that hold the shell at `place`, and what makes their tangents, (elements, 48, 48)."""
        frame = self._frame(place)
        w = self.areas[..., None]
        resultants = (factor * self._resultants(frame) + held) * w

        def tangent() -> Array:
            strain_r, bend_r, normal_r, long_r = _first_variations(self.patch.values, frame)
            rows = np.concatenate([strain_r, bend_r], axis=2)  # (elements, 9, 6, 48)
            t = self.thickness_m
            law = np.zeros((*self._law.shape[:2], 6, 6))
            law[..., :3, :3], law[..., 3:, 3:] = factor * t * self._law, factor * t**3 / 12 * self._law
            out = _gram((law @ rows) * w[..., None], rows)
            out += self._stressed(frame, resultants, normal_r, long_r)
            return out

        return self._nodal(frame, resultants), tangent

    def _nodal(self, frame: _Frame, resultants: Array) -> Array:
        """Forces (n, 3) of resultants times the areas: what their product with the first variations is, without these.

        With v = moment : a_ij and u = (v - v . a3 a3) / |a1 x a2|, moment : (a_ij . a3)_r = N_ij,r moment . a3 +
        N_1,r a2 x u + N_2,r u x a1.
        """
        n, moment = resultants[..., :3], resultants[..., 3:] * _TWICE
        _, u = _turned(frame, moment)
        first = n[..., :1] * frame.a1 + n[..., 2:3] * frame.a2 - np.cross(frame.a2, u)
        second = n[..., 1:2] * frame.a2 + n[..., 2:3] * frame.a1 - np.cross(u, frame.a1)
        bends = -moment[..., None] * frame.normal[..., None, :]
        force = np.zeros((len(self.patch.functions), 16, 3))
        for values, along in zip(self.patch.values[1:], (first, second, *np.moveaxis(bends, 2, 0)), strict=True):
            force += values.swapaxes(1, 2) @ along
        at = self.patch.functions.ravel()
        return np.column_stack([np.bincount(at, force[..., i].ravel(), self.patch.n) for i in range(3)])

    def _stressed(self, frame: _Frame, resultants: Array, normal_r: Array, long_r: Array) -> Array:
        """The part of the tangent that comes from second variations; `resultants` are times the areas."""
        n1, n2 = self.patch.values[1], self.patch.values[2]
        m, q = n1.shape[:2]
        n, moment = resultants[..., :3], resultants[..., 3:] * _TWICE
        first = n[..., :1] * n1 + n[..., 2:3] * n2
        second = n[..., 1:2] * n2 + n[..., 2:3] * n1
        scalar = n1.swapaxes(1, 2) @ first + n2.swapaxes(1, 2) @ second
        out = np.zeros((m, 16, 3, 16, 3))
        for i in range(3):
            out[:, :, i, :, i] = scalar
        # Minus moment : b_rs, b_rs = N_ij,r a3_s + N_ij,s a3_r + a_ij . a3_rs.
        v, u = _turned(frame, moment)
        area, across = frame.area[..., None], (v * frame.normal).sum(axis=-1, keepdims=True)
        for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
            skew = (u[..., k, None] * n1).swapaxes(1, 2) @ n2
            skew -= skew.swapaxes(1, 2)
            out[:, :, i, :, j] -= skew
            out[:, :, j, :, i] += skew
        out = out.reshape(m, 48, 48)
        p = sum(moment[..., k, None] * self.patch.values[3 + k] for k in range(3))
        cross = (p.swapaxes(1, 2) @ normal_r.reshape(m, q, -1)).reshape(m, 48, 48)
        area_r = (frame.normal[..., None, :] @ long_r)[..., 0, :]
        v_r = (v[..., None, :] @ long_r)[..., 0, :]
        cross -= _gram(((v_r - 1.5 * across * area_r) / area**2)[:, :, None], area_r[:, :, None])
        out -= cross + cross.swapaxes(-1, -2)
        out += _gram((across / area**2)[..., None] * long_r, long_r)
        return np.asarray(out)


def _turned(frame: _Frame, moment: Array) -> tuple[Array, Array]:
    """v = moment : a_ij, and its part in the surface over the surface's area."""
    v = (moment[..., None, :] @ frame.second)[..., 0, :]
    return v, (v - (v * frame.normal).sum(axis=-1, keepdims=True) * frame.normal) / frame.area[..., None]


def _gram(left: Array, right: Array) -> Array:
    """Sum over Gauss points and rows of left_r right_s, (elements, 48, 48)."""
    m = len(left)
    return np.asarray(left.reshape(m, -1, 48).swapaxes(1, 2) @ right.reshape(m, -1, 48))


def _first_variations(values: Array, frame: _Frame) -> tuple[Array, Array, Array, Array]:
    """Of strain and bend (elements, 9, 3, 48), of the normal and of a1 x a2 (elements, 9, 3 xyz, 48)."""
    m, q = values.shape[1:3]
    n1, n2 = values[1], values[2]

    def times(f: Array, vector: Array) -> Array:
        return np.asarray((f[..., :, None] * vector[..., None, :]).reshape(m, q, 48))

    strain_r = np.stack([times(n1, frame.a1), times(n2, frame.a2), times(n1, frame.a2) + times(n2, frame.a1)], axis=2)
    # d(a1 x a2) along control point a's coordinate i, its three parts k one after the other.
    first, second = (np.stack([f @ _LEVI[k] for k in range(3)], axis=2) for f in (-frame.a2, frame.a1))
    long_r = first[:, :, :, None] * n1[:, :, None, :, None] + second[:, :, :, None] * n2[:, :, None, :, None]
    long_r = long_r.reshape(m, q, 3, 48)
    area_r = frame.normal[..., None, :] @ long_r
    normal_r = (long_r - frame.normal[..., None] * area_r) / frame.area[..., None, None]
    bend_r = -np.stack([times(values[3 + k], frame.normal) for k in range(3)], axis=2) - frame.second @ normal_r
    bend_r[..., 2, :] *= 2
    return strain_r, bend_r, normal_r, long_r
