"""The operator compiler: what it promises is reached and never passed, and what it cannot do it says."""

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.fem import compile as compile_module
from ruffini.fem.certificate import CERTIFIED_STEPS, effective_rows
from ruffini.fem.compile import compile_matrix, force_steps
from ruffini.fem.hierarchy import Shape
from ruffini.fem.operators import Noise, force_operator
from ruffini.fem.slab import Slab
from ruffini.fem.symmetry import Sites, node_sites, reflection_classes

SLAB = Slab(10e-3, 8e-3, 4e-3, 11, 9, 4, 2e5, 0.48)


def slab_sites(slab: Slab) -> Sites:
    x, y = np.linspace(0, slab.size_x_m, slab.n_x), np.linspace(0, slab.size_y_m, slab.n_y)
    return node_sites(np.stack(np.meshgrid(x, y, [0.0]), axis=-1).reshape(-1, 3))


def scattered(n: int, seed: int) -> Sites:
    rng = np.random.default_rng(seed)
    return Sites(np.column_stack([rng.uniform(0, 20e-3, (n, 2)), np.zeros(n)]), rng.integers(-1, 3, n))


def kernel(rows: Sites, columns: Sites) -> np.ndarray:
    """Smooth and decaying, different for each pair of directions."""
    away = rows.place_m[:, None] - columns.place_m[None]
    distance = np.sqrt(np.square(away).sum(axis=-1) + 1e-6)
    return (1 + rows.axis[:, None] + 0.3 * columns.axis) * 1e-3 / distance


@pytest.fixture(scope="module")
def raw() -> np.ndarray:
    return force_operator(SLAB, "raw", noise=Noise((5e-6, 5e-6, 20e-6))) * force_steps(10)


def test_the_classes_of_a_slab_hold_a_quarter_and_lose_nothing(raw):
    sites = slab_sites(SLAB)
    classes = reflection_classes(raw, sites, sites)
    assert len(classes) == 4
    assert sum(c.matrix.size for c in classes) < 0.26 * raw.size
    again = np.zeros_like(raw)
    for c in classes:
        spread, gather = np.zeros((len(raw), len(c.rows))), np.zeros((len(c.columns), len(raw)))
        for k in range(4):
            for table, out in ((c.rows, spread), (c.columns, gather.T)):
                used = np.flatnonzero(table[:, k])
                out[np.abs(table[used, k]) - 1, used] = np.sign(table[used, k])
        again += spread @ c.matrix @ gather
    np.testing.assert_allclose(again, raw, atol=1e-9 * np.abs(raw).max())


def test_one_moved_place_or_one_changed_entry_is_no_symmetry(raw):
    sites = slab_sites(SLAB)
    moved = Sites(sites.place_m.copy(), sites.axis)
    moved.place_m[:3] += 1e-5
    assert len(reflection_classes(raw, sites, moved)) == 1
    changed = raw.copy()
    changed[3, 7] += 1e-3 * np.abs(raw).max()
    assert len(reflection_classes(changed, sites, sites)) == 1


def test_a_matrix_symmetric_about_one_line_has_two_classes():
    sites = slab_sites(SLAB)
    x = sites.place_m[:, 0] - 5e-3
    y = sites.place_m[:, 1]
    # Odd under x -> -x for x components, even for the others; nothing of y -> -y.
    sign = np.where(sites.axis == 0, np.sign(x), 1.0)
    profile = sign * (1 + np.abs(x) * 100) * np.exp(y * 300)
    matrix = np.outer(profile, profile)
    assert len(reflection_classes(matrix, sites, sites)) == 2


@pytest.mark.parametrize("case", ["slab", "scattered", "hierarchy"])
def test_the_certificate_is_reached_and_never_passed(raw, case):
    """By displacements that are against each axis at its worst, and by random ones."""
    if case == "slab":
        matrix, rows, columns = raw, slab_sites(SLAB), slab_sites(SLAB)
    else:
        n = (70, 110) if case == "scattered" else (1100, 1300)
        rows, columns = scattered(n[0], 1), scattered(n[1], 2)
        matrix = kernel(rows, columns)
    compiled = compile_matrix(matrix, rows, columns, "test", shapes=(Shape(48, 2, 0.5),))
    assert (
        compiled.form == {"slab": "dense/4", "scattered": "dense", "hierarchy": "hierarchical leaf 48 levels 2"}[case]
    )
    rounded = effective_rows(compiled.program, slice(0, len(matrix)), matrix.shape[1])
    proof = compiled.certificate
    axis = np.where(rows.axis < 0, 2, rows.axis)
    for a in range(3):
        error = np.abs(rounded - matrix).sum(axis=1) * (axis == a)
        row = int(error.argmax())
        u = CERTIFIED_STEPS * np.sign(rounded - matrix)[row]
        worst = abs(np.floor(rounded[row] @ u + 0.5) - matrix[row] @ u)
        assert worst <= proof.worst_steps[a]
        if case != "hierarchy":  # there every kept vector is rounded, too, and not all at its worst at once
            assert worst >= proof.worst_steps[a] - 1.01
    rng = np.random.default_rng(6)
    for _ in range(20):
        u = rng.integers(-CERTIFIED_STEPS, CERTIFIED_STEPS + 1, matrix.shape[1])
        error = np.abs(np.floor(rounded @ u + 0.5) - matrix @ u)
        assert all((error[axis == a] <= proof.worst_steps[a]).all() for a in range(3))
    relative = np.linalg.norm(rounded - matrix) / np.linalg.norm(matrix)
    assert relative == pytest.approx(proof.total)
    assert 1e-6 < proof.total < (1e-3 if case == "hierarchy" else 3e-4)


