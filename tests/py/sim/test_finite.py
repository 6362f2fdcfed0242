"""The pad at finite strain: closed forms, its own tangent, equilibrium, and the linear pad in the limit."""

import numpy as np
import pytest

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.contact import ContactSolver, Indenter, Pose, advance_together
from ruffini.sim.finite import FiniteMesh
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.response import FiniteResponse, LinearResponse

MM = 1e-3
MODEL = PadModel(8 * MM, 6 * MM, 3 * MM, 2e5, 0.45, n_cells_x=8, n_cells_y=6, layers=(0.4, 0.6))
SHEAR, LAME = 2e5 / 2.9, 2e5 * 0.45 / (1.45 * 0.1)


@pytest.fixture(scope="module")
def mesh():
    return FiniteMesh(MODEL)


def places(model):
    """Undeformed nodes (planes, n, 3)."""
    x, y = np.meshgrid(model.node_x(), model.node_y())
    heights = [0.0]
    for part in reversed(model.layers):
        heights += [heights[-1] + part / 2, heights[-1] + part]
    flat = np.column_stack([x.ravel(), y.ravel()])
    return np.stack([np.column_stack([flat, np.full(len(flat), (z - 1) * model.thickness_m)]) for z in heights])


def energy(f):
    j = np.linalg.det(f)
    return SHEAR / 2 * (np.sum(f * f) - 3) - SHEAR * np.log(j) + LAME / 2 * np.log(j) ** 2


def volume_energy(layer, f):
    """Energy in a layer of elements at deformation gradients (m, 3, points, 3)."""
    j = np.linalg.det(f.transpose(0, 2, 1, 3))
    density = SHEAR / 2 * (np.einsum("miqa,miqa->mq", f, f) - 3) - SHEAR * np.log(j) + LAME / 2 * np.log(j) ** 2
    return float((density * layer.volumes).sum())


def unit(i, k):
    return np.outer(np.eye(3)[i], np.eye(3)[k])


def test_an_even_deformation_has_the_stress_of_its_energy(mesh):
    """Patch test: any even F gives the derivative of W by F, as moments of nodal forces, and no force inside."""
    f = np.eye(3) + 0.25 * np.random.default_rng(1).normal(size=(3, 3))
    place = places(MODEL)
    force = mesh.internal_force(place @ (f - np.eye(3)).T)
    step = 1e-6
    expected = [
        [(energy(f + step * unit(i, k)) - energy(f - step * unit(i, k))) / (2 * step) for k in range(3)]
        for i in range(3)
    ]
    got = np.einsum("pni,pnk->ik", force, place) / (8 * 6 * 3 * MM**3)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * np.max(np.abs(expected)))
    inside = force.reshape(5, *MODEL.shape, 3)[1:-1, 1:-1, 1:-1]
    assert np.abs(inside).max() < 1e-12 * np.abs(force).max()


def test_simple_shear_is_linear_and_needs_no_pressure(mesh):
    """Neo-Hookean: P = mu gamma at any shear, P_zz = 0."""
    place, gamma = places(MODEL), 0.6
    u = np.zeros_like(place)
    u[..., 0] = gamma * (place[..., 2] + MODEL.thickness_m)
    top = mesh.internal_force(u)[-1].sum(axis=0)
    np.testing.assert_allclose(top, [SHEAR * gamma * 8 * 6 * MM**2, 0, 0], atol=1e-9)


def test_confined_compression(mesh):
    """No lateral strain: P_zz = mu (l - 1/l) + lambda ln l / l."""
    place, stretch = places(MODEL), 0.6
    u = np.zeros_like(place)
    u[..., 2] = (stretch - 1) * (place[..., 2] + MODEL.thickness_m)
    expected = SHEAR * (stretch - 1 / stretch) + LAME * np.log(stretch) / stretch
    top = mesh.internal_force(u)[-1].sum(axis=0)
    np.testing.assert_allclose(top[2], expected * 8 * 6 * MM**2, rtol=1e-10)


def some_displacement(rng, size_m):
    u = rng.normal(size=(5, MODEL.shape[0] * MODEL.shape[1], 3)) * size_m
    u[0] = 0
    return u


def test_tangent_is_the_derivative_of_the_forces(mesh):
    rng = np.random.default_rng(2)
    u, change = some_displacement(rng, 0.02 * MM), some_displacement(rng, 1e-9)
    force = (mesh.internal_force(u + change) - mesh.internal_force(u - change)) / 2
    back = mesh.tangent(u).solve(force)
    assert np.abs(back - change).max() < 1e-3 * np.abs(change).max()  # single precision


def test_tangent_at_rest_is_the_linear_pad(mesh):
    compliance, dofs = surface_compliance(MODEL), np.array([0, 300, 331, 662])
    columns = mesh.tangent(mesh.at_rest()).surface_columns(dofs)
    assert np.abs(columns - compliance[dofs]).max() < 1e-4 * np.abs(compliance).max()


PATH = (Pose(0.5 * MM, 0, 0.6 * MM), Pose(0.7 * MM, 0.1 * MM, 0.6 * MM))


@pytest.fixture(scope="module")
def pressed(mesh):
    solver = ContactSolver(MODEL, FiniteResponse(mesh), Indenter("sphere", 3 * MM), 0.6)
    for pose in PATH:
        solver.advance(pose)
    return solver


def test_small_strain_is_the_linear_pad(mesh):
    """A ball pressed 1/300 as deep on a 300 times larger radius has the same contact at 1/300 the strain."""
    solvers = []
    for response in (FiniteResponse(mesh), LinearResponse(surface_compliance(MODEL))):
        solver = ContactSolver(MODEL, response, Indenter("sphere", 300 * 3 * MM), 0.6)
        solver.advance(Pose(0.5 * MM, 0, 0.6 * MM / 300))
        solvers.append(solver)
    finite, linear = (solver.nodal_force for solver in solvers)
    assert np.abs(finite - linear).max() < 5e-3 * np.abs(linear).max()


