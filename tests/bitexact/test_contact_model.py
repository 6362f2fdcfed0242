"""The stage contact_model against the mirror, bit for bit, and what it flags."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import read_board
from mirror.contact_model import ContactModel, ContactProfile
from mirror.fixed import Saturations
from mirror.helmholtz import Helmholtz
from odd_boards import small_board
from scipy.ndimage import gaussian_filter, map_coordinates

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.calibrate.perceptron import tanh_table
from ruffini.core import Pipeline
from ruffini.errors import InputError

Picture = npt.NDArray[np.uint8]
Tensors = dict[str, npt.NDArray[np.generic]]
NOT_MEASURED, VALID, INVALID = 0, 1, 3
MARKERS_LOST, OVER_RANGE = 8, 32
WIDTH, HEIGHT, N_REST = 150, 113, 3
MIDDLE = np.array([77.0, 55.0])
NUMBERS = {"least_fall_q16": 2000, "least_force_un": 90_000, "depth_sigma_um": 77, "moment_per_flow": 4321,
           "most_strange_q8": 1 << 24, "most_failing_q12": 1 << 16}  # fmt: skip


def board_text() -> str:
    """Patches of an odd lattice over an odd picture; rings that leave it on one side before the other."""
    text = small_board(width=WIDTH, height=HEIGHT, step=1).replace('"dark"', '"texture"')
    for old, new in (("center_x_mpx = 33210", "center_x_mpx = 74610"), ("center_y_mpx = 20777", "center_y_mpx = 56277"),
                     ("focal_mpx = 101300", "focal_mpx = 201300"), ("n_x = 5\nn_y = 3\n", "n_x = 9\nn_y = 7\n"),
                     ("pitch_x_um = 733\npitch_y_um = 751", "pitch_x_um = 401\npitch_y_um = 383"),
                     ("first_x_um = 501\nfirst_y_um = 633", "first_x_um = 381\nfirst_y_um = 362"),
                     ("threshold_1e3 = 137", "threshold_1e3 = 600")):  # fmt: skip
        assert old in text, old
        text = text.replace(old, new)
    stages = '["difference", "markers", "feature_wrench", "contact_model", "helmholtz"]'
    return text[: text.index("stages = ")] + f"stages = {stages}\n"


def texture() -> npt.NDArray[np.float64]:
    noise = gaussian_filter(np.random.default_rng(5).normal(size=(HEIGHT, WIDTH)), 1.3)
    return np.asarray(120 + 45 * noise / noise.std())


def pressed(rest: npt.NDArray[np.float64], out_px: float, shift_px: float = 0.0) -> Picture:
    """Everything moves outwards from MIDDLE, most at 25 px from it, and sideways."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    dx, dy = x - MIDDLE[0], y - MIDDLE[1]
    r = np.hypot(dx, dy) + 1e-9
    size = out_px * (r / 25) * np.exp(1 - r / 25)
    moved = map_coordinates(rest, [y - size * dy / r, x - size * dx / r - shift_px], order=3, mode="nearest")
    return np.repeat(np.clip(np.round(moved), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def tables(rng: np.random.Generator, n: int) -> Tensors:
    """Depth about five times the profile's size, hardness and kind as they come; a wrench that presses."""
    out: Tensors = {"contact_model.tanh": tanh_table()}
    for name, bias in (("size", [19_000, 21_000, 3000, 3500]), ("kind", [300]), ("fails", [500]),
                       ("planar", [700]), ("hertzian", [900])):  # fmt: skip
        weights = rng.integers(-(1 << 14), 1 << 14, (len(bias), 6)).astype(np.int32)
        weights[:, -1] = np.array(bias) << 5
        out[f"contact_model.{name}_hidden"] = rng.integers(-(1 << 14), 1 << 14, (5, 19)).astype(np.int32)
        out[f"contact_model.{name}_out"] = weights
        out[f"contact_model.{name}_shift"] = np.array([18, 20], np.uint8)
    out["contact_model.whitening"] = rng.integers(-(1 << 20), 1 << 20, (16, 16)).astype(np.int32)
    out["contact_model.mean"] = rng.integers(0, 1 << 13, 16).astype(np.int16)
    out["contact_model.sigma"] = rng.integers(16, 160, (2, 10)).astype(np.int32)
    out["contact_model.odds"] = np.array([-9000, 4096, 5000, 3000], np.int32)
    gain = rng.integers(-20, 20, (6, n, 2))
    x, y = np.meshgrid(np.arange(9) - 4, np.arange(7) - 3)
    gain[2] = -np.stack([x, y], axis=-1).reshape(-1, 2) * 1500
    scale = np.array([10_000_000] * 6, np.int32)
    return out | {
        "wrench.gain": gain.reshape(6, -1).astype(np.int32), "wrench.shift": np.full(6, 4, np.uint8),
        "wrench.full_scale": scale * 100, "wrench.square": np.zeros((6, 21), np.int32),
        "wrench.error": np.zeros((2, 6, 6), np.int32),
    }  # fmt: skip


def opened(kind: Tensors, **numbers: int) -> Pipeline:
    board = parse_board(board_text().encode(), "small")
    metadata = {f"contact_model.{k}": str(v) for k, v in {**NUMBERS, **numbers}.items()}
    return Pipeline(board, pack(kind, {**base_metadata(board), "wrench.features": "markers", **metadata}).data)


def rested(core: Pipeline, rest: npt.NDArray[np.float64]) -> None:
    for _ in range(N_REST):
        core.process(pressed(rest, 0.0))


def test_profile_and_contact_over_two_presses() -> None:
    rng, rest = np.random.default_rng(2), texture()
    kind = tables(rng, 63)
    mirror_profile, mirror = ContactProfile(read_board(board_text())), ContactModel(kind, NUMBERS)
    mirror_parts, turned, parts = Helmholtz(read_board(board_text())), [], []
    saturations, depths, told = Saturations(), [], 0
    path = [
        (0.2, 0),
        (1.0, 0),
        (1.5, 0),
        (2.0, 0),
        (2.4, 0),
        (2.8, 0),
        (2.0, 0),
        (0.0, 0),
        (1.2, 3),
        (1.8, 0),
        (2.2, 0),
        (2.6, 1),
    ]
    with opened(kind) as core:
        rested(core, rest)
        for out_px, shift_px in path:
            said = core.process(pressed(rest, out_px, shift_px))
            _, _, lost = core.markers()
            profile = mirror_profile.run(core.features().reshape(-1, 2), lost.ravel().astype(np.int64))
            row = core.profile()
            assert [*row.radial_q4.tolist(), *row[1:]] == profile.row()
            flow = mirror_profile.flow(core.features().reshape(-1, 2))
            gradient, sums = mirror_parts.run(flow, profile.center, saturations)
            assert np.array_equal(core.curl_free_flow_q4(), gradient)
            assert [*core.helmholtz()] == sums
            parts.append(sums[0])
            turned.append(sums[2])
            is_wrong = bool(said.flags & ~(OVER_RANGE if profile.lost <= 250 else 0))
            expected = mirror.run(profile, said.wrench_un.tolist(), not is_wrong, saturations)
            told_row = core.modelled()
            assert [*told_row[:12], *told_row[14:]] == expected
            depths.append(expected[3])
            told += expected[1] != 0
            assert core.modelled().hardness_validity == (VALID if expected[1] else NOT_MEASURED)
    assert told >= 4
    assert max(parts) > 16 * 30
    assert len(set(turned)) > 5
    assert max(depths) > 1000


def test_what_is_strange_or_too_deep_is_invalid_and_what_is_covered_is_not_told() -> None:
    rng, rest = np.random.default_rng(2), texture()
    kind = tables(rng, 63)
    with opened(kind, most_strange_q8=1) as core:
        rested(core, rest)
        for out_px in (1.0, 1.5, 2.0, 2.4):
            core.process(pressed(rest, out_px))
        assert core.modelled().is_strange
        assert core.modelled().hardness_validity == core.modelled().depth_validity == INVALID
    with opened(kind, most_failing_q12=1) as core:
        rested(core, rest)
        for out_px in (1.0, 1.5, 2.0, 2.4):
            core.process(pressed(rest, out_px))
        assert core.modelled().is_strange
        assert core.modelled().hardness_validity == INVALID
    deep = dict(kind)
    deep["contact_model.size_out"] = kind["contact_model.size_out"] * np.array([[8], [1], [1], [1]], np.int32)
    with opened(deep) as core:
        rested(core, rest)
        said = core.process(pressed(rest, 2.4))
        assert said.flags & OVER_RANGE
        assert core.modelled().depth_validity == INVALID
    with opened(kind) as core:
        rested(core, rest)
        covered = pressed(rest, 2.0)
        covered[:, 40:110] = 90
        said = core.process(covered)
        assert said.flags & MARKERS_LOST
        assert VALID not in said.wrench_validity


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("contact_model.sigma", np.zeros((2, 10), np.int32), "sigma"),
        ("contact_model.tanh", np.ones(513, np.int16), "tanh"),
        ("contact_model.kind_hidden", np.zeros((65, 19), np.int32), "kind_hidden"),
        ("contact_model.fails_out", np.zeros((1, 3), np.int32), "fails_out"),
        ("contact_model.planar_shift", np.array([0, 3], np.uint8), "planar_shift"),
        ("contact_model.mean", np.zeros(15, np.int16), "mean"),
    ],
)
def test_bad_tables_are_refused(name: str, value: npt.NDArray[np.generic], why: str) -> None:
    kind = tables(np.random.default_rng(2), 63) | {name: value}
    with pytest.raises(InputError, match=why):
        opened(kind)


def test_a_contact_model_without_a_wrench_is_refused() -> None:
    kind = {k: v for k, v in tables(np.random.default_rng(2), 63).items() if k.startswith("contact_model.")}
    with pytest.raises(InputError, match="without wrench"):
        opened(kind)
