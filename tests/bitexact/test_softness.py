"""The stage softness is the mirror's, bit for bit, and the host's fit in floats agrees with it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.softness import Softness as Mirror
from mirror.softness import dent, exp2_q16
from test_picture_features import CORNERS, N_REST, NOT_MEASURED, VALID, board_text, picture

from ruffini.boards import Board, parse_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.softness.model import Grid, Softness, dent_of

N_X, N_Y = 10, 8
MODEL = Softness(low_n=0.7, high_n=3.0, slope=0.3, rigid=14.0, sigma=0.15, gel_pa=190_000.0)
# Strengths of the bump: a squeeze, one that ends too early, one that jumps beyond the upper force, and another squeeze,
# which slackens below the lower force without a release
STRENGTHS = [0.0, 4.8, 9.0, 14.0, 26.0, 60.0, 20.0, 0.0, 10.0, 0.0, 70.0, 60.0, 0.0, 8.0, 3.0, 12.0, 30.0, 45.0]


def text_of(n_x: int = N_X, n_y: int = N_Y) -> str:
    return board_text(CORNERS["upright"], n_x, n_y).replace('"feature_wrench"]', '"feature_wrench", "softness"]')


def calibration(board: Board, n_x: int = N_X, n_y: int = N_Y) -> CalibrationFile:
    """A normal force in proportion to the blue of all cells, with an error that grows with it."""
    n = 3 * n_x * n_y
    gain, error = np.zeros((6, n), np.int32), np.zeros((2, 6, 6), np.int32)
    gain[2, : n // 3] = -900
    error[0, 2, 2], error[1, 2, 2] = 40_000, 300_000
    tensors = {
        "wrench.gain": gain, "wrench.shift": np.full(6, 1, np.uint8), "wrench.error": error,
        "wrench.full_scale": np.array([0, 0, 20_000_000, 0, 0, 0], np.int32),
        "wrench.square": np.zeros((6, 21), np.int32), **MODEL.tables(),
    }  # fmt: skip
    return pack(tensors, {**base_metadata(board), "wrench.features": "picture"})


def test_squeezes_are_those_of_the_mirror_and_of_the_floats() -> None:
    rng, board = np.random.default_rng(5), parse_board(text_of().encode(), "small")
    file = calibration(board)
    mirror = Mirror(file.tensors["softness.map"].tolist(), N_X, N_Y)
    forces, features, sigmas, results = list[float](), list[npt.NDArray[np.int64]](), list[float](), list[list[int]]()
    with Pipeline(board, file.data) as core:
        for _ in range(N_REST):
            core.process(picture(rng, 0.0))
        for t, strength in enumerate(STRENGTHS):
            said = core.process(picture(rng, strength), capture_s=0.03 * t)
            assert said.flags & ~6 == 0
            force, variance = -int(said.wrench_un[2]), int(core.covariance()[11])
            mirror.run(core.features().astype(np.int64), force, variance)
            *result, validity = core.raw("softness").tolist()
            assert result == mirror.result, t
            assert validity == (VALID if result[1] else NOT_MEASURED)
            results.append(result)
            forces.append(force * 1e-6)
            features.append(core.features().astype(np.int64))
            sigmas.append(variance**0.5 * 1e-6)
    counts = [result[0] for result in results]
    assert counts == [0] * 4 + [1] * 12 + [2] * 2, np.round(forces, 2).tolist()
    assert results[-1][1] == 4  # frames, the slack one too
    share = MODEL.share(dent_of(np.array(features, float), Grid(N_X, N_Y)), np.array(forces), np.array(sigmas))
    first = next(result for result in results if result[0])
    assert share is not None
    assert first[1] > 1
    assert first[2] / 65536 == pytest.approx(share.log, abs=1e-3)
    assert first[3] / 65536 == pytest.approx(share.sigma, rel=1e-3)
    assert first[4] == pytest.approx(MODEL.modulus_pa(share.log), rel=2e-3)
    assert first[5:] == pytest.approx(MODEL.interval_pa(share), rel=2e-3)


def test_a_dent_as_sharp_as_a_rigid_objects_has_a_lower_limit_alone() -> None:
    rng, board = np.random.default_rng(5), parse_board(text_of().encode(), "small")
    file = calibration(board)
    numbers = file.tensors["softness.map"].copy()
    numbers[3] -= 12 << 16
    with Pipeline(board, pack({**file.tensors, "softness.map": numbers}, file.metadata).data) as core:
        for strength in [0.0] * N_REST + [0.0, 10.0, 40.0]:
            core.process(picture(rng, strength))
        _, n, share, _, modulus, low, high, validity = core.raw("softness").tolist()
        assert (n > 0, validity) == (True, VALID)
        assert share > 0
        assert (modulus, high) == (0, 0)
        assert low == pytest.approx(9 * MODEL.gel_pa, rel=0.01)
        core.zero(1)
        core.process(picture(rng, 0.0))
        core.process(picture(rng, 0.0))
        assert core.raw("softness").tolist() == [0] * 8


def test_a_rise_that_flagged_frames_interrupt_is_no_squeeze() -> None:
    """Black frames: the object may have been released and squeezed again meanwhile."""
    rng, board = np.random.default_rng(5), parse_board(text_of().encode(), "small")
    file = calibration(board)
    mirror = Mirror(file.tensors["softness.map"].tolist(), N_X, N_Y)
    counts = []
    with Pipeline(board, file.data) as core:
        for strength in [0.0] * (N_REST + 1) + [9.0, None, None, 60.0, 0.0, 9.0, 60.0]:
            said = core.process(np.zeros_like(picture(rng, 0.0)) if strength is None else picture(rng, strength))
            assert (said.flags & ~7 != 0) == (strength is None)
            if strength is None:
                mirror.discard_rise()
            elif len(counts) >= N_REST:
                mirror.run(core.features().astype(np.int64), -int(said.wrench_un[2]), int(core.covariance()[11]))
                assert core.raw("softness").tolist()[:-1] == mirror.result
            counts.append(core.raw("softness").tolist()[0])
    assert counts[N_REST:] == [0] * 7 + [1]


def test_the_curvature_is_that_of_a_known_slope() -> None:
    """A plane has none of its own; cells that rise by 100 along x in one channel have 200 between pairs of cells."""
    ramp = np.zeros((3, N_Y, N_X), np.int64)
    ramp[1] = 100 * np.arange(N_X)
    assert dent(ramp.ravel(), N_X, N_Y) / 65536 == pytest.approx(np.log2(200.0**2 + 1), abs=1e-4)
    assert dent_of(ramp.reshape(1, -1).astype(float), Grid(N_X, N_Y))[0] == pytest.approx(np.log2(200), abs=1e-4)
    ramp[1, :2] = ramp[1, -2:] = 1e5  # the rim does not count
    assert dent(ramp.ravel(), N_X, N_Y) / 65536 == pytest.approx(np.log2(200.0**2 + 1), abs=1e-4)


@pytest.mark.parametrize("x", [0.0, -0.1, -0.5, -1.0, -3.7, -15.9, -40.0])
def test_powers_of_two(x: float) -> None:
    assert exp2_q16(round(x * 65536)) == pytest.approx(65536 * 2.0**x, abs=2)


@pytest.mark.parametrize(("index", "value"), [(0, 0), (1, 5), (2, -1), (4, 0), (5, 0)])
def test_numbers_out_of_range_are_refused(index: int, value: int) -> None:
    board = parse_board(text_of().encode(), "small")
    file = calibration(board)
    file.tensors["softness.map"][index] = value
    with pytest.raises(InputError, match=r"a number of softness\.map is out of range: make it again"):
        Pipeline(board, pack(file.tensors, file.metadata).data)


def test_a_grid_with_too_few_cells_is_refused() -> None:
    board = parse_board(text_of(8, 6).encode(), "small")
    with pytest.raises(InputError, match="at least 8 x 7 cells"):
        Pipeline(board, calibration(board, 8, 6).data)
