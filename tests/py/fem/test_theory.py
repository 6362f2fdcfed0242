"""The condensed slab against closed forms, each written down here: deep pads, thin layers, rigid motion, symmetry."""

import numpy as np
import pytest
import scipy.sparse as sp

from ruffini.fem.condense import CondensedSlab, condense, surface_stiffness
from ruffini.fem.operators import METHODS, ForcePrior, Noise, force_operator
from ruffini.fem.slab import Slab, assemble_layer
from ruffini.reflection import dense_from_blocks

E = 2e5
MM = 1e-3


def settle(condensed: CondensedSlab, force: np.ndarray) -> np.ndarray:
    """Displacement of the surface, (n_y, n_x, 3) m, under nodal forces of the same shape."""
    u = np.zeros(force.size)
    for q, stiffness in zip(condensed.bases, surface_stiffness(condensed), strict=True):
        u += q @ np.linalg.solve(stiffness, q.T @ force.ravel())
    return u.reshape(force.shape)


# ---- deep pads ----------------------------------------------------------------------------------

DEEP_NU = 0.3
DEEP_N = 25  # nodes a side
MIDDLE = DEEP_N // 2


@pytest.fixture(scope="module")
def deep() -> CondensedSlab:
    """24 mm cube of soft rubber; loads stay near its centre."""
    return condense(Slab(24 * MM, 24 * MM, 24 * MM, DEEP_N, DEEP_N, 16, E, DEEP_NU))


