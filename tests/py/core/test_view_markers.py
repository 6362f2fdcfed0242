"""Pins on the inside of a dome, seen by two eyes in one frame: followed in each, a blind eye spares the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import find_board
from ruffini.core import Pipeline
from ruffini.sim.optics.patterns.discs import pin_feet, pin_tips
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]
BOARD = find_board(Path(__file__).parents[3] / "boards" / "stereo-fingertip")
MARKERS_LOST, VIEW_LOST = 8, 16384
WIDTH_PX = 320


@pytest.fixture(scope="module")
def dome() -> Renderer:
    return Renderer.over_chart(BOARD, load_twin(BOARD))


def dent(dome: Renderer, depth_m: float) -> Array:
    """Metres; a dent 5 mm beside the top, as deep as that."""
    a, b = np.meshgrid(dome.node_a_mm, dome.node_b_mm)
    down = -depth_m * np.exp(-((a - 5) ** 2 + b**2) / 40)
    return np.asarray(np.stack([0.2 * down, 0.1 * down, down], axis=-1).reshape(-1, 3))


def seen(dome: Renderer, displacement: Array) -> Array:
    """Where each pin is in the frame, (2, n, 2) px."""
    pins = dome.twin.pins
    assert pins is not None
    surface = dome.surface.deform(displacement)
    tips = pin_tips(pins, surface, pin_feet(pins))
    places = [view.view.project(tips)[0] for view in dome.views]
    return np.array([place + np.array([WIDTH_PX * i, 0]) for i, place in enumerate(places)])


def pressed(dome: Renderer, pipeline: Pipeline, depth_m: float, blind: tuple[int, ...] = ()):
    frame = dome.image(dent(dome, depth_m), np.random.default_rng(2))
    for eye in blind:
        frame[:, eye * WIDTH_PX : (eye + 1) * WIDTH_PX] = 0
    return pipeline.process(frame)


@pytest.fixture
def pipeline(dome: Renderer):
    with Pipeline(BOARD) as path:
        for i in range(BOARD.pipeline.n_rest_frames):
            path.process(dome.image(dome.at_rest().reshape(-1, 3), np.random.default_rng(10 + i)))
        yield path


def errors(dome: Renderer, pipeline: Pipeline, depth_m: float) -> tuple[Array, npt.NDArray[np.uint8]]:
    """Of each pin's displacement, (2, n) px, and 1 for the lost ones."""
    rest, moved, lost = pipeline.markers()
    places = seen(dome, np.zeros_like(dent(dome, 0.0)))
    truth = seen(dome, dent(dome, depth_m)) - places
    out = np.zeros(lost.shape)
    for eye in range(2):
        apart = np.linalg.norm(rest[eye][:, None] - places[eye][None], axis=2)
        assert len(set(apart.argmin(axis=1))) == 292  # each pin once
        out[eye] = np.linalg.norm(moved[eye] - truth[eye][apart.argmin(axis=1)], axis=1)
    return out, lost


def test_every_pin_is_followed_in_both_eyes(dome: Renderer, pipeline: Pipeline) -> None:
    for depth in (0.5e-3, 1e-3, 2e-3):
        frame = pressed(dome, pipeline, depth)
        off, lost = errors(dome, pipeline, depth)
        assert frame.n_markers_at_rest == 2 * 292
        assert not lost.any()
        assert not frame.flags & (MARKERS_LOST | VIEW_LOST)
        assert np.sqrt((off**2).mean()) < 0.12
    assert np.abs(pipeline.markers()[1]).max() > 3


@pytest.mark.parametrize("eye", [0, 1])
def test_a_blind_eye_spares_the_other(dome: Renderer, pipeline: Pipeline, eye: int) -> None:
    frame = pressed(dome, pipeline, 1e-3, (eye,))
    off, lost = errors(dome, pipeline, 1e-3)
    assert frame.flags & VIEW_LOST
    assert not frame.flags & MARKERS_LOST
    assert lost[eye].all()
    assert not lost[1 - eye].any()
    assert np.sqrt((off[1 - eye] ** 2).mean()) < 0.12
    frame = pressed(dome, pipeline, 1e-3)
    assert not frame.flags & (VIEW_LOST | MARKERS_LOST)
    assert not errors(dome, pipeline, 1e-3)[1].any()


def test_two_blind_eyes_see_nothing(dome: Renderer, pipeline: Pipeline) -> None:
    assert pressed(dome, pipeline, 1e-3, (0, 1)).flags & MARKERS_LOST
