"""The map of the ridge: its forces are the paper's, and what its text proves holds."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from papers.gelslim.method import InverseFem, Slab
from papers.gelslim.ridge_map import (
    COLUMNS,
    ELEMENTS,
    LAYERS,
    MESHES,
    NOISES_UM,
    WEIGHTS,
    Cell,
    Pad,
    draw,
    judged,
    line,
    verdict,
)

from ruffini.bench.states import JUDGED, State
from ruffini.fem.condense import condense
from ruffini.fem.slab import Slab as OurSlab

SIZE = (4e-3, 3e-3, 2e-3)
N_X, N_Y, N_LAYERS, E_PA, NU = 5, 4, 3, 2e5, 0.48


@pytest.fixture(scope="module")
def fem() -> InverseFem:
    return InverseFem.of(Slab(SIZE, E_PA, NU, N_X, N_Y, N_LAYERS))


@pytest.fixture(scope="module")
def pad() -> Pad:
    return Pad.of(condense(OurSlab(*SIZE, N_X, N_Y, N_LAYERS, E_PA, NU), b_bar=False))


def test_forces_are_those_of_the_papers_equations(fem: InverseFem, pad: Pad) -> None:
    u = np.random.default_rng(1).normal(size=(3 * N_X * N_Y, 2)) * 1e-5
    found = pad.forces(u)
    matrices = [fem.raw(), *fem.ridge(WEIGHTS[1:])]
    for force, matrix in zip(found, matrices, strict=True):
        np.testing.assert_allclose(force, matrix @ u, rtol=1e-6, atol=1e-9)
    assert pad.condition == pytest.approx(np.linalg.cond(fem.k22), rel=1e-6)


def test_a_heavier_ridge_never_lowers_white_noise(fem: InverseFem) -> None:
    """S_w - S_v is positive semidefinite for w > v, so that |S_w| >= |S_v|: the ridge amplifies white noise."""
    matrices = [fem.raw(), *fem.ridge((1e-8, 1e-5, 1e-3, 1e-2, 0.1, 1.0))]
    top = np.linalg.eigvalsh(matrices[0])[-1]
    sizes = [np.linalg.norm(m) for m in matrices]
    assert sizes[-1] > 1.1 * sizes[0]
    for light, heavy in pairwise(matrices):
        assert np.linalg.eigvalsh(heavy - light)[0] > -1e-10 * top
    assert all(heavy >= light * (1 - 1e-12) for light, heavy in pairwise(sizes))


def test_the_best_weight_of_a_model_that_is_too_soft_is_not_raw(pad: Pad) -> None:
    u = np.zeros((N_Y, N_X, 3))
    u[1:3, 1:4, 2] = -1e-4
    force = pad.forces(u.reshape(-1, 1))[0].reshape(u.shape)
    named = {
        "varied": "",
        "element": "hexahedra",
        "mesh": (N_X, N_Y),
        "layers": N_LAYERS,
        "poisson": NU,
        "noise_um": 0.0,
    }
    states = [State(JUDGED[0], 0.1, force, u)]
    right = judged(pad, states, u.reshape(-1, 1), named)
    assert right.best == 0
    assert right.error[0] == pytest.approx(0, abs=1e-12)
    assert right.error[-1] == pytest.approx(right.signal[-1])
    assert right.noise == pytest.approx(0, abs=1e-12)
    soft = judged(pad, states, u.reshape(-1, 1), named, 1.02)
    assert soft.error[0] == pytest.approx(0.02 / 1.02)
    assert soft.best > 0
    assert 0 < soft.gain < 1


def cell(varied: str, element: str, mesh: tuple[int, int], layers: int, noise_um: float, best: int) -> Cell:
    """Error 1, and 0.9 at the weight `best` if that is not raw."""
    error = np.where((np.arange(len(WEIGHTS)) == best) & (best > 0), 0.9, np.linspace(1, 4, len(WEIGHTS)))
    return Cell(varied, element, mesh, layers, 0.48, noise_um, 100.0, error, error, error, error, error)


def test_the_map_says_where_the_ridge_helps(tmp_path: Path) -> None:
    cells = [
        cell("mesh", element, mesh, layers, noise[2], 5 if (mesh, noise) == (MESHES[0], NOISES_UM[0]) else 0)
        for element in ELEMENTS for mesh in MESHES for layers in LAYERS for noise in NOISES_UM
    ]  # fmt: skip
    cells.append(cell("true modulus 1.3 times the model's", "B-bar", MESHES[2], 6, 20.0, 3))
    said = verdict(cells)
    assert said[0].startswith("With its best weight the ridge lowers the error by 5 % or more in 6 of 72 cells")
    assert "most by 10.0 %" in said[0]
    assert "raw is best in 66" in said[0]
    assert "up to 10.0 % (true modulus 1.3" in said[2]
    rows = [line(c).split(",") for c in cells]
    assert {len(row) for row in rows} == {len(COLUMNS)}
    assert [row[COLUMNS.index("weight")] for row in rows[:2]] == ["1e-06", "0"]
    assert draw(cells, tmp_path / "map.png").stat().st_size > 50_000
