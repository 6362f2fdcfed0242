"""The depth map of a texture's contact: made-up presses whose surface the flow tells, and how it is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board, find_board
from ruffini.estimators.contact_model import depth as contact_depth
from ruffini.estimators.contact_model.depth import (
    Frame,
    JudgedMap,
    depth_tables,
    fit_contact_depth,
    fit_linear,
    inputs_of_patches,
)
from ruffini.estimators.contact_model.flow import fall_of
from ruffini.estimators.contact_model.log import Press
from ruffini.estimators.contact_model.perceptron import run_tables, tanh_table
from ruffini.estimators.contact_model.profile import radial_um

Array = npt.NDArray[np.float64]
PX_PER_MM = 8.0
N_X, N_Y = 34, 26


def places_mm() -> Array:
    x, y = np.arange(N_X) - (N_X - 1) / 2, np.arange(N_Y) - (N_Y - 1) / 2
    return np.stack(np.meshgrid(x, y), axis=-1)


def press(board: Board, rng: np.random.Generator, shape: str, radius_mm: float) -> Press:
    """A dent that is a bell as wide as the object, which moves the patches down its slope."""
    depth, middle = np.linspace(0.2, 1.6, 8), rng.uniform(-2, 2, 2)
    away = places_mm() - middle
    bell = np.exp(-(((away**2).sum(axis=-1) / radius_mm**2) ** (1.0 if shape == "sphere" else 2.0)))
    slope = np.stack(np.gradient(bell)[::-1], axis=-1)
    flow = -slope[None] * depth[:, None, None, None] * PX_PER_MM
    flow = (flow + rng.normal(size=flow.shape) * 0.01).reshape(len(depth), -1)
    center = np.tile(middle * 1e3, (len(depth), 1))
    radial = np.round(radial_um(board, flow, center) * 16).astype(np.int64)
    size = np.sqrt((radial**2).sum(axis=1)).astype(np.int64)
    force = np.zeros((len(depth), 6))
    force[:, 2] = -8 * depth
    surface = (bell[None] * depth[:, None, None]).reshape(len(depth), -1)
    return Press(f"fit/{shape}{radius_mm}", "fit", shape, radius_mm, 60.0, flow, radial, size, size, center,
                 np.ones(len(depth), np.bool_), force, depth, depth, depth * 0 + 50.0, surface,
                 surface > 0.5 * depth[:, None])  # fmt: skip


@pytest.fixture(scope="module")
def board() -> Board:
    return find_board("contact-glitter")


@pytest.fixture(scope="module")
def presses(board: Board) -> list[Press]:
    rng = np.random.default_rng(4)
    return [press(board, rng, shape, radius) for shape in ("flat", "sphere") for radius in (4.0, 5.5, 6.5, 8.0)]


@pytest.fixture(scope="module")
def judged(board: Board, presses: list[Press]) -> JudgedMap:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ruffini.estimators.contact_model.perceptron.MAX_STEPS", 120)
        patch.setattr(contact_depth, "MOST_ROWS", 2000)
        found = fit_contact_depth(board, presses, [lambda p: p.radius_mm == 5.5], lambda _: None)
    assert found is not None
    return found


def test_the_map_of_sizes_that_were_not_fitted(judged: JudgedMap) -> None:
    assert set(judged.under) == {"flat", "sphere", "all"}
    assert 1e-3 < judged.under["all"] < 0.1  # mm, of a depth of 1.6
    assert judged.beside["all"] < 0.3


def test_a_mirrored_flow_has_the_mirrored_depth(board: Board, presses: list[Press]) -> None:
    linear = fit_linear(board, presses[:3])
    flow = presses[0].flow[-1].reshape(N_Y, N_X, 2)
    said = (linear @ flow.ravel()).reshape(N_Y, N_X)
    assert (linear @ (flow[:, ::-1] * [-1, 1]).ravel()).reshape(N_Y, N_X) == pytest.approx(said[:, ::-1], abs=1e-9)
    assert (linear @ (flow[::-1] * [1, -1]).ravel()).reshape(N_Y, N_X) == pytest.approx(said[::-1], abs=1e-9)


def test_a_log_that_does_not_know_the_surface_has_no_map(board: Board, presses: list[Press]) -> None:
    assert fit_contact_depth(board, [p.of_bench() for p in presses], [], lambda _: None) is None


def test_tables_say_what_the_fit_says(board: Board, presses: list[Press], judged: JudgedMap) -> None:
    tensors, metadata = depth_tables(board, judged, presses)
    assert int(metadata["contact_depth.sigma_um"]) == round(1e3 * judged.under["all"])
    assert metadata["contact_depth.linear.form"].endswith("/4")  # a quarter of the numbers, by symmetry
    one = presses[2]
    frame = Frame(one.flow[-1].reshape(N_Y, N_X, 2) * 125.0, one.size[-1] / 16, one.center_um[-1], np.zeros(18))
    steps = np.concatenate([contact_depth.PATCH_STEP, contact_depth.INPUT_STEP])
    raw = np.round(inputs_of_patches(board, judged.map.linear, frame) / steps).astype(np.int64)
    said = run_tables(tensors | {"t": tanh_table()}, "contact_depth.net", raw)[:, 0] / 4096
    assert said == pytest.approx(judged.map.net(raw * steps)[:, 0], abs=3e-3)


def test_the_density_falls_where_patches_go_apart(board: Board) -> None:
    fall = fall_of(board, places_mm() * 10.0)  # um, 1 % each way
    assert fall[5:-5, 5:-5] == pytest.approx(0.02)
    one = replace(press(board, np.random.default_rng(0), "flat", 6.0))
    spread = fall_of(board, one.flow[-1].reshape(N_Y, N_X, 2) * 125.0)
    assert 65536 * spread.max() > 500  # as the core has it: Q16