def test_inside_is_in_equilibrium_and_forces_and_moments_balance(mesh, pressed):
    """What is pressed on the surface arrives at the bonded bottom, moments about where things moved."""
    u = pressed.response.u
    force = pressed.response.internal_force()
    load = pressed.nodal_force
    assert np.abs(force[1:-1]).max() < 2e-4 * np.abs(load).max()
    assert np.abs(force[-1] - load).max() < 2e-4 * np.abs(load).max()
    moved = places(MODEL) + u
    moment = np.cross(moved, force).sum(axis=(0, 1))
    np.testing.assert_allclose(force.sum(axis=(0, 1)), 0, atol=1e-12)
    np.testing.assert_allclose(moment, 0, atol=1e-12)
    np.testing.assert_allclose(pressed.displacement, u[-1], atol=5e-8)


def test_a_deep_press_takes_more_force_than_the_linear_pad_says(pressed):
    linear = ContactSolver(MODEL, surface_compliance(MODEL), Indenter("sphere", 3 * MM), 0.6)
    for pose in PATH:
        linear.advance(pose)
    ratio = pressed.nodal_force.sum(axis=0) / linear.nodal_force.sum(axis=0)
    assert 1.03 < ratio[2] < 1.3
    assert 1.0 < ratio[0] < 1.4


def test_shear_under_a_straight_press_does_not_hang_on_the_increments(mesh, monkeypatch):
    """A point that touches within an increment has not slipped along the ball's side by the way before."""
    found = []
    for step_m in (0.3 * MM, 0.05 * MM):
        monkeypatch.setattr("ruffini.sim.contact.MAX_STEP_M", step_m)
        solver = ContactSolver(MODEL, FiniteResponse(mesh), Indenter("sphere", 3 * MM), 0.7)
        solver.advance(Pose(0, 0, 0.6 * MM))
        found.append((solver.nodal_force[:, :2], solver.displacement[:, :2]))
    (coarse_force, coarse), (fine_force, fine) = found
    assert np.linalg.norm(coarse_force - fine_force) < 0.2 * np.linalg.norm(fine_force)
    assert np.linalg.norm(coarse - fine) < 0.08 * np.linalg.norm(fine)


def test_a_slippery_ball_pushes_towards_its_middle(mesh):
    """Without friction every force lies along the ball's radius where it touches, and the sides push outwards."""
    solver = ContactSolver(MODEL, FiniteResponse(mesh), Indenter("sphere", 3 * MM), 1e-9)
    pose = Pose(0.2 * MM, -0.1 * MM, 0.6 * MM)
    solver.advance(pose)
    place = places(MODEL)[-1] + solver.displacement
    radius = place - [pose.x_m, pose.y_m, 3 * MM - pose.depth_m]
    along = (solver.hat_force * radius).sum(axis=1) / np.linalg.norm(radius, axis=1)
    size = np.linalg.norm(solver.hat_force, axis=1)
    touched = size > 0.05 * size.max()
    assert touched.sum() >= 9
    assert (along[touched] > 0.995 * size[touched]).all()
    outwards = (solver.hat_force[:, :2] * radius[:, :2]).sum(axis=1)
    assert outwards[touched].min() > -1e-12
    sideways = np.linalg.norm(solver.hat_force[touched, :2], axis=1).sum()
    assert 0.1 < sideways / size[touched].sum() < 0.4


def test_a_straight_way_has_the_force_of_the_work_done(mesh):
    """Without friction nothing is lost: the force along the way is the slope of the energy that the gel holds."""
    solver = ContactSolver(MODEL, FiniteResponse(mesh), Indenter("sphere", 3 * MM), 1e-9)
    stored, force = [], []
    for depth in (0.55, 0.6, 0.65):
        solver.advance(Pose(0, 0, depth * MM))
        forms = mesh.deformations(solver.response.u)
        stored.append(sum(volume_energy(layer, f) for layer, f in zip(mesh.layers, forms, strict=True)))
        force.append(-solver.nodal_force[:, 2].sum())
    assert force[1] == pytest.approx((stored[2] - stored[0]) / (0.1 * MM), rel=0.02)


@pytest.mark.parametrize("is_finite", [False, True])
def test_two_indenters_together_are_two_on_one_holder(mesh, is_finite):
    response = FiniteResponse(mesh) if is_finite else LinearResponse(surface_compliance(MODEL))
    ball, depth = Indenter("sphere", 2 * MM), 0.15 * MM
    solvers = [ContactSolver(MODEL, response, ball, 0.5) for _ in range(2)]
    advance_together(solvers, [Pose(-1.5 * MM, 0, depth), Pose(1.5 * MM, 0, depth)])
    fresh = FiniteResponse(mesh) if is_finite else LinearResponse(surface_compliance(MODEL))
    both = ContactSolver(MODEL, fresh, Indenter.two(ball, ball, 3 * MM), 0.5)
    both.advance(Pose(0, 0, depth))
    force = solvers[0].nodal_force + solvers[1].nodal_force
    assert np.abs(force - both.nodal_force).max() < 1e-3 * np.abs(both.nodal_force).max()


def test_what_it_cannot_do_is_refused(mesh):
    with pytest.raises(InputError, match=r"0\.4950 at finite strain"):
        FiniteMesh(PadModel(8 * MM, 6 * MM, 3 * MM, 2e5, 0.495))
    u = mesh.at_rest()
    u[-1, :, 2] = -3.1 * MM
    with pytest.raises(RuffiniError, match="crushed"):
        mesh.internal_force(u)
