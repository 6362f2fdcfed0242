"""Boards whose depth comes from the markers: the core against the mirror bit for bit, and what it says of validity."""

from __future__ import annotations

import numpy as np
import pytest
from kept import kept
from mirror.board import Board, read_board
from mirror.displacement import displacement
from mirror.dot_templates import DotTemplates
from mirror.dots import detect_dots
from mirror.fixed import Saturations
from mirror.light import grey, grey_of_rest, rest_image
from mirror.marker_depth import with_depth
from mirror.markers import Lattice
from mirror.program import Program
from mirror.solve import linear_force
from odd_boards import small_board
from test_frame_path import camera_tables
from test_stages import render

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import RuffiniError
from ruffini.estimators.operator.fit import OperatorKind, make_operator
from ruffini.fem.operators import Noise

N_REST = 3
NOT_MEASURED, VALID, INVALID = 0, 1, 3  # of Validity
UNCALIBRATED_Z = 4
STAGES = '["difference", "markers", "displacement", "operator", "wrench", "contacts"]'


def board_text() -> str:
    text = small_board(width=66, height=44, step=2)
    text = text[: text.index("stages = ")] + f"stages = {STAGES}\n"
    return text.replace("[depth]\n", '[depth]\nsource = "markers"\n')


@pytest.fixture(scope="module")
def kind() -> OperatorKind:
    return kept(make_operator, parse_board(board_text(), "small"), method="optimal", noise=Noise((5e-6, 5e-6, 2e-5)))


def frame_of(board: Board, seed: int, motion: float) -> np.ndarray:
    picture = render(board, np.random.default_rng(seed), motion)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


def test_displacement_and_force_are_the_mirrors(kind: OperatorKind) -> None:
    text = board_text()
    typed, board = parse_board(text, "small"), read_board(text)
    file = pack(kind.tensors, {**base_metadata(typed), **kind.metadata})
    program, operator = (Program(file.tensors, file.metadata, name) for name in ("marker_depth", "operator"))
    rest = np.stack([frame_of(board, 7, 0.0) for _ in range(N_REST)])
    lattice, saturations = Lattice(board), Saturations()
    deepest = 0
    with Pipeline(typed, file.data) as core:
        for frame in rest:
            core.process(frame)
        lattice.learn(detect_dots(board, grey_of_rest(rest_image(rest))))
        templates = DotTemplates(board, rest_image(rest), lattice.rows)
        for t in range(8):
            frame = frame_of(board, 100 + t, 0.08 * t)
            result = core.process(frame)
            lattice.assign(detect_dots(board, grey(frame)))
            lattice.finish(templates.refine(frame, lattice.rows))
            seen = displacement(board, lattice.rows.copy(), None, saturations)
            u = with_depth(board, program, seen, saturations)
            force = linear_force(operator, u.reshape(-1, 3), saturations)
            assert np.array_equal(core.raw("displacement"), u), t
            assert np.array_equal(core.raw("force").reshape(-1, 3), force.reshape(-1, 3)), t
            assert result.saturations == saturations.count
            assert result.force_z_validity in (VALID, INVALID)
            assert result.depth_validity == NOT_MEASURED  # of the picture's grid; nodes have theirs
            assert not result.flags & UNCALIBRATED_Z
            deepest = max(deepest, int(np.abs(u[..., 2]).max()))
    assert deepest > 80, deepest  # 10 um: the motion was one that the estimate answers


def test_without_the_table_nothing_is_said_of_z(kind: OperatorKind) -> None:
    typed = parse_board(board_text(), "small")
    tables = {k: v for k, v in kind.tensors.items() if not k.startswith("marker_depth.")}
    file = pack(tables, {**base_metadata(typed), **kind.metadata})
    board = read_board(board_text())
    with Pipeline(typed, file.data) as core:
        for seed in range(N_REST + 1):
            result = core.process(frame_of(board, seed, 0.0))
    assert result.force_z_validity == NOT_MEASURED
    assert result.flags & UNCALIBRATED_Z


def test_a_camera_map_beside_it_is_refused(kind: OperatorKind) -> None:
    typed, board = parse_board(board_text(), "small"), read_board(board_text())
    camera, metadata = camera_tables(board, np.random.default_rng(1))
    file = pack({**kind.tensors, **camera}, {**base_metadata(typed), **kind.metadata, **metadata})
    with pytest.raises(RuffiniError, match="camera"), Pipeline(typed, file.data):
        pass


@pytest.mark.parametrize("seed", range(3))
def test_hostile_tables_never_overflow(kind: OperatorKind, seed: int) -> None:
    """Whatever the loader lets through: the mirror's integers are unbounded, so a wrap would show."""
    text = board_text()
    typed, board = parse_board(text, "small"), read_board(text)
    rng = np.random.default_rng(seed)
    tables, metadata = dict(kind.tensors), dict(kind.metadata)
    entry, shift = tables["marker_depth.entry"], tables["marker_depth.shift"]
    tables["marker_depth.entry"] = rng.integers(-16383, 16384, entry.shape).astype(np.int16)
    tables["marker_depth.shift"] = rng.integers(0, 26, shift.shape).astype(np.uint8)
    metadata["marker_depth.out_shift"] = str(rng.integers(1, 40))
    file = pack(tables, {**base_metadata(typed), **metadata})
    program, saturations = Program(file.tensors, file.metadata, "marker_depth"), Saturations()
    rest = np.stack([frame_of(board, 7, 0.0) for _ in range(N_REST)])
    lattice = Lattice(board)
    with Pipeline(typed, file.data) as core:
        for frame in rest:
            core.process(frame)
        lattice.learn(detect_dots(board, grey_of_rest(rest_image(rest))))
        templates = DotTemplates(board, rest_image(rest), lattice.rows)
        frame = frame_of(board, 100, 0.4)
        core.process(frame)
        lattice.assign(detect_dots(board, grey(frame)))
        lattice.finish(templates.refine(frame, lattice.rows))
        u = with_depth(board, program, displacement(board, lattice.rows, None, saturations), saturations)
        assert np.array_equal(core.raw("displacement"), u)
    assert saturations.count > 0
