"""The condensed slab against scikit-fem: another element (Taylor-Hood, 27 nodes), another assembly, another solver."""

import functools

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from skfem.helpers import ddot, div, dot, sym_grad

from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.slab import Slab

SIZE_M, THICKNESS_M, E = 8e-3, 4e-3, 2e5
CELLS = 6  # of the oracle, a side


def traction_pa(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    """A smooth push with shear, a little off the centre, (3, ...)."""
    bump = np.exp(-((x_m - 4.3e-3) ** 2 + (y_m - 3.8e-3) ** 2) / 2e-3**2)
    return np.stack([3e3 * bump, -2e3 * bump, -1e4 * bump])


@functools.cache
def oracle(poisson: float) -> tuple[float, np.ndarray]:
    """Work of the traction, J, and displacement of the mesh's corners on the surface, (CELLS + 1, CELLS + 1, 3) m.

    Mixed form with the pressure as an unknown: cannot lock.
    """
    side = np.linspace(0, SIZE_M, CELLS + 1)
    depth = THICKNESS_M * np.array([0, 0.35, 0.65, 0.85, 1.0])
    mesh = skfem.MeshHex.init_tensor(side, side, depth).with_boundaries(
        {"bottom": lambda p: p[2] < 1e-9, "top": lambda p: p[2] > THICKNESS_M - 1e-9}
    )
    element = skfem.ElementVector(skfem.ElementHex2())
    basis = skfem.Basis(mesh, element, intorder=4)
    pressure = skfem.Basis(mesh, skfem.ElementHex1(), intorder=4)
    shear, lame = E / (2 * (1 + poisson)), E * poisson / ((1 + poisson) * (1 - 2 * poisson))
    a = skfem.BilinearForm(lambda u, v, _: 2 * shear * ddot(sym_grad(u), sym_grad(v))).assemble(basis)
    b = skfem.BilinearForm(lambda u, q, _: -div(u) * q).assemble(basis, pressure)
    c = skfem.BilinearForm(lambda p, q, _: -p * q / lame).assemble(pressure)
    top = skfem.FacetBasis(mesh, element, facets="top", intorder=6)
    load = skfem.LinearForm(lambda v, w: dot(v, traction_pa(w.x[0], w.x[1]))).assemble(top)
    system = sp.bmat([[a, b.T], [b, c]], format="csr")
    right = np.concatenate([load, np.zeros(pressure.N)])
    u = skfem.solve(*skfem.condense(system, right, D=basis.get_dofs("bottom").all()))[: basis.N]
    at_corner = {tuple(np.round(p / side[1]).astype(int)): u[basis.nodal_dofs[:, i]] for i, p in enumerate(mesh.p.T)
                 if p[2] > THICKNESS_M - 1e-9}  # fmt: skip
    surface = np.array([[at_corner[i, j, round(THICKNESS_M / side[1])] for i in range(CELLS + 1)]
                        for j in range(CELLS + 1)])  # fmt: skip
    return float(load @ u), surface


@functools.cache
def ours(poisson: float, refinement: int) -> tuple[float, np.ndarray]:
    """The same of the board's model, `refinement` element edges on one of the oracle's."""
    n = CELLS * refinement + 1
    slab = Slab(SIZE_M, SIZE_M, THICKNESS_M, n, n, 3 * refinement, E, poisson)
    points, weights = np.polynomial.legendre.leggauss(4)
    force, h = np.zeros((n, n, 3)), slab.step_m[0]
    for s, w_x in zip((points + 1) / 2, weights, strict=True):
        for r, w_y in zip((points + 1) / 2, weights, strict=True):
            x, y = np.meshgrid((np.arange(n - 1) + s) * h, (np.arange(n - 1) + r) * h)
            share = np.moveaxis(traction_pa(x, y), 0, -1) * (w_x * w_y * h * h / 4)
            for dy, part_y in ((0, 1 - r), (1, r)):
                for dx, part_x in ((0, 1 - s), (1, s)):
                    force[dy : n - 1 + dy, dx : n - 1 + dx] += share * (part_x * part_y)
    u = np.zeros(3 * n * n)
    condensed = condense(slab)
    for q, stiffness in zip(condensed.bases, surface_stiffness(condensed), strict=True):
        u += q @ np.linalg.solve(stiffness, q.T @ force.ravel())
    field = u.reshape(n, n, 3)
    return float((force * field).sum()), field[::refinement, ::refinement]


@pytest.mark.parametrize("poisson", [0.48, 0.4999])
def test_agrees_with_scikit_fem(poisson: float) -> None:
    work, surface = oracle(poisson)
    mine, field = ours(poisson, 4)
    assert mine == pytest.approx(work, rel=0.006)
    assert np.linalg.norm(field - surface) < 0.015 * np.linalg.norm(surface)


def test_converges_near_incompressibility_to_what_scikit_fem_says() -> None:
    """Finer elements give more work, from below, at nu 0.4999 as anywhere: no locking."""
    works = [ours(0.4999, refinement)[0] for refinement in (1, 2, 4)]
    rate = np.log2((works[1] - works[0]) / (works[2] - works[1]))
    assert 1.2 < rate < 2.5
    limit = works[2] + (works[2] - works[1]) / (2**rate - 1)  # Richardson
    assert limit == pytest.approx(oracle(0.4999)[0], rel=0.005)
