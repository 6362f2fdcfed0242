"""Slab pad at finite strain: compressible neo-Hookean, total Lagrangian, on the linear pad's own mesh.

W = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2, so P = mu (F - F^-T) + lambda ln J F^-T; at small
strain it is the linear pad to rounding. 27-node elements with 3 x 3 x 3 points and displacements only: good
to a Poisson's ratio of 0.49 (MAX_POISSON), beyond which such elements lock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.hex27 import gradients, plane_nodes
from ruffini.sim.pad import PadModel
from ruffini.sim.slices import SliceFactor, SliceNodes

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

MAX_POISSON = 0.49
LEAST_VOLUME = 0.02  # J of a crushed integration point
AXES = (0, 1, 2)


@dataclass
class _ElementLayer:
    """Equal bricks: their nodes (m, 27) of all nodes, shape gradients (27 nodes, 81 = point, axis), volumes (27,)."""

    nodes: Indices
    gradients: Array
    volumes: Array

    def deformation(self, u: Array) -> Array:
        """F at the integration points for displacements (nodes, 3): (m, 3, points, 3)."""
        m = len(self.nodes)
        f = (u[self.nodes].transpose(0, 2, 1) @ self.gradients).reshape(m, 3, 27, 3)
        f[:, AXES, :, AXES] += 1.0
        return f

    def nodal_force(self, p: Array, out: Array) -> None:
        """Add the nodal forces of first Piola-Kirchhoff stresses (m, 3, points, 3) to `out` (nodes, 3)."""
        weighted = (p * self.volumes[:, None]).reshape(len(self.nodes), 3, 81)
        force = weighted @ self.gradients.T
        for c in AXES:
            out[:, c] += np.bincount(self.nodes.ravel(), force[:, c].ravel(), len(out))


class FiniteMesh:
    """Mesh and material of a slab: internal forces and tangents. May be shared; holds no state.

    Displacements and forces are (planes, n, 3), from the bonded bottom plane up, each plane as the pad's surface.

    Raises
    ------
    InputError
        Poisson's ratio is above MAX_POISSON.
    """

    def __init__(self, model: PadModel) -> None:
        if model.poisson > MAX_POISSON:
            raise InputError(
                f"Poisson's ratio {model.poisson:.4f} at finite strain: the elements lock above {MAX_POISSON}; "
                'choose a smaller one, or strain = "linear"'
            )
        self.model = model
        n_y, n_x = model.shape
        self.n_plane, self.n_planes = n_x * n_y, 2 * len(model.layers) + 1
        flat = plane_nodes(model.n_cells_x, model.n_cells_y)
        self.shear = model.modulus_pa / (2 * (1 + model.poisson))
        self.lame = model.modulus_pa * model.poisson / ((1 + model.poisson) * (1 - 2 * model.poisson))
        lines = np.array([-0.5, 0.0, 0.5])
        z, y, x = np.meshgrid(lines, lines, lines, indexing="ij")
        self.layers = []
        for k, part in enumerate(reversed(model.layers)):
            step = (model.size_x_m / model.n_cells_x, model.size_y_m / model.n_cells_y, part * model.thickness_m)
            g, volume = gradients(np.stack([x, y, z], axis=-1).reshape(1, 27, 3) * step)
            nodes = np.concatenate([(2 * k + p) * self.n_plane + flat for p in range(3)], axis=1)
            self.layers.append(_ElementLayer(nodes, g[0].transpose(1, 0, 2).reshape(27, 81), volume[0]))
        self.slices = SliceNodes(model.n_cells_x, model.n_cells_y, len(model.layers))

    def at_rest(self) -> Array:
        """No displacement anywhere, (planes, n, 3)."""
        return np.zeros((self.n_planes, self.n_plane, 3))

    def deformations(self, u: Array) -> list[Array]:
        """F of each layer of elements, (m, 3, points, 3)."""
        return [layer.deformation(u.reshape(-1, 3)) for layer in self.layers]

    def stress(self, f: Array) -> Array:
        """First Piola-Kirchhoff stress (m, 3, points, 3), pascal, of deformation gradients of that shape.

        Raises
        ------
        RuffiniError
            An element is crushed or turned inside out.
        """
        inverse, j = _inverse_transposed(f)
        return np.asarray(self.shear * f + (self.lame * np.log(j) - self.shear)[:, None, :, None] * inverse)

    def second_stress(self, f: Array) -> Array:
        """Second Piola-Kirchhoff stress F^-1 P, (m, 3, points, 3), pascal: it does not turn with the material."""
        inverse, j = _inverse_transposed(f)
        c_inverse = np.einsum("miqa,miqb->maqb", inverse, inverse)
        out = (self.lame * np.log(j) - self.shear)[:, None, :, None] * c_inverse
        out[:, AXES, :, AXES] += self.shear
        return np.asarray(out)

    def internal_force(self, u: Array) -> Array:
        """Nodal forces that hold the displacements u."""
        return self.force_of([self.stress(f) for f in self.deformations(u)])

    def force_of(self, stresses: list[Array]) -> Array:
        """Nodal forces of first Piola-Kirchhoff stresses of each layer."""
        total = np.zeros((self.n_planes * self.n_plane, 3))
        for layer, p in zip(self.layers, stresses, strict=True):
            layer.nodal_force(p, total)
        return total.reshape(self.n_planes, self.n_plane, 3)

    def tangent(self, u: Array) -> SliceFactor:
        """The tangent stiffness at displacements u, factored (seconds at the default mesh)."""
        elements = [
            self._element_tangents(layer, f) for layer, f in zip(self.layers, self.deformations(u), strict=True)
        ]
        return SliceFactor(self.slices, elements)

    def _element_tangents(self, layer: _ElementLayer, f: Array) -> Array:
        """dP_iJ/dF_kL = mu d_ik d_JL + (mu - lambda ln J) F^-T_iL F^-T_kJ + lambda F^-T_iJ F^-T_kL, (m, 81, 81)."""
        m = len(f)
        inverse, j = _inverse_transposed(f)
        g = layer.gradients.reshape(27, 27, 3)
        spatial = np.einsum("miqJ,nqJ->mqni", inverse, g, optimize=True).reshape(m, 27, 81)
        turned = spatial.transpose(0, 2, 1)
        bulk = turned @ (self.lame * layer.volumes[:, None] * spatial)
        cross = (layer.volumes * (self.shear - self.lame * np.log(j)))[:, :, None] * spatial
        out = bulk.reshape(m, 27, 3, 27, 3) + (turned @ cross).reshape(m, 27, 3, 27, 3).transpose(0, 1, 4, 3, 2)
        plain = self.shear * np.einsum("q,nqJ,pqJ->np", layer.volumes, g, g, optimize=True)
        for c in AXES:
            out[:, :, c, :, c] += plain
        return np.asarray(out.reshape(m, 81, 81))


def _inverse_transposed(f: Array) -> tuple[Array, Array]:
    """F^-T (m, 3, points, 3) and J (m, points)."""
    a, b, c = f[:, 0], f[:, 1], f[:, 2]
    cofactor = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    j = np.einsum("mqi,mqi->mq", a, cofactor[:, 0])
    if j.min() < LEAST_VOLUME:
        raise RuffiniError(
            f"the simulated gel is crushed to {max(float(j.min()), 0.0):.2f} of its volume at one place: press less "
            "deep, or with a rounder indenter"
        )
    return cofactor / j[:, None, :, None], j


def _cross(p: Array, q: Array) -> Array:
    """Cross product along the last axis, faster than numpy.cross."""
    out = np.empty_like(p)
    for i in AXES:
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = p[..., j] * q[..., k] - p[..., k] * q[..., j]
    return out
