"""Finite strain in integers: near float64 on touches, equal to the core on tables that no pad has."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from mirror.board import read_board
from mirror.finite_strain import FiniteStrain as Mirror
from mirror.fixed import Saturations
from mirror.path import FramePath
from test_frame_path import board_with_all_stages, photometric_tables

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.finite_strain import EXACT, FITTED, Weights, finite_strain
from ruffini.fem.operators import Noise
from ruffini.fem.slab import Slab

SLAB = Slab(20e-3, 16e-3, 4e-3, 31, 25, 6, 2e5, 0.48)
NOISE = Noise((5e-6, 5e-6, 2e-5))
STEP_M, FORCE_N = 125e-9, 10e-6


def touch(depth_m: float) -> npt.NDArray[np.float64]:
    x, y = np.meshgrid(np.linspace(-10e-3, 10e-3, 31), np.linspace(-8e-3, 8e-3, 25))
    bell = np.exp(-((x - 1e-3) ** 2 + y**2) / (2 * 1.5e-3**2))
    return np.stack([0.3 * depth_m * bell, 0.1 * depth_m * (y / 1.5e-3) * bell, -depth_m * bell], axis=-1)


@pytest.mark.parametrize("weights", [EXACT, FITTED])
@pytest.mark.parametrize(("depth_m", "largest_error"), [(0.2e-3, 0.05), (0.6e-3, 0.01), (1.2e-3, 0.01)])
def test_integers_follow_float(depth_m: float, largest_error: float, weights: Weights) -> None:
    beyond = finite_strain(SLAB, (25, 31), weights)
    u = np.round(touch(depth_m) / STEP_M)
    saturations = Saturations()
    steps = Mirror(*beyond.tensors(10)).force(u.astype(np.int64).reshape(-1, 3), saturations)
    true = beyond.force(u * STEP_M).reshape(-1, 3)
    assert np.linalg.norm(steps * FORCE_N - true) < largest_error * np.linalg.norm(true)
    assert saturations.count == 0


@pytest.mark.parametrize("seed", range(4))
def test_hostile_tables_never_overflow(seed: int) -> None:
    """The mirror asserts every 32-bit sum; the core has to say the same."""
    text = board_with_all_stages(2)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(seed)
    kind = kept(make_operator, typed, method="support", noise=NOISE, is_finite=True)
    tensors = dict(kind.tensors)
    limits = {"extension": 32767, "pressure": 32767, "slope": 1 << 20, "area": 1023, "volume": 1023}
    for name, table in kind.tensors.items():
        if not name.startswith("finite_strain."):
            continue
        limit = limits.get(name.removeprefix("finite_strain."), 2048)
        low = 1 if table.dtype == np.int32 else -limit
        values = np.where(rng.random(table.shape) < 0.5, limit, rng.integers(low, limit + 1, table.shape))
        tensors[name] = values.astype(table.dtype)
    shifts = {f"finite_strain.{name}_shift": str(rng.integers(0, 61)) for name in ("gain", "volume", "extension")}
    file = pack({**tensors, **photometric_tables(rng)}, {**base_metadata(typed), **kind.metadata, **shifts})
    mirror = FramePath(board, file.tensors, file.metadata)
    with Pipeline(typed, file.data) as core:
        n = core.layout.node_n_x * core.layout.node_n_y
        u = np.concatenate([np.full((1, n, 3), -32767), rng.integers(-32767, 32768, (2, n, 3))]).astype(np.int16)
        for one, force in zip(u, core.solve(u), strict=True):
            expected, _ = mirror.solve_given(one.astype(np.int64))
            assert np.array_equal(force, expected)
        assert np.array_equal(core.residual().reshape(-1, 3), mirror.residual())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"finite_strain.cos_x": lambda t: np.full_like(t, 2049)}, "cos_x has a wave above one"),
        ({"finite_strain.area": lambda t: np.zeros_like(t)}, "area is not within 1 to 1023"),
        ({"finite_strain.slope": lambda t: -t}, "slope is not within"),
        ({"finite_strain.mid_y": lambda t: t[:, 1:]}, "another type or shape"),
    ],
)
def test_tables_that_no_sum_holds_are_refused(change: dict[str, object], message: str) -> None:
    typed = parse_board(board_with_all_stages(2).encode(), "small")
    kind = kept(make_operator, typed, method="support", noise=NOISE, is_finite=True)
    tensors = dict(kind.tensors)
    for name, wrong in change.items():
        tensors[name] = np.ascontiguousarray(wrong(tensors[name]))  # type: ignore[operator]
    with pytest.raises(InputError, match=message):
        Pipeline(typed, pack(tensors, {**base_metadata(typed), **kind.metadata}).data)
