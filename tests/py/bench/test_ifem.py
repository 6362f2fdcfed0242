"""The benchmark's own arithmetic: scores of estimates whose error is known, noise as asked for, an honest truth."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.bench.disturbance import Disturbance
from ruffini.bench.ifem import Scores
from ruffini.bench.states import JUDGED, TUNED, Recipe, State, Touch
from ruffini.fem.condense import condense
from ruffini.fem.operators import ridge_operator
from ruffini.fem.slab import Slab
from ruffini.fem.sparse import SparseEstimator
from ruffini.reflection import dense_from_blocks

STEP_MM = (0.5, 0.5)


def state(*, pure: bool = False) -> State:
    force = np.zeros((9, 11, 3))
    force[3:6, 4:7] = (0.01, 0.0, -0.03)
    recipe = Recipe("a", (Touch("flat", 2, 0, 0, friction=1e-9 if pure else None),))
    return State(recipe, 0.6, force, np.zeros_like(force))


def test_the_truth_scores_nothing() -> None:
    scores = Scores()
    scores.add(state(), state().force, STEP_MM)
    means = scores.means()
    assert means["tangential"] == means["normal"] == means["resultant_n"] == means["moment_nmm"] == 0
    assert means["shape"] == means["peak"] == 1


def test_known_errors_score_what_they_are() -> None:
    true = state()
    scores = Scores()
    scores.add(true, true.force * np.array([1.1, 1.0, 0.8]), STEP_MM)
    means = scores.means()
    assert means["tangential"] == pytest.approx(0.1)
    assert means["normal"] == pytest.approx(0.2)
    assert means["peak"] == pytest.approx(0.8)
    assert means["resultant_n"] == pytest.approx(np.hypot(0.1 * 0.09, 0.2 * 0.27))
    moved = Scores()
    moved.add(true, np.roll(true.force, 1, axis=1), STEP_MM)
    assert moved.means()["moment_nmm"] == pytest.approx(0.5 * 0.27)  # Fz one step further along x
    assert moved.means()["resultant_n"] == pytest.approx(0)
    assert moved.means()["shape"] == pytest.approx(6 / 12)


def test_shear_counts_as_false_only_under_pure_normal_load() -> None:
    scores = Scores()
    pure = state(pure=True)
    scores.add(pure, pure.force + 0.02 * (pure.force[..., 2:] < 0) * [0.0, 1.0, 0.0], STEP_MM)
    assert scores.means()["false_shear"] == pytest.approx(2 / 3)
    assert not scores.tangential


def test_noise_is_as_large_and_as_long_as_asked_for() -> None:
    rng = np.random.default_rng(0)
    white = Disturbance(white_um=(5, 5, 20)).draw((200, 200, 3), rng)
    np.testing.assert_allclose(white.std(axis=(0, 1)) * 1e6, [5, 5, 20], rtol=0.02)
    smooth = Disturbance(correlated_um=(0, 0, 40)).draw((200, 200, 3), rng)[..., 2]
    assert smooth.std() * 1e6 == pytest.approx(40, rel=0.3)
    assert np.corrcoef(smooth[:, 1:].ravel(), smooth[:, :-1].ravel())[0, 1] > 0.9


def test_weights_are_chosen_on_states_that_are_not_judged() -> None:
    assert not {r.touches for r in TUNED} & {r.touches for r in JUDGED}


def test_sparse_without_a_penalty_is_on_its_way_to_raw() -> None:
    slab = Slab(8e-3, 6e-3, 3e-3, 7, 6, 3, 2e5, 0.45)
    condensed = condense(slab)
    u = np.random.default_rng(1).normal(size=(3 * slab.n_nodes, 2)) * 1e-5
    raw = dense_from_blocks(condensed.bases, ridge_operator(condensed, 0.0)) @ u
    light, heavy = (SparseEstimator(condensed).force(u, w) for w in (1e-9, 1.0))
    assert np.linalg.norm(light - raw) < 0.1 * np.linalg.norm(raw)
    k_11 = dense_from_blocks(condensed.bases, condensed.k_11)
    np.testing.assert_allclose(heavy, k_11 @ u, rtol=1e-9, atol=1e-12)  # above the largest useful weight U_2 is 0
