"""The twin's pad against a direct solution, theory, and its own invariants."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from kept import kept

import ruffini.sim
from ruffini.sim.pad import PadModel, element_stiffness, surface_compliance
from ruffini.sim.surface import hat_areas, hat_shares, on_grid, wrench_of

STEP_M = (0.7e-3, 0.5e-3, 0.6e-3)
SMALL = PadModel(6e-3, 4e-3, 3e-3, 2e5, 0.48, n_cells_x=3, n_cells_y=2, layers=(0.4, 0.6))


def grid_of(n_z, n_y, n_x):
    z, y, x = np.meshgrid(np.arange(n_z), np.arange(n_y), np.arange(n_x), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def test_element_has_six_rigid_modes():
    stiffness = element_stiffness(STEP_M, 2e5, 0.48)
    values = np.linalg.eigvalsh(stiffness)
    assert np.abs(values[:6]).max() < 1e-10 * values[-1]
    assert values[6] > 1e-5 * values[-1]


def test_patch_test_of_the_element():
    """A constant strain loads each face with its stress times its area, and the middle with nothing."""
    rng = np.random.default_rng(1)
    gradient = rng.normal(size=(3, 3))
    place = (grid_of(3, 3, 3) - 1) * np.array(STEP_M) / 2
    force = (element_stiffness(STEP_M, 2e5, 0.4) @ (place @ gradient.T).ravel()).reshape(27, 3)
    strain = (gradient + gradient.T) / 2
    stress = 2e5 * 0.4 / (1.4 * 0.2) * np.trace(strain) * np.eye(3) + 2e5 / 1.4 * strain
    scale = np.abs(force).max()
    np.testing.assert_allclose(force[13], 0, atol=1e-12 * scale)  # the middle node
    areas = np.array([STEP_M[1] * STEP_M[2], STEP_M[0] * STEP_M[2], STEP_M[0] * STEP_M[1]])
    # Moments of the nodal forces are the stress times the volume (virtual work of a linear field).
    np.testing.assert_allclose(force.T @ place, stress * np.prod(STEP_M), rtol=1e-10, atol=1e-12 * scale)
    for axis in range(3):  # the middle of a face carries 4/9 of it (Simpson's weights)
        middle = np.flatnonzero((np.delete(place, axis, 1) == 0).all(1) & (place[:, axis] > 0))
        np.testing.assert_allclose(
            force[middle[0]], 4 / 9 * areas[axis] * stress[:, axis], rtol=1e-9, atol=1e-9 * scale
        )


def direct_compliance(model):
    """Surface compliance from the whole sparse system, assembled element by element."""
    n_y, n_x = model.shape
    n_z = 2 * len(model.layers) + 1
    number = np.arange(n_z * n_y * n_x).reshape(n_z, n_y, n_x)
    total = sp.lil_matrix((3 * number.size, 3 * number.size))
    for k, part in enumerate(reversed(model.layers)):
        step = (model.size_x_m / model.n_cells_x, model.size_y_m / model.n_cells_y, part * model.thickness_m)
        element = element_stiffness(step, model.modulus_pa, model.poisson)
        for j in range(model.n_cells_y):
            for i in range(model.n_cells_x):
                nodes = number[2 * k : 2 * k + 3, 2 * j : 2 * j + 3, 2 * i : 2 * i + 3].ravel()
                dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
                total[np.ix_(dofs, dofs)] += element
    free = np.arange(3 * n_y * n_x, 3 * number.size)
    surface = np.arange(3 * number.size - 3 * n_y * n_x, 3 * number.size) - free[0]
    load = np.zeros((len(free), len(surface)))
    load[surface, np.arange(len(surface))] = 1
    return sla.spsolve(total.tocsc()[free][:, free], load)[surface]


def test_elimination_equals_a_direct_solution():
    ours, direct = surface_compliance(SMALL), direct_compliance(SMALL)
    assert np.abs(ours - direct).max() < 1e-10 * np.abs(direct).max()


def test_compliance_is_symmetric_and_positive():
    compliance = surface_compliance(SMALL)
    assert np.abs(compliance - compliance.T).max() < 1e-12 * np.abs(compliance).max()
    assert np.linalg.eigvalsh(compliance).min() > 0


def pressed_square(model, half_cells, pressure_pa):
    """Uniform pressure on a centred square of 2 half_cells elements a side: u_z at its centre, work done."""
    n_y, n_x = model.shape
    line = np.array([1.0, 4.0, 1.0]) / 6

    def weights(n_nodes, n_cells):
        out = np.zeros(n_nodes)
        for cell in range(n_cells // 2 - half_cells, n_cells // 2 + half_cells):
            out[2 * cell : 2 * cell + 3] += line
        return out

    area = model.size_x_m / model.n_cells_x * model.size_y_m / model.n_cells_y
    force = np.zeros((n_y, n_x, 3))
    force[:, :, 2] = -pressure_pa * area * np.outer(weights(n_y, model.n_cells_y), weights(n_x, model.n_cells_x))
    u = (surface_compliance(model) @ force.ravel()).reshape(n_y, n_x, 3)
    return u[n_y // 2, n_x // 2, 2], (force * u).sum()


def test_deep_pad_follows_boussinesq():
    model = PadModel(30e-3, 30e-3, 30e-3, 2e5, 0.3, 12, 12, layers=(0.06, 0.14, 0.3, 0.5))
    half_m = 2.5e-3
    exact = -4 / np.pi * np.log(1 + np.sqrt(2)) * 2 * 1e3 * half_m * (1 - 0.3**2) / 2e5
    # The bonded bottom and the end of the pad at 12 half widths make it stiffer by a few per cent.
    assert 0.93 < pressed_square(model, 1, 1e3)[0] / exact < 1.0


def test_thin_pad_is_a_confined_layer():
    model = PadModel(20e-3, 20e-3, 0.5e-3, 2e5, 0.3, 20, 20, layers=(0.5, 0.5))
    confined_pa = 2e5 * 0.7 / (1.3 * 0.4)
    assert kept(pressed_square, model, 8, 1e3)[0] == pytest.approx(-1e3 / confined_pa * 0.5e-3, rel=0.005)


def test_work_converges_from_below():
    """Displacement elements are too stiff: under a fixed load the work grows towards its limit."""
    coarse = replace(SMALL, size_y_m=6e-3, n_cells_x=4, n_cells_y=4, layers=(0.3, 0.7))
    work = []
    for factor in (1, 2, 3):
        layers = tuple(part / factor for part in coarse.layers for _ in range(factor))
        model = replace(coarse, n_cells_x=4 * factor, n_cells_y=4 * factor, layers=layers)
        work.append(kept(pressed_square, model, factor, 1e3)[1])
    assert 0 < work[2] - work[1] < 0.3 * (work[1] - work[0])
    assert work[1] - work[0] < 0.06 * work[2]


def test_hats_keep_force_and_moments_on_every_grid():
    hat_force = np.random.default_rng(3).normal(size=(SMALL.shape[0] * SMALL.shape[1], 3))
    expected = wrench_of(SMALL, hat_shares(SMALL) @ hat_force)
    n_x, n_y = 9, 4
    x = np.linspace(-SMALL.size_x_m / 2, SMALL.size_x_m / 2, n_x)
    y = np.linspace(-SMALL.size_y_m / 2, SMALL.size_y_m / 2, n_y)
    arm = np.stack([*np.meshgrid(x, y), np.zeros((n_y, n_x))], axis=-1)
    other = on_grid(SMALL, hat_force, n_x, n_y)
    got = np.concatenate([other.sum((0, 1)), np.cross(arm, other).sum((0, 1))])
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_uniform_traction_is_uniform_on_another_grid():
    hat_force = np.outer(hat_areas(SMALL), [1.0, 2.0, -3.0])
    other = on_grid(SMALL, hat_force, 5, 3)
    np.testing.assert_allclose(other[1, 1:-1], np.tile(np.array([1, 2, -3]) * 1.5e-3 * 2e-3, (3, 1)), rtol=1e-12)


def test_twin_knows_nothing_of_the_estimators():
    forbidden = ("ruffini.fem", "ruffini.core", "ruffini.calibrate")
    for path in Path(ruffini.sim.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.startswith(forbidden)], path
