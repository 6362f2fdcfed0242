"""How much of a displacement's noise is correlated: told of noise that is drawn so, and drawn as it was told."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from kept import kept
from scipy.ndimage import gaussian_filter
from test_material import TOUCH_NOISE_M, TRUE, board, touches  # noqa: F401

from ruffini.boards import Board, find_board, parse_board
from ruffini.estimators.noise import stage
from ruffini.estimators.noise.stage import BLOCK, MIN_BLOCKS, MIN_REST, Power, long_share, planes, power_of
from ruffini.estimators.operator import error_model
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.finite_strain import LINEAR_GROWTH
from ruffini.fem.operators import LONG_NODES, Noise
from ruffini.fem.uncertainty import NodeError, WrenchError

SIGMA_M = np.array([5e-6, 6e-6, 2e-5])
BOARD = find_board("gelslim")
SHAPE = (BOARD.grid.n_y, BOARD.grid.n_x, 3)
COARSE = parse_board(BOARD.text.replace("n_x = 31\nn_y = 25\nn_layers = 6", "n_x = 16\nn_y = 13\nn_layers = 4"), "test")


def measured(noise: Noise, n_frames: int = 60) -> Power:
    """Of frames as the error model draws them, with a constant and a tilt of z beside it, which are of no concern."""
    rng, plane = np.random.default_rng(4), planes(BOARD)
    beside = np.outer(plane @ [1e-4, 2e-5, -3e-5], [0, 0, 1])
    drawn = [error_model._noise(rng, SHAPE, noise, may_be_white=False).reshape(-1, 3) for _ in range(n_frames)]
    return Power.mean([power_of(one + beside, plane, SHAPE) for one in drawn])


@pytest.mark.parametrize("share", [(0.0, 0.0, 0.0), (0.0, 0.3, 1.0), (0.6, 0.6, 0.1)])
def test_the_share_of_drawn_noise_is_found_axis_by_axis(share: tuple[float, float, float]) -> None:
    power = measured(Noise(tuple(SIGMA_M), long_share=share))
    np.testing.assert_allclose(np.sqrt(power.node), SIGMA_M, rtol=0.12)
    assert long_share(power) == pytest.approx(share, abs=0.12)


def test_noise_of_which_nothing_is_known_is_half_white_and_half_beside_long_noise() -> None:
    assert measured(Noise(tuple(SIGMA_M))).node == pytest.approx(SIGMA_M**2 * 1.25, rel=0.1)


def test_noise_that_is_correlated_over_few_nodes_is_told_by_what_a_contact_sees_of_it() -> None:
    """Its share is that of noise with the same variance over a block."""
    rng, of_block = np.random.default_rng(2), []
    for _ in range(60):
        smooth = gaussian_filter(rng.normal(size=SHAPE), (0.84, 0.84, 0), mode="wrap")
        of_block.append(power_of((smooth / smooth.std()).reshape(-1, 3), planes(BOARD), SHAPE))
    power = Power.mean(of_block)
    assert power.block is not None
    assert power.block / power.node == pytest.approx(6.4, rel=0.1), "of an endless block 4 pi 0.84^2 = 8.9"
    x, y, z = long_share(power) or (0.0, 0.0, 0.0)
    assert min(x, y, z) > 0.15
    assert max(x, y, z) < 0.4


def test_a_grid_of_few_blocks_tells_nothing() -> None:
    shape = (3 * BLOCK, (MIN_BLOCKS - 1) // 3 * BLOCK, 3)
    field = np.random.default_rng(1).normal(size=shape).reshape(-1, 3)
    assert long_share(power_of(field, np.ones((len(field), 1)), shape)) is None
    thin = np.ones((3 * 40, 3))
    assert long_share(power_of(thin, np.ones((len(thin), 1)), (3, 40, 3))) is None


@pytest.mark.parametrize(("n_rest", "wanted"), [(MIN_REST, 0.8), (MIN_REST - 1, 0.5)])
def test_the_fit_takes_the_larger_of_rest_and_touch(
    monkeypatch: pytest.MonkeyPatch, n_rest: int, wanted: float
) -> None:
    """Too few untouched frames tell nothing; boards that see no depth draw the noise of their markers themselves."""
    rest, touch = (Noise(tuple(SIGMA_M), long_share=(share,) * 3) for share in (0.8, 0.5))
    monkeypatch.setattr(stage, "unexplained", lambda *_: measured(touch))
    rng = np.random.default_rng(6)
    frames = [error_model._noise(rng, SHAPE, rest, may_be_white=True).reshape(-1, 3) for _ in range(n_rest)]
    job = SimpleNamespace(board=BOARD, log=lambda: SimpleNamespace(rest=np.array(frames)), noise=None)
    outcome = stage.NOISE.fit(job, lambda _: None)
    assert job.noise.long_share == pytest.approx((wanted,) * 3, abs=0.2)
    assert outcome.report["long_share"] == job.noise.long_share
    assert np.array(job.noise.sigma_m) == pytest.approx(SIGMA_M, rel=0.15)
    by_markers = BOARD.depth.model_copy(update={"source": "markers"})
    job.board = BOARD.model_copy(update={"depth": by_markers})
    stage.NOISE.fit(job, lambda _: None)
    assert job.noise.long_share is None


def test_what_finite_strain_explains_of_a_touch_is_no_noise(board: Board) -> None:  # noqa: F811
    """Deep touches with noise of TOUCH_NOISE_M, on a pad whose numbers are known."""
    u, wrench = touches(board, 6, np.random.default_rng(4), is_finite=True)
    log, left = SimpleNamespace(displacement=u, wrench=wrench, touch=np.arange(len(u)) // 5), {}
    for is_finite in (True, False):
        job = SimpleNamespace(board=board, material=TRUE, is_finite=is_finite)
        left[is_finite] = stage.unexplained(job, log, Noise(tuple(SIGMA_M))).node - TOUCH_NOISE_M**2
    assert (left[True] < 0.3 * left[False]).all()


def test_growth_keeps_the_larger_crosstalk() -> None:
    found = WrenchError(np.ones(2), np.ones(2), np.ones(2), np.ones(2), crosstalk=5e-3)
    model = error_model.ErrorModel(NodeError(np.ones((2, 12)), np.ones((2, 7)), np.ones((2, 4))), found)
    assert model.grown(LINEAR_GROWTH).wrench.crosstalk == pytest.approx(5e-3 * np.sqrt(LINEAR_GROWTH.wrench))
    larger = replace(LINEAR_GROWTH, crosstalk=0.02)
    assert model.grown(larger).wrench.crosstalk == 0.02


def test_long_noise_makes_wrenches_less_sure_and_so_does_a_pad_that_was_not_measured() -> None:
    def wrench(share: float, *, is_fitted: bool = True) -> np.ndarray:
        noise = Noise(tuple(SIGMA_M), long_share=(share, share, share))
        kind = kept(make_operator, COARSE, method="support", noise=noise, n_touches=60, is_fitted=is_fitted)
        return kind.tensors["support.error_wrench"]

    white, of_long, unmeasured = wrench(0.0), wrench(1.0), wrench(0.0, is_fitted=False)
    assert of_long[0, 0] > 2 * white[0, 0], "constant error of shear"
    assert unmeasured[3, 1] > 1.5 * white[3, 1], "common error of all pressure"
    assert LONG_NODES > 1
