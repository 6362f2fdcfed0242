"""A small board with a texture, pictures of it under a press, and tables of any weights for the contact model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from odd_boards import small_board
from scipy.ndimage import gaussian_filter, map_coordinates

from ruffini.core import Pipeline
from ruffini.estimators.contact_model.perceptron import tanh_table

Picture = npt.NDArray[np.uint8]
Tensors = dict[str, npt.NDArray[np.generic]]
WIDTH, HEIGHT, N_REST = 150, 113, 3
MIDDLE = np.array([77.0, 55.0])
NUMBERS = {"least_fall_q16": 2000, "least_force_un": 90_000, "depth_sigma_um": 77, "moment_per_flow": 4321,
           "most_strange_q8": 1 << 24, "most_failing_q12": 1 << 16}  # fmt: skip


def board_text(last: str = "helmholtz") -> str:
    """Patches of an odd lattice over an odd picture; rings that leave it on one side before the other."""
    text = small_board(width=WIDTH, height=HEIGHT, step=1).replace('"dark"', '"texture"')
    for old, new in (("center_x_mpx = 33210", "center_x_mpx = 74610"), ("center_y_mpx = 20777", "center_y_mpx = 56277"),
                     ("focal_mpx = 101300", "focal_mpx = 201300"), ("n_x = 5\nn_y = 3\n", "n_x = 9\nn_y = 7\n"),
                     ("pitch_x_um = 733\npitch_y_um = 751", "pitch_x_um = 401\npitch_y_um = 383"),
                     ("first_x_um = 501\nfirst_y_um = 633", "first_x_um = 381\nfirst_y_um = 362"),
                     ("threshold_1e3 = 137", "threshold_1e3 = 600")):  # fmt: skip
        assert old in text, old
        text = text.replace(old, new)
    stages = f'["difference", "markers", "feature_wrench", "contact_model", "{last}"]'
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


def rested(core: Pipeline, rest: npt.NDArray[np.float64]) -> None:
    for _ in range(N_REST):
        core.process(pressed(rest, 0.0))
