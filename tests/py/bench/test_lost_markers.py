"""Lost markers in the benchmark: filled from what is known, plain fields unharmed, as many lost as asked for."""

from __future__ import annotations

import numpy as np
import pytest
from kept import kept

from ruffini.bench.ifem import evaluate, observed
from ruffini.bench.markers import LostMarkers, fill_lost
from ruffini.bench.states import Recipe, State, Touch, make_states
from ruffini.boards import Board, find_board
from ruffini.errors import InputError
from ruffini.estimators.operator.marker_lattice import NodesOnLattice, marker_places


@pytest.fixture(scope="module")
def board() -> Board:
    return find_board("gelslim")


def test_a_lost_marker_is_the_mean_of_its_known_neighbours_ring_by_ring() -> None:
    u = np.arange(5.0)[None, :, None] * np.ones((3, 1, 2))
    is_lost = np.zeros((3, 5), bool)
    is_lost[1, 2] = True
    np.testing.assert_allclose(fill_lost(u, is_lost), u)
    is_lost[:, :3] = True
    filled = fill_lost(u, is_lost)
    np.testing.assert_allclose(filled[:, 2], 3)  # the column beside
    np.testing.assert_allclose(filled[:, 0], 3)  # the rings behind it
    np.testing.assert_array_equal(filled[:, 3:], u[:, 3:])
    assert np.all(fill_lost(u, np.ones((3, 5), bool)) == 0)  # nothing known: nothing moved


def test_a_linear_field_reaches_the_nodes_unchanged(board: Board) -> None:
    assert board.markers is not None
    x, y = marker_places(board, board.markers)
    field = np.stack(np.broadcast_arrays(0.02 * x, 0.01 * y[:, None] + 1e-5), axis=-1)
    nodes = NodesOnLattice(board, board.markers).interpolate(field)
    node_x = np.linspace(-0.5, 0.5, board.grid.n_x) * board.pad.size_x_um * 1e-6
    np.testing.assert_allclose(nodes[..., 0], np.broadcast_to(0.02 * node_x, nodes.shape[:2]), atol=1e-12)


def test_the_share_lost_is_what_was_asked_for_and_depth_does_not_feel_it(board: Board) -> None:
    assert board.markers is not None
    lattice = NodesOnLattice(board, board.markers)
    shape = (board.markers.n_y, board.markers.n_x, 3)
    truth = np.zeros((board.grid.n_y, board.grid.n_x, 3))
    at_markers = np.random.default_rng(1).normal(size=shape) * 1e-4
    whole, some, all_ = (
        LostMarkers(share, (0.0, 0.0, 20.0)).observe(lattice, truth, at_markers, np.random.default_rng(3))
        for share in (0.0, 0.2, 1.0)
    )
    np.testing.assert_allclose(whole[..., :2], lattice.interpolate(at_markers[..., :2]))
    assert 0.05 < np.linalg.norm((some - whole)[..., :2]) / np.linalg.norm(whole[..., :2]) < 0.8
    assert not all_[..., :2].any()
    np.testing.assert_array_equal(some[..., 2], whole[..., 2])
    assert some[..., 2].std() == pytest.approx(20e-6, rel=0.1)


def test_states_bring_the_truth_at_the_markers(board: Board) -> None:
    assert board.markers is not None
    (state,) = kept(make_states, board, (Recipe("ball", (Touch("sphere", 8, 0.5, 0, shift=(0.1, 0)),)),), (0.3,))
    quiet = LostMarkers(0.0, (0.0, 0.0, 0.0))
    u = observed(board, state, quiet, np.random.default_rng(0))
    np.testing.assert_array_equal(u[..., 2], state.displacement[..., 2])
    apart = np.linalg.norm((u - state.displacement)[..., :2]) / np.linalg.norm(state.displacement[..., :2])
    assert 1e-4 < apart < 0.1  # what interpolation costs
    bare = State(state.recipe, state.depth_mm, state.force, state.displacement)
    with pytest.raises(InputError, match="no \\[markers\\]"):
        observed(board, bare, quiet, np.random.default_rng(0))


def test_a_condition_of_lost_markers_judges_every_method(board: Board) -> None:
    """One method returns what it saw as its force: its error is what filling and interpolating did."""

    class Echo:
        step_mm = (1.0, 1.0)

        def __init__(self) -> None:
            self.board = board
            self.shape = (board.grid.n_y, board.grid.n_x, 3)

        def all(self) -> dict[str, object]:
            return {"echo": lambda u: u, "half": lambda u: u / 2}

    assert board.markers is not None
    at_markers = np.random.default_rng(2).normal(size=(board.markers.n_y, board.markers.n_x, 3))
    at_markers[..., 2] = -1.0
    force = np.full((board.grid.n_y, board.grid.n_x, 3), -1.0)
    force[..., :2] = NodesOnLattice(board, board.markers).interpolate(at_markers[..., :2])
    state = State(Recipe("a", (Touch("flat", 2, 0, 0),)), 0.6, force, force, at_markers)
    scores = {
        share: evaluate(Echo(), [state], LostMarkers(share, (0.0, 0.0, 0.0)), 1)  # type: ignore[arg-type]
        for share in (0.0, 0.1)
    }
    assert scores[0.0]["echo"]["tangential"] == pytest.approx(0, abs=1e-12)
    assert scores[0.0]["half"]["tangential"] == pytest.approx(0.5)
    assert 0.1 < scores[0.1]["echo"]["tangential"] < 0.6
    assert scores[0.1]["echo"]["normal"] == 0