@pytest.mark.parametrize("bad", [np.full((3, 3), np.nan), np.zeros((3, 3)), np.zeros(3)])
def test_what_is_no_operator_is_refused(bad):
    with pytest.raises(InputError, match="nothing to compile"):
        compile_matrix(bad, scattered(3, 0), scattered(3, 0), "the operator")


def test_an_error_that_cannot_be_met_and_memory_that_is_not_there_are_refused(raw):
    sites = slab_sites(SLAB)
    with pytest.raises(InputError, match=r"more than 1\.0e-06"):
        compile_matrix(raw, sites, sites, "the operator", max_error=1e-6)
    with pytest.raises(InputError, match="the board has for it"):
        compile_matrix(raw, sites, sites, "the operator", max_bytes=10_000)
    with pytest.raises(InputError, match="its sites are"):
        compile_matrix(raw, scattered(3, 0), sites, "the operator")


def test_samples_are_judged_as_they_come(raw):
    """Inputs that the operator nearly cancels cost more than independent ones."""
    sites = slab_sites(SLAB)
    _, _, right = np.linalg.svd(raw)
    compiled = compile_matrix(raw, sites, sites, "the operator", samples=right[-1:].T, max_error=0.5)
    assert compiled.certificate.samples > 10 * compiled.certificate.total
    with pytest.raises(InputError, match="costs"):
        compile_matrix(raw, sites, sites, "the operator", samples=right[-1:].T)


def test_samples_may_be_allowed_to_cost_more(raw):
    sites = slab_sites(SLAB)
    _, _, right = np.linalg.svd(raw)
    compiled = compile_matrix(raw, sites, sites, "the operator", samples=right[-1:].T, max_sample_error=0.5)
    assert compiled.certificate.total <= 1e-3 < compiled.certificate.samples
    with pytest.raises(InputError, match=r"costs .* more than 2\.0e-03"):
        compile_matrix(raw, sites, sites, "the operator", samples=right[-1:].T, max_sample_error=2e-3)


def test_a_hierarchy_that_may_err_more_on_samples_reads_less():
    """Samples that the matrix makes small: the threshold that independent inputs allow costs them much more."""
    rows, columns = scattered(1100, 1), scattered(1300, 2)
    matrix = kernel(rows, columns)
    _, gain, right = np.linalg.svd(matrix)
    small = right[np.flatnonzero(gain < 0.003 * gain[0])[:1]].T
    shapes = (Shape(64, 2, 0.5),)
    free = compile_matrix(matrix, rows, columns, "test", shapes=shapes)
    loose = compile_matrix(matrix, rows, columns, "test", shapes=shapes, samples=small, max_sample_error=1.0)
    strict = compile_matrix(matrix, rows, columns, "test", shapes=shapes, samples=small, max_sample_error=0.003)
    assert loose.n_entries == free.n_entries
    assert loose.certificate.samples > 10 * loose.certificate.total
    assert strict.certificate.samples <= 0.003
    assert strict.n_entries > 1.05 * loose.n_entries


def test_a_hierarchy_reads_less_and_an_error_it_cannot_meet_is_dense():
    rows, columns = scattered(1100, 1), scattered(1300, 2)
    matrix = kernel(rows, columns)
    loose = compile_matrix(matrix, rows, columns, "test", max_error=1e-3)
    assert loose.form.startswith("hierarchical")
    assert loose.n_entries < 0.5 * matrix.size
    assert 1e-4 < loose.certificate.total <= 1e-3
    random = np.random.default_rng(0).normal(size=matrix.shape)
    assert compile_matrix(random, rows, columns, "test").form == "dense"


@pytest.mark.parametrize("n_levels", [1, 2])
def test_a_hierarchy_in_reflection_classes_of_a_rectangle(n_levels, monkeypatch):
    """Rows on one symmetric lattice, columns on another, components and scalars mixed."""
    monkeypatch.setattr(compile_module, "WORTH", 100.0)  # too small to pay
    x, y = np.meshgrid(np.linspace(0, 20e-3, 24), np.linspace(0, 16e-3, 20))
    rows = node_sites(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]))
    x, y = np.meshgrid(np.linspace(1e-3, 19e-3, 31), np.linspace(1e-3, 15e-3, 27))
    place = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    columns = Sites(
        np.concatenate([np.repeat(place, 2, axis=0), place]), np.r_[np.tile([0, 1], len(place)), [-1] * len(place)]
    )
    away = rows.place_m[:, None] - columns.place_m[None]
    r2 = np.square(away).sum(axis=-1) + 9e-6
    scalar = 1 / np.sqrt(r2)
    # A component along x (or y) goes with the distance along it: odd, as it must be.
    for axis, of in ((rows.axis[:, None], away), (columns.axis[None], away)):
        for a in (0, 1):
            scalar = scalar * np.where(axis == a, of[..., a] / np.sqrt(r2), 1.0)
    compiled = compile_matrix(scalar * 1e3, rows, columns, "test", shapes=(Shape(20, n_levels, 0.5),))
    assert compiled.form == f"hierarchical/4 leaf 20 levels {n_levels}"
    rounded = effective_rows(compiled.program, slice(0, len(rows)), len(columns))
    assert np.linalg.norm(rounded - scalar * 1e3) <= 1e-3 * np.linalg.norm(scalar * 1e3)
