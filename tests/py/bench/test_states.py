"""The benchmark's truth at finite strain: against the linear one where strain is small, and from its cache."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from ruffini.bench.disturbance import Disturbance
from ruffini.bench.ifem import LINEAR, strain_cost
from ruffini.bench.states import Recipe, State, Touch, make_states
from ruffini.boards import Board, find_board
from ruffini.sim import unit as units

RECIPES = (
    Recipe("sheared", (Touch("sphere", 40, 0.3, -0.2, shift=(0.01, 0.0)),)),
    Recipe("two", (Touch("sphere", 30, -3.6, 0.0), Touch("sphere", 30, 3.6, 0.5, shift=(0.01, 0.0)))),
)


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Board:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "gelslim"
    found = find_board("gelslim").folder
    assert found is not None
    shutil.copytree(found, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write("\n[mesh]\ncells_x = 10\ncells_y = 8\n")
    return find_board(str(folder))


def test_finite_truth_is_linear_truth_where_strain_is_small_and_is_kept(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    linear = make_states(board, RECIPES, (0.05,))
    finite = make_states(board, RECIPES, (0.05,), truth="finite")
    for small, large in zip(linear, finite, strict=True):
        for a, b in ((small.force, large.force), (small.displacement, large.displacement)):
            assert 1e-4 < np.linalg.norm(a - b) / np.linalg.norm(a) < 0.1

    def never(*_: object) -> None:
        raise AssertionError("solved again")

    monkeypatch.setattr(units, "FiniteResponse", never)
    again = make_states(board, RECIPES, (0.05,), truth="finite")
    for first, second in zip(finite, again, strict=True):
        np.testing.assert_array_equal(first.force, second.force)
        np.testing.assert_array_equal(first.displacement, second.displacement)


def test_the_cost_of_strain_is_that_of_the_other_truth() -> None:
    """A method that says twice the linear force is right where the finite pad presses back twice as much."""

    class Twice:
        board, shape, step_mm = find_board("gelslim"), (3, 3, 3), (1.0, 1.0)

        def all(self) -> dict[str, object]:
            return {"default": lambda u: 2 * u, LINEAR: lambda u: u}

    force = np.full((3, 3, 3), -0.1)
    recipe = Recipe("a", (Touch("flat", 2, 0, 0),))
    linear, finite = State(recipe, 0.6, force, force), State(recipe, 0.6, 2 * force, force)
    cost = strain_cost(Twice(), [finite], [linear], Disturbance(), 1)["0.6 mm"]  # type: ignore[arg-type]
    assert cost["force_ratio"] == cost["largest_ratio"] == pytest.approx(2)
    assert cost["finite strain"]["default"]["normal"] == 0 == cost["linear pad"]["normal"]
    assert cost["finite strain"][LINEAR]["normal"] == pytest.approx(0.5)
