"""Markers at places of no lattice, as a twin prints them: identity, nodes, jumps, recovery."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board, find_board, parse_board
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.evaluate.warps import Warp
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
LATTICE = find_board(Path(__file__).parents[3] / "boards" / "gelslim")
KINDS = ["jittered", "random"]
STAGES = 'stages = ["difference", "markers", "displacement"]'


def places(kind: str) -> Array:
    """Micrometres from the pad's corner: the lattice shaken by up to 0.22 pitch, or dropped at random 0.75 mm apart."""
    rng = np.random.default_rng(7)
    if kind == "jittered":
        x, y = np.meshgrid(np.arange(1, 20), np.arange(1, 16))
        return np.asarray(np.stack([x.ravel(), y.ravel()], axis=1) * 1e3 + rng.uniform(-220, 220, (285, 2)))
    found: list[Array] = []
    while len(found) < 200:
        at = rng.uniform([700, 700], [19_300, 15_300])
        if all(np.linalg.norm(at - other) > 750 for other in found):
            found.append(at)
    return np.array(found)


@cache
def board(kind: str, *, is_listed: bool) -> Board:
    head, _, tail = LATTICE.text.partition("stages = [")
    text = head + STAGES + tail.partition("]")[2]
    at = places(kind).round().astype(int).tolist()
    n = (19, 15) if len(at) == 285 else (20, 10)
    listed = f"\nplaces_um = {at}" if is_listed else ""
    text = text.replace('polarity = "dark"', f'polarity = "dark"\nlayout = "scattered"{listed}')
    text = text.replace("n_x = 19", f"n_x = {n[0]}").replace("n_y = 15", f"n_y = {n[1]}")
    return parse_board(text, "scattered")


@cache
def renderer(kind: str) -> Renderer:
    return Renderer.over_chart(board(kind, is_listed=True), load_twin(LATTICE))


def shear(x_mm: Array, y_mm: Array, peak_mm: float) -> Array:
    """Millimetres, largest in the middle, without depth."""
    share = np.exp(-(x_mm**2 + y_mm**2) / 30)
    return np.stack([peak_mm * share, -0.5 * peak_mm * share, 0 * share], axis=-1)


def picture(kind: str, peak_mm: float, seed: int) -> Picture:
    drawn = renderer(kind)
    moved = shear(*np.meshgrid(drawn.node_a_mm, drawn.node_b_mm), peak_mm) * 1e-3
    return drawn.image(moved, np.random.default_rng(seed))


def rest(kind: str) -> Array:
    return np.mean([picture(kind, 0.0, seed).astype(float) for seed in range(4)], axis=0)


@pytest.mark.parametrize("is_listed", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_nodes_move_as_the_surface_does(kind: str, is_listed: bool) -> None:
    used = board(kind, is_listed=is_listed)
    grid, pad = used.grid, used.pad
    x, y = (
        np.linspace(-size / 2e3, size / 2e3, n) for size, n in ((pad.size_x_um, grid.n_x), (pad.size_y_um, grid.n_y))
    )
    with Pipeline(used) as pipeline:
        pipeline.set_rest(rest(kind))
        # Neither in small steps: 0.8 mm is most of a pitch, and comes at once.
        for seed, peak_mm in enumerate((0.3, 0.0, 0.8, -0.8, 0.1)):
            result = pipeline.process(picture(kind, peak_mm, 50 + seed))
            assert result.n_markers_at_rest >= 0.97 * len(places(kind))
            assert result.n_markers_lost <= 2
            error_um = pipeline.displacement_m()[..., :2] * 1e6 - shear(*np.meshgrid(x, y), peak_mm)[..., :2] * 1e3
            rms_um = np.sqrt((error_um[2:-2, 2:-2] ** 2).mean())
            assert 0.1 < rms_um < 3, (peak_mm, rms_um)


@pytest.mark.parametrize("kind", KINDS)
def test_identity_comes_back_after_frames_without_markers(kind: str) -> None:
    used = board(kind, is_listed=False)
    with Pipeline(used) as pipeline:
        pipeline.set_rest(rest(kind))
        moved, dark = picture(kind, 0.5, 60), np.zeros((240, 320, 3), np.uint8)
        pipeline.process(moved)
        rest_px, displacement, state = pipeline.markers()
        for _ in range(3):
            assert pipeline.process(dark).n_markers_lost == (state < 2).sum()
        assert pipeline.process(moved).n_markers_lost <= 2
        again_px, again, _ = pipeline.markers()
    assert np.array_equal(rest_px, again_px)
    np.testing.assert_array_equal(again[state == 0], displacement[state == 0])


@pytest.mark.parametrize("kind", KINDS)
def test_known_warps_of_one_picture(kind: str) -> None:
    """Fields of up to 8 px, half a pitch and more, from rest at once, with local gain and noise."""
    used, still = board(kind, is_listed=False), picture(kind, 0.0, 70)
    errors = []
    with Pipeline(used) as pipeline:
        for seed in range(6):
            rng = np.random.default_rng([3, seed])
            warp = Warp.random(rng, (320, 240), 8.4)
            pipeline.set_rest(still)
            pipeline.process(warp.render(still, rng))
            at, displacement, state = pipeline.markers()
            assert (state == 1).sum() <= 0.1 * at.shape[0] * at.shape[1]  # some leave the view
            errors.append((displacement - warp.forward(at))[state == 0])
    error = np.linalg.norm(np.concatenate(errors), axis=-1)
    assert np.sqrt((error**2).mean()) < 0.1
    assert error.max() < 0.5  # none on another's dot


def test_a_twin_prints_only_listed_places() -> None:
    with pytest.raises(InputError, match=r"give markers\.places_um"):
        Renderer.over_chart(board("jittered", is_listed=False), load_twin(LATTICE))
