"""The stage depth_moments and the wrench of its features are the mirror's, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from mirror.board import read_board
from mirror.depth_moments import features
from mirror.feature_wrench import FeatureWrench
from mirror.fixed import Saturations
from odd_boards import small_board
from test_frame_path import camera_tables, dent, photometric_tables
from test_stages import render
from test_targets import tables

from ruffini.boards import parse_board
from ruffini.calibrate.container import CalibrationFile, base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError

N_REST, N_FEATURES = 3, 8
STAGES = '["difference", "photometric", "poisson", "depth_moments", "feature_wrench"]'


def board_text(step: int) -> str:
    text = small_board(width=66, height=44, step=step)
    return text[: text.index("stages = ")] + f"stages = {STAGES}\n"


def calibration(text: str, *, has_camera_map: bool = False, **metadata: str) -> CalibrationFile:
    rng = np.random.default_rng(5)
    camera, of_camera = camera_tables(read_board(text), rng) if has_camera_map else ({}, {})
    if has_camera_map:  # a cell sees another length of the pad than through the board's own pinhole
        of_camera["camera.standoff_um"] = str(read_board(text)["camera"]["standoff_um"] * 12 // 10)
    board = parse_board(text.encode(), "small")
    return pack(
        {**tables(rng, N_FEATURES), **photometric_tables(rng), **camera},
        {**base_metadata(board), "wrench.features": "depth", **of_camera, **metadata},
    )


@pytest.mark.parametrize(("step", "has_camera_map"), [(1, False), (2, False), (2, True)])
def test_features_and_wrench_are_those_of_the_mirror(step: int, has_camera_map: bool) -> None:
    text = board_text(step)
    board = read_board(text)
    file = calibration(text, has_camera_map=has_camera_map)
    seen_from = read_board(text)
    if has_camera_map:
        seen_from["camera"] |= {k: int(file.metadata[f"camera.{k}"]) for k in ("focal_mpx", "standoff_um")}
    wrench, saturations, volumes = FeatureWrench(file.tensors), Saturations(), []
    with Pipeline(parse_board(text.encode(), "small"), file.data) as core:
        for _ in range(N_REST):
            core.process(np.clip(np.round(render(board, np.random.default_rng(7), 0.0)), 0, 255).astype(np.uint8))
        for t in range(9):
            moved = render(board, np.random.default_rng(100 + t), 0.0) * (1 + dent(board, t))
            said = core.process(np.clip(np.round(moved), 0, 255).astype(np.uint8), capture_s=0.03 * t)
            expected = features(seen_from, core.raw("depth").astype(np.int64))
            assert core.features().tolist() == expected.tolist(), t
            stated = wrench.run(expected.tolist(), round(30_000 * t) + (t == 0), saturations)
            assert said.wrench_un.tolist() == stated.wrench, t
            volumes.append(int(expected[0]))
    assert volumes[-1] > 4 * volumes[1] > 0


def test_depth_that_is_for_display_makes_no_features() -> None:
    """Colours of other optics: neither moments nor a wrench."""
    text = board_text(2)
    with Pipeline(parse_board(text.encode(), "small"), calibration(text, optics="another").data) as core:
        for _ in range(N_REST + 1):
            frame = np.clip(np.round(render(read_board(text), np.random.default_rng(7), 0.0)), 0, 255)
            core.process(frame.astype(np.uint8))
        assert core.raw("depth").size
        for name in ("features", "wrench"):
            with pytest.raises(InputError):
                core.raw(name)


def test_moments_and_a_grid_are_not_mixed() -> None:
    text = board_text(2).replace('"photometric"', '"picture_features", "photometric"')
    section = "[picture_features]\ncorners_px = [[0, 0], [65, 0], [65, 43], [0, 43]]\nn_x = 3\nn_y = 2\n"
    text = text.replace("[depth]\n", f"{section}[depth]\n")
    with pytest.raises(InputError, match="picture_features and depth_moments both write the slot features"):
        parse_board(text.encode(), "small")
