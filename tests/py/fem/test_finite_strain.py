"""Second order of finite strain against a neo-Hookean pad solved whole, on elements of its own."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import numpy.typing as npt
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from kept import kept

from ruffini.errors import InputError
from ruffini.fem.finite_strain import EXACT, FITTED, LAYERS, MAX_NODES, Weights, finite_strain, fitted_weights
from ruffini.fem.slab import CORNERS, Slab, assemble_layer

Array = npt.NDArray[np.float64]

SLAB = Slab(
    size_x_m=12e-3, size_y_m=10e-3, thickness_m=2.4e-3, n_x=25, n_y=21, n_layers=6, modulus_pa=2e5, poisson=0.48
)  # fmt: skip


class WholePad:
    """Neo-Hookean slab of 8-node bricks with one volume change an element; inside in equilibrium, surface held."""

    def __init__(self, slab: Slab) -> None:
        self.shape = (slab.n_layers + 1, slab.n_y, slab.n_x)
        index = np.arange(np.prod(self.shape)).reshape(self.shape)
        cells = [
            index[a : a - 1 or None, b : b - 1 or None, c : c - 1 or None]
            for a in (0, 1)
            for b in (0, 1)
            for c in (0, 1)
        ]
        self.nodes = np.stack([cell.ravel() for cell in cells], axis=1)
        points, step = CORNERS / np.sqrt(3), np.array(slab.step_m)
        terms = 1 + CORNERS[None] * points[:, None]
        others = np.stack(
            [terms[..., 1] * terms[..., 2], terms[..., 0] * terms[..., 2], terms[..., 0] * terms[..., 1]], -1
        )
        self.gradient = CORNERS[None] * others / 4 / step
        self.volume = float(step.prod()) / 8
        self.shear = slab.modulus_pa / (2 * (1 + slab.poisson))
        self.lame = 2 * self.shear * slab.poisson / (1 - 2 * slab.poisson)
        layer, planes = assemble_layer(slab), slab.n_layers + 1
        blocks = [[None] * planes for _ in range(planes)]
        for k in range(slab.n_layers):
            for i, j, part in ((k, k, layer.upper), (k + 1, k + 1, layer.lower), (k, k + 1, layer.coupling),
                               (k + 1, k, layer.coupling.T)):  # fmt: skip
                blocks[i][j] = part if blocks[i][j] is None else blocks[i][j] + part
        self.stiffness = sp.bmat(blocks).tocsr()
        n = 3 * slab.n_nodes
        self.top, self.inner = slice(0, n), slice(n, n * slab.n_layers)
        self.inside = spl.factorized(self.stiffness[self.inner, self.inner].tocsc())

    def force(self, u: Array) -> Array:
        """Internal forces of displacements, flat."""
        f = np.eye(3) + np.einsum("eni,qnj->eqij", u.reshape(-1, 3)[self.nodes], self.gradient)
        j, inverse = np.linalg.det(f), np.swapaxes(np.linalg.inv(f), -1, -2)
        mean = j.mean(axis=1)
        square = np.square(f).sum(axis=(-2, -1))
        shape = (mean[:, None] / j) ** (2 / 3)
        stress = self.shear * shape[..., None, None] * (f - square[..., None, None] / 3 * inverse)
        swell = (self.shear * ((shape * square).mean(axis=1) / 3 - 1) + self.lame * np.log(mean)) / mean
        stress += (swell[:, None] * j)[..., None, None] * inverse
        out = np.zeros((int(np.prod(self.shape)), 3))
        np.add.at(
            out, self.nodes.ravel(), np.einsum("eqij,qnj->eni", stress, self.gradient).reshape(-1, 3) * self.volume
        )
        return out.ravel()

    def held(self, surface: Array) -> tuple[Array, Array]:
        """Forces on the surface (n_y, n_x, 3) of the linear pad and of this one."""
        u = np.zeros(self.stiffness.shape[0])
        u[self.top] = surface.ravel()
        u[self.inner] = -self.inside(self.stiffness[self.inner, self.top] @ u[self.top])
        linear = (self.stiffness[self.top] @ u).reshape(surface.shape)
        for _ in range(60):
            lack = self.inside(self.force(u)[self.inner])
            u[self.inner] -= 0.7 * lack
            if np.abs(lack).max() < 1e-10:
                break
        assert np.abs(lack).max() < 1e-9
        return linear, self.force(u)[self.top].reshape(surface.shape)


def dent(depth_m: float, shift_m: float) -> Array:
    """A smooth dent off the middle, sheared."""
    x, y = np.meshgrid(np.linspace(-6e-3, 6e-3, 25), np.linspace(-5e-3, 5e-3, 21))
    r2 = (x - 0.7e-3) ** 2 + (y + 0.4e-3) ** 2
    bell = np.exp(-r2 / (2 * 1.2e-3**2))
    push = np.stack([0.6 * (x - 0.7e-3), 0.6 * (y + 0.4e-3)], -1) / 1.2e-3 * depth_m / 4 * bell[..., None]
    push[..., 0] += shift_m * bell
    return np.concatenate([push, -depth_m * bell[..., None]], axis=-1)


def held(depths_m: tuple[float, ...]) -> list[tuple[Array, Array]]:
    """Forces of the linear pad and of the whole one for a dent of each depth."""
    pad = WholePad(SLAB)
    return [pad.held(dent(depth, depth / 2)) for depth in depths_m]


def test_what_the_linear_pad_leaves_out() -> None:
    beyond, depths_m = finite_strain(SLAB, (21, 25), EXACT), (0.05e-3, 0.1e-3, 0.2e-3)
    for depth, (linear, true) in zip(depths_m, kept(held, depths_m), strict=True):
        left = true - linear - beyond.force(dent(depth, depth / 2))
        # Three layers of one point each leave a fifth; the third order is small beside that.
        assert np.linalg.norm(left) < 0.25 * np.linalg.norm(true - linear)


def test_it_is_quadratic() -> None:
    beyond = finite_strain(SLAB, (21, 25))
    u = dent(0.3e-3, 0.1e-3)
    np.testing.assert_allclose(beyond.force(-2 * u), 4 * beyond.force(u), rtol=1e-9, atol=1e-12)


def test_each_weight_scales_its_term() -> None:
    """The force is a sum of terms; the exact second order has each once."""
    n, u = len(LAYERS), dent(0.3e-3, 0.1e-3)
    terms = [
        finite_strain(SLAB, (21, 25), Weights(*(tuple(row) for row in one.reshape(3, n)))).force(u)
        for one in np.eye(3 * n)
    ]
    assert all(np.abs(term).max() > 0 for term in terms)
    np.testing.assert_allclose(sum(terms), finite_strain(SLAB, (21, 25), EXACT).force(u), rtol=1e-9, atol=1e-12)
    factors = np.linspace(0.5, 2, 3 * n)
    weights = Weights(*(tuple(row) for row in factors.reshape(3, n)))
    together = np.tensordot(factors, terms, 1)
    np.testing.assert_allclose(finite_strain(SLAB, (21, 25), weights).force(u), together, rtol=1e-9, atol=1e-12)


def test_weights_are_kept_to_pads_like_the_one_of_their_fit() -> None:
    slab = Slab(20e-3, 16e-3, 4e-3, 31, 25, 6, 2e5, 0.48)
    for close in (slab, replace(slab, thickness_m=4.2e-3), replace(slab, poisson=0.49)):
        np.testing.assert_allclose(astuple(fitted_weights(close)), astuple(FITTED))
    for other in (replace(slab, thickness_m=3e-3), replace(slab, poisson=0.44), replace(slab, thickness_m=5e-3)):
        assert fitted_weights(other) == EXACT
    between = np.array(astuple(fitted_weights(replace(slab, thickness_m=3.5e-3))))
    ends = np.array(astuple(FITTED)), np.array(astuple(EXACT))
    assert ((between - ends[0]) * (between - ends[1]) < 0).all()


def test_a_mirrored_touch_gives_the_mirrored_force() -> None:
    beyond = finite_strain(SLAB, (21, 25))
    u = dent(0.3e-3, 0.1e-3)
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(beyond.force(u[:, ::-1] * flip), beyond.force(u)[:, ::-1] * flip, atol=1e-12)


@pytest.mark.parametrize("poisson", [0.0, 0.4999])
def test_any_poissons_ratio(poisson: float) -> None:
    slab = Slab(12e-3, 10e-3, 2.4e-3, 25, 21, 6, 2e5, poisson)
    force = finite_strain(slab, (21, 25)).force(dent(0.2e-3, 0.1e-3))
    assert np.isfinite(force).all()
    assert 0 < np.abs(force).max() < 0.05  # newtons: a nearly incompressible pad presses back no wilder


def test_more_nodes_than_the_boards_sums_hold_are_refused() -> None:
    slab = Slab(64e-3, 10e-3, 2.4e-3, MAX_NODES + 1, 5, 2, 2e5, 0.48)
    with pytest.raises(InputError, match=r"finite strain: 64 x 5 nodes need .* coarser"):
        finite_strain(slab, (5, MAX_NODES + 1))
