"""The paper's inverse FEM against what is known without it."""

import numpy as np
import pytest
from papers.gelslim.method import InverseFem, Slab, hexahedron


def test_a_brick_moved_or_turned_rigidly_has_no_force():
    step = np.array([1.0, 2.0, 0.5])
    stiffness = hexahedron(step, 1.0, 0.3)
    corners = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * step / 2
    for motion in [*np.eye(3), *(np.cross(axis, corners) for axis in np.eye(3))]:
        assert np.abs(stiffness @ np.broadcast_to(motion, (8, 3)).ravel()).max() < 1e-12
    assert np.linalg.eigvalsh(stiffness)[6] > 1e-3


def test_a_brick_stretched_evenly_has_hookes_stress():
    step = np.array([1.0, 2.0, 0.5])
    modulus, poisson = 3.0, 0.25
    corners = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * step / 2
    strain = np.array([-poisson, -poisson, 1.0]) * 1e-3  # uniaxial stress along z
    force = (hexahedron(step, modulus, poisson) @ (corners * strain).ravel()).reshape(8, 3)
    assert force[4:, 2].sum() == pytest.approx(modulus * 1e-3 * step[0] * step[1])
    assert np.abs(force[:, :2]).max() < 1e-15


def test_a_layer_pushed_down_evenly_without_poisson_effect_is_a_spring():
    slab = Slab((4e-3, 3e-3, 2e-3), 2e5, 0.0, 5, 4, 4)
    fem = InverseFem.of(slab)
    down = np.tile([0.0, 0.0, -1e-4], 20)
    for matrix in (fem.raw(), fem.ridge((0.0,))[0]):
        total = (matrix @ down).reshape(20, 3).sum(axis=0)
        assert total == pytest.approx([0, 0, -2e5 * 4e-3 * 3e-3 * 1e-4 / 2e-3], rel=1e-9, abs=1e-12)


def test_condensing_more_layers_changes_nothing_where_the_field_is_linear():
    thin, thick = (InverseFem.of(Slab((4e-3, 3e-3, 2e-3), 2e5, 0.0, 5, 4, n)).raw() for n in (2, 6))
    shear = np.tile([1e-4, 0.0, 0.0], 20)
    # Simple shear of the middle: G A u / h less what the free sides give way, the same for both in sum of z.
    assert (thin @ shear).reshape(20, 3).sum(axis=0)[2] == pytest.approx(0, abs=1e-9)
    assert (thick @ shear).reshape(20, 3).sum(axis=0)[0] < 1e5 * 4e-3 * 3e-3 * 1e-4 / 2e-3
    assert (thick @ shear).reshape(20, 3).sum(axis=0)[0] < (thin @ shear).reshape(20, 3).sum(axis=0)[0]


def test_a_heavy_ridge_shrinks_the_forces_inside():
    fem = InverseFem.of(Slab((4e-3, 3e-3, 2e-3), 2e5, 0.45, 5, 4, 2))
    light, heavy = fem.ridge((1e-12, 1e6))
    assert light == pytest.approx(fem.raw(), rel=1e-5, abs=1e-4)
    assert heavy == pytest.approx(fem.k11, rel=1e-5, abs=1e-4)  # U2 = 0
