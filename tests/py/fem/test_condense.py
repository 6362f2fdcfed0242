"""The condensed slab against a direct solution, theory, and its own invariants."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from kept import kept

from ruffini.errors import InputError
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.slab import CORNERS, Slab, assemble_layer, hexahedron_stiffness
from ruffini.reflection import blocks_from_dense, dense_from_blocks, parity_bases

STEP_M = (0.7e-3, 0.5e-3, 0.6e-3)


def small_slab(**changes: float) -> Slab:
    settings = {
        "size_x_m": 6e-3,
        "size_y_m": 4e-3,
        "thickness_m": 3e-3,
        "n_x": 7,
        "n_y": 4,
        "n_layers": 3,
        "modulus_pa": 2e5,
        "poisson": 0.48,
    }
    return Slab(**{**settings, **changes})


def full_surface_stiffness(slab: Slab) -> np.ndarray:
    """Schur complement of the whole sparse system, without any of the tricks."""
    layer, n = assemble_layer(slab), 3 * slab.n_nodes
    blocks = [[None] * slab.n_layers for _ in range(slab.n_layers)]
    for plane in range(slab.n_layers):
        blocks[plane][plane] = layer.upper + (layer.lower if plane else 0 * layer.lower)
        if plane + 1 < slab.n_layers:
            blocks[plane][plane + 1] = layer.coupling
            blocks[plane + 1][plane] = layer.coupling.T
    whole = sp.bmat(blocks, format="csc")
    inner = sla.spsolve(whole[n:, n:], whole[n:, :n].toarray())
    return whole[:n, :n].toarray() - whole[:n, n:] @ inner


@pytest.mark.parametrize(("n_x", "n_y", "n_layers"), [(7, 4, 3), (6, 5, 2), (5, 5, 5)])
def test_condensed_equals_full(n_x, n_y, n_layers):
    slab = small_slab(n_x=n_x, n_y=n_y, n_layers=n_layers)
    condensed = condense(slab)
    ours = dense_from_blocks(condensed.bases, surface_stiffness(condensed))
    reference = full_surface_stiffness(slab)
    assert np.abs(ours - reference).max() < 1e-11 * np.abs(reference).max()


def test_patch_test_of_the_element():
    """Any constant strain gives that strain's nodal forces, exactly (also with B-bar)."""
    rng = np.random.default_rng(1)
    gradient = rng.normal(size=(3, 3))
    position = CORNERS * np.array(STEP_M) / 2
    force = hexahedron_stiffness(STEP_M, 2e5, 0.4) @ (position @ gradient.T).ravel()
    strain = (gradient + gradient.T) / 2
    lame, shear = 2e5 * 0.4 / (1.4 * 0.2), 2e5 / 2.8
    stress = lame * np.trace(strain) * np.eye(3) + 2 * shear * strain
    areas = np.array([STEP_M[1] * STEP_M[2], STEP_M[0] * STEP_M[2], STEP_M[0] * STEP_M[1]])
    expected = (CORNERS * areas / 4) @ stress
    np.testing.assert_allclose(force.reshape(8, 3), expected, rtol=1e-10, atol=1e-9)


def test_rigid_motions_cost_nothing_and_nothing_else_does():
    values = np.linalg.eigvalsh(hexahedron_stiffness(STEP_M, 2e5, 0.48))
    assert (np.abs(values[:6]) < 1e-9 * values[-1]).all()
    assert values[6] > 1e-4 * values[-1]


def test_parity_classes_are_an_orthonormal_basis():
    q = sp.hstack(parity_bases(5, 4)).toarray()
    np.testing.assert_allclose(q.T @ q, np.eye(60), atol=1e-14)


def test_blocks_and_dense_are_inverse():
    condensed = condense(small_slab())
    blocks = surface_stiffness(condensed)
    again = blocks_from_dense(condensed.bases, dense_from_blocks(condensed.bases, blocks))
    for a, b in zip(blocks, again, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9 * np.abs(a).max())


def uniform_compression_stiffness(slab: Slab) -> float:
    """Normal force per uniform normal displacement of the whole surface, newton per metre."""
    condensed = condense(slab)
    stiffness = dense_from_blocks(condensed.bases, surface_stiffness(condensed))
    down = np.zeros((slab.n_nodes, 3))
    down[:, 2] = 1.0
    return float(down.ravel() @ stiffness @ down.ravel())


def test_bonded_thin_layer():
    """A wide thin layer bonded on both faces has the oedometric modulus away from its edge."""
    slab = small_slab(size_x_m=80e-3, size_y_m=80e-3, thickness_m=1e-3, n_x=41, n_y=41, poisson=0.4)
    oedometric = 2e5 * 0.6 / (1.4 * 0.2)
    expected = oedometric * 80e-3 * 80e-3 / 1e-3
    assert kept(uniform_compression_stiffness, slab) == pytest.approx(expected, rel=0.02)


def test_no_volumetric_locking():
    """Near nu = 0.5 the plain element is far too stiff where gel must flow aside; B-bar is not."""
    slab = small_slab(size_x_m=10e-3, size_y_m=10e-3, n_x=13, n_y=13, n_layers=6, poisson=0.4999)
    soft = dense_from_blocks((c := condense(slab)).bases, surface_stiffness(c))
    hard = dense_from_blocks((c := condense(slab, b_bar=False)).bases, surface_stiffness(c))
    bump = np.zeros((13, 13, 3))
    bump[4:9, 4:9, 2] = 1.0
    ratio = (bump.ravel() @ hard @ bump.ravel()) / (bump.ravel() @ soft @ bump.ravel())
    assert ratio > 2.0


def test_convergence_with_refinement():
    """The compliance of a smooth load converges at second order in the mesh size."""

    def mean_settlement(n: int) -> float:
        slab = Slab(8e-3, 8e-3, 4e-3, 2 * n + 1, 2 * n + 1, n, 2e5, 0.45)
        condensed = condense(slab)
        x = np.linspace(-1, 1, 2 * n + 1)
        pressure = np.zeros((2 * n + 1, 2 * n + 1, 3))
        weight = np.ones(2 * n + 1)
        weight[[0, -1]] = 0.5
        pressure[:, :, 2] = np.outer(weight * np.cos(x * np.pi / 2) ** 2, weight * np.cos(x * np.pi / 2) ** 2) / n**2
        load = pressure.ravel()
        stiffness = dense_from_blocks(condensed.bases, surface_stiffness(condensed))
        return float(load @ np.linalg.solve(stiffness, load))

    coarse, middle, fine = (mean_settlement(n) for n in (3, 6, 12))
    rate = np.log2(abs(coarse - middle) / abs(middle - fine))
    assert 1.3 < rate < 3.0


@pytest.mark.parametrize(
    "changes",
    [
        {"poisson": 0.5},
        {"poisson": 0.49999},
        {"poisson": float("nan")},
        {"poisson": -0.1},
        {"thickness_m": 0.0},
        {"n_x": 1},
        {"n_layers": 1},
        {"modulus_pa": float("nan")},
    ],
)
def test_impossible_pads_are_refused(changes):
    with pytest.raises(InputError):
        small_slab(**changes)


@pytest.mark.parametrize("changes", [{"thickness_m": 3e6}, {"size_y_m": 4e-12}])
def test_a_degenerate_mesh_is_refused_in_one_sentence(changes):
    """Elements a million times longer than wide: no digits of the stiffness are left."""
    with pytest.raises(InputError, match=r"finite elements of this pad are singular .* change \[grid\] or \[pad\]"):
        surface_stiffness(condense(small_slab(poisson=0.4999, **changes)))
