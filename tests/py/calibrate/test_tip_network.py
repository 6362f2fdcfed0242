"""The fingertip's network: slopes of its loss, what it learns, and the deviations it states."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.estimators.fingertip import network

Array = npt.NDArray[np.float64]


def loss(out: Array, wanted: Array, *, is_first: bool) -> float:
    """As the texts of `network._slope` say."""
    n = wanted.shape[1]
    off, log2 = out[:, :n] - wanted, np.clip(out[:, n:], network.LEAST_LOG2, network.MOST_LOG2)
    if is_first:
        return float((off**2).mean() + 1e-3 * (log2**2).mean())
    return float((2**0.5 * np.abs(off) / 2**log2 + np.log(2) * log2).mean())


@pytest.mark.parametrize("is_first", [True, False])
def test_the_slope_is_that_of_the_loss(is_first: bool) -> None:
    rng = np.random.default_rng(1)
    out, wanted = rng.normal(0, 1, (5, 6)), rng.normal(0, 1, (5, 3))
    out[0, 3], out[1, 4] = network.LEAST_LOG2 - 1, network.MOST_LOG2 + 1  # beyond: the loss does not change
    slope = network._slope(out.astype(np.float32), wanted.astype(np.float32), is_first=is_first)
    for at in np.ndindex(out.shape):
        step = np.zeros_like(out)
        step[at] = 1e-6
        rise = loss(out + step, wanted, is_first=is_first) - loss(out - step, wanted, is_first=is_first)
        assert slope[at] == pytest.approx(rise / 2e-6, abs=1e-5)


def test_it_learns_what_can_be_told_and_states_the_deviation_of_what_cannot() -> None:
    from sklearn.linear_model import Ridge

    rng = np.random.default_rng(2)
    features = rng.normal(0, 1, (14000, 8))
    curved = np.sin(2 * features[:, 0]) * features[:, 1]
    spread = np.where(features[:, 2] > 0, 0.5, 0.1)  # of a label that no network can tell
    labels = np.column_stack([curved, features[:, 3] + spread * rng.laplace(0, 2**-0.5, 14000)])
    fit, left = slice(0, 12000), slice(12000, None)
    told, sigma = network.train(features[fit], labels[fit], rounds=30, noise=0.0)(features[left])
    peer = Ridge().fit(features[fit], labels[fit]).predict(features[left])
    off, peer_off = (np.abs(said - labels[left]).mean(axis=0) for said in (told, peer))
    assert off[0] < 0.25 * peer_off[0]
    assert off[1] < 1.1 * peer_off[1]
    # Of rows that were fitted a network knows a part of the noise by heart: its deviations are too small, and what it
    # knows less well near the step between both is in the narrow one. `ModeFit.trust` corrects that as a whole.
    is_wide = features[left, 2] > 0
    assert 0.35 < np.median(sigma[is_wide, 1]) < 0.6  # 0.5
    assert 0.08 < np.median(sigma[~is_wide, 1]) < 0.2  # 0.1


def test_one_seed_gives_the_same_network() -> None:
    rng = np.random.default_rng(3)
    features, labels = rng.normal(0, 1, (300, 5)), rng.normal(0, 1, (300, 2))
    one, two, other = (network.train(features, labels, rounds=2, noise=0.1, seed=s) for s in (1, 1, 2))
    assert all((a == b).all() for a, b in zip(one.weights, two.weights, strict=True))
    assert any((a != b).any() for a, b in zip(one.weights, other.weights, strict=True))