def half_space(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Displacement at (x, y) on an elastic half space by a unit force at the origin, (3 of u, 3 of F, ...).

    z out of the body; G the shear modulus (Johnson 1985, 3.2 and 3.6):
    normal: u_z = (1 - nu) F / (2 pi G r), u_r = (1 - 2 nu) F / (4 pi G r), outwards under a pull;
    tangential: u_x = F / (2 pi G r) (1 - nu + nu x^2 / r^2), u_y = F nu x y / (2 pi G r^3),
    u_z = -(1 - 2 nu) F x / (4 pi G r^2) (reciprocal to u_r).
    """
    r, nu = np.hypot(x, y), DEEP_NU
    side = (1 - 2 * nu) / (2 * r)
    u = np.array([
        [1 - nu + nu * x**2 / r**2, nu * x * y / r**2, side * x],
        [nu * x * y / r**2, 1 - nu + nu * y**2 / r**2, side * y],
        [-side * x, -side * y, (1 - nu) * np.ones_like(r)],
    ])  # fmt: skip
    return u / (2 * np.pi * E / (2 * (1 + nu)) * r)


@pytest.mark.parametrize("axis", [0, 2])
def test_forces_follow_boussinesq_and_cerruti(deep: CondensedSlab, axis: int) -> None:
    """Nine forces close together, each as on a half space. Differences: far walls shift all places near alike.

    A force along x also makes the block lean, so u_z is judged under the normal force only.
    """
    step = deep.slab.step_m[0]
    force = np.zeros((DEEP_N, DEEP_N, 3))
    near = np.arange(-1, 2)
    share = np.outer([1, 2, 1], [1, 2, 1]) / 16
    force[MIDDLE - 1 : MIDDLE + 2, MIDDLE - 1 : MIDDLE + 2, axis] = share
    u = settle(deep, force)
    for there_x, there_y in ((np.arange(3, 6), np.zeros(3, int)), (np.zeros(3, int), np.arange(3, 6))):
        x = (there_x[:, None, None] - near[None, None, :]) * step + np.zeros((1, 3, 1))
        y = (there_y[:, None, None] - near[None, :, None]) * step + np.zeros((1, 1, 3))
        theory = (half_space(x, y)[:, axis] * share).sum(axis=(-2, -1)).T
        measured = u[MIDDLE + there_y, MIDDLE + there_x]
        if axis != 2:
            measured, theory = measured[:, :2], theory[:, :2]
        largest = np.abs(np.diff(theory, axis=0)).max()
        np.testing.assert_allclose(np.diff(measured, axis=0), np.diff(theory, axis=0), atol=0.08 * largest)


def test_hertz_pressure_makes_the_balls_own_shape(deep: CondensedSlab) -> None:
    """p = p_0 sqrt(1 - r^2/a^2) with p_0 = 2 a E* / (pi R) presses r^2 / (2 R) into the contact (Hertz 1882).

    What the pad's finite size cannot change much: the shape, and the force 4 E* a^3 / (3 R) behind it.
    """
    radius, a = 12 * MM, 3.3 * MM
    e_star = E / (1 - DEEP_NU**2)
    step, fine = deep.slab.step_m[0], 8
    # Squares of 1/8 of the node step; each gives its pressure to the four nodes around it, bilinearly.
    x = (np.arange((DEEP_N - 1) * fine) + 0.5) * step / fine - deep.slab.size_x_m / 2
    r2 = x[None, :] ** 2 + x[:, None] ** 2
    pressure = 2 * a * e_star / (np.pi * radius) * np.sqrt(np.clip(1 - r2 / a**2, 0, None)) * (step / fine) ** 2
    to_node = np.clip(1 - np.abs(x[None, :] / step - (np.arange(DEEP_N) - MIDDLE)[:, None]), 0, None)
    force = np.zeros((DEEP_N, DEEP_N, 3))
    force[..., 2] = -to_node @ pressure @ to_node.T
    assert -force.sum() == pytest.approx(4 * e_star * a**3 / (3 * radius), rel=5e-3)
    u_z = settle(deep, force)[MIDDLE, :, 2]
    place = (np.arange(DEEP_N) - MIDDLE) * step
    inside = np.abs(place) < 0.95 * a
    np.testing.assert_allclose(
        u_z[inside] - u_z[MIDDLE], place[inside] ** 2 / (2 * radius), atol=0.02 * a**2 / (2 * radius)
    )


# ---- thin layers --------------------------------------------------------------------------------


def bonded_layer_force(poisson: float, size_m: float, thickness_m: float) -> float:
    """Force per unit approach of two rigid plates on a thin nearly incompressible square layer bonded to both.

    The rubber flows aside as a film does: p'' - k^2 p = -12 G d / h^3 with k^2 = 12 G / (K h^2), p = 0 at the free
    edges (Gent and Lindley 1959; K the bulk modulus), summed as a double sine series; the force is the pressure's
    plus that of plain compression, E d / h.
    """
    shear, bulk = E / (2 * (1 + poisson)), E / (3 * (1 - 2 * poisson))
    k2 = 12 * shear / (bulk * thickness_m**2)
    m = np.arange(1, 400, 2) * np.pi / size_m
    flow = (64 / size_m**2 / np.outer(m, m) ** 2 / (m[:, None] ** 2 + m[None, :] ** 2 + k2)).sum()
    return float(12 * shear / thickness_m**3 * flow + E * size_m**2 / thickness_m)


@pytest.mark.parametrize("poisson", [0.49, 0.499, 0.4999])
def test_no_locking_in_a_bonded_thin_layer(poisson: float) -> None:
    """The case that locks worst, against theory, up to nu 0.4999."""
    slab = Slab(12 * MM, 12 * MM, 1 * MM, 25, 25, 5, E, poisson)
    condensed = condense(slab)
    down = np.tile([0.0, 0.0, 1.0], slab.n_nodes)
    blocks = zip(condensed.bases, surface_stiffness(condensed), strict=True)
    measured = sum(float((q.T @ down) @ stiffness @ (q.T @ down)) for q, stiffness in blocks)
    assert measured == pytest.approx(bonded_layer_force(poisson, 12 * MM, 1 * MM), rel=0.06)


# ---- rigid motion, patch test, symmetry ---------------------------------------------------------

SMALL = Slab(6 * MM, 4 * MM, 3 * MM, 7, 4, 3, E, 0.48)


def whole_stiffness(slab: Slab) -> tuple[sp.csr_matrix, np.ndarray]:
    """The free slab, nothing bonded, and the places of its nodes, plane by plane from the surface."""
    layer = assemble_layer(slab)
    n_planes = slab.n_layers + 1
    blocks: list[list[sp.csr_matrix | None]] = [[None] * n_planes for _ in range(n_planes)]
    for k in range(n_planes):
        own = sp.csr_matrix((3 * slab.n_nodes,) * 2)
        own = own + (layer.upper if k < n_planes - 1 else 0 * layer.upper) + (layer.lower if k else 0 * layer.lower)
        blocks[k][k] = own
        if k:
            blocks[k - 1][k], blocks[k][k - 1] = layer.coupling, layer.coupling.T
    z, y, x = np.meshgrid(
        -np.arange(n_planes) * slab.step_m[2],
        np.arange(slab.n_y) * slab.step_m[1],
        np.arange(slab.n_x) * slab.step_m[0],
        indexing="ij",
    )
    return sp.bmat(blocks, format="csr"), np.stack([x, y, z], axis=-1).reshape(-1, 3)


def test_a_free_slab_resists_no_rigid_motion_and_everything_else() -> None:
    stiffness, place = whole_stiffness(SMALL)
    values = np.linalg.eigvalsh(stiffness.toarray())
    assert (np.abs(values[:6]) < 1e-10 * values[-1]).all()
    assert values[6] > 1e-7 * values[-1]
    turn = np.array([[0.0, -1.0, 2.0], [1.0, 0.0, -3.0], [-2.0, 3.0, 0.0]])
    motion = place @ turn.T + np.array([0.1, -0.2, 0.3])
    assert np.abs(stiffness @ motion.ravel()).max() < 1e-10 * np.abs(stiffness).max() * np.abs(motion).max()


def test_a_constant_strain_loads_no_inner_node_of_the_slab() -> None:
    """And its work is the energy density of that strain times the volume."""
    stiffness, place = whole_stiffness(SMALL)
    gradient = np.random.default_rng(4).normal(size=(3, 3)) * 1e-2
    u = place @ gradient.T
    force = (stiffness @ u.ravel()).reshape(-1, 3)
    low, high = place.min(axis=0), place.max(axis=0)
    inner = ((place > low + 1e-9) & (place < high - 1e-9)).all(axis=1)
    assert inner.sum() == 5 * 2 * 2
    assert np.abs(force[inner]).max() < 1e-10 * np.abs(force).max()
    strain = (gradient + gradient.T) / 2
    lame, shear = E * 0.48 / (1.48 * 0.04), E / 2.96
    energy = lame / 2 * np.trace(strain) ** 2 + shear * (strain**2).sum()
    assert (force * u).sum() / 2 == pytest.approx(energy * 6 * 4 * 3 * MM**3, rel=1e-10)


def test_surface_stiffness_is_symmetric_and_positive() -> None:
    condensed = condense(SMALL)
    stiffness = dense_from_blocks(condensed.bases, surface_stiffness(condensed))
    assert np.abs(stiffness - stiffness.T).max() < 1e-12 * np.abs(stiffness).max()
    assert np.linalg.eigvalsh(stiffness).min() > 0


@pytest.mark.parametrize("method", METHODS)
def test_a_mirrored_displacement_gives_the_mirrored_force(method: str) -> None:
    operator = force_operator(SMALL, method, noise=Noise((5e-6, 5e-6, 2e-5), 1e-4, 1e-4), prior=ForcePrior())
    u = np.random.default_rng(5).normal(size=(4, 7, 3)) * 1e-5
    force = (operator @ u.ravel()).reshape(4, 7, 3)
    for flip, sign in ((np.s_[:, ::-1], [-1, 1, 1]), (np.s_[::-1], [1, -1, 1])):
        mirrored = (operator @ (u[flip] * sign).ravel()).reshape(4, 7, 3)
        np.testing.assert_allclose(mirrored, force[flip] * sign, atol=1e-10 * np.abs(force).max())
