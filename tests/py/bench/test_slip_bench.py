"""The slip benchmark's arithmetic on runs whose outcome is known, and one contact through the whole of it."""

from __future__ import annotations

import numpy as np
import pytest
from kept import kept

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.slip import JUDGED, Case, Run, Scores, Watched, default_calibration, simulate, watch
from ruffini.boards import Board, find_board
from ruffini.core.pipeline import ContactRow, Pipeline
from ruffini.sim.settings import MeshSettings, load_twin
from ruffini.sim.unit import TwinUnit

CASE = Case("sphere", 5, 0.5, 0.5, 0, 0, 0)


def run_of(share: list[float], case: Case = CASE) -> Run:
    """Four nodes touched; the share of them that slips as told; shear grows by 0.1 N a frame."""
    n = len(share)
    touched = np.zeros((n, 3, 4))
    touched[:, 1, :] = 1.0
    slipping = np.zeros_like(touched)
    for t, s in enumerate(share):
        slipping[t, 1, : round(4 * s)] = 1.0
    return Run(case, np.zeros((n, 3, 4, 3)), touched, slipping, np.array(share), 0.1 * np.arange(1, n + 1), 0)


def said(states: list[int], friction_1e3: int = 0, sigma_1e3: int = 0, nodes: np.ndarray | None = None) -> Watched:
    rows = [
        ContactRow(9, 9, 0, 0, 0, 0, -9, -9, s, 300, friction_1e3 if s > 1 else 0, sigma_1e3, 500, 0, 0) for s in states
    ]
    return Watched(list(rows), np.zeros((len(states), 3, 4), np.uint8) if nodes is None else nodes)


SHARE = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0]


def test_a_slip_that_is_foreseen_has_its_lead_and_load() -> None:
    scores = Scores()
    scores.add(run_of(SHARE), said([1, 1, 1, 2, 2, 3, 3], 450, 60))
    report = scores.report(10.0)
    assert (report["detected_before"], report["sliding_runs"], report["slides_seen"]) == (1, 1, 1)
    assert report["lead_ms"] == {"mean": 20.0, "shortest": 20.0}
    assert report["alarm_at_load"]["mean"] == pytest.approx(0.4 / 0.6)
    assert report["slides_after_ms"] == 0.0
    assert report["false_alarm_frames"] == 0
    assert report["friction_error_before"]["mean"] == pytest.approx(-0.1)
    assert report["friction_within_sigma"] == 1.0
    assert report["share_error"]["mean"] == pytest.approx(0.5 - np.mean(SHARE))


def test_a_late_alarm_is_no_detection_and_an_early_one_is_false() -> None:
    late = Scores()
    late.add(run_of(SHARE), said([1, 1, 1, 1, 1, 1, 3]))
    assert (late.n_detected, late.slide_frames) == (0, [1])
    early = Scores()
    early.add(run_of(SHARE), said([1, 2, 1, 1, 1, 1, 1]))
    assert (early.n_detected, early.n_false_frames, early.n_sticking_frames) == (0, 1, 2)


def test_a_run_without_slip_is_calm_until_something_is_said() -> None:
    scores = Scores()
    calm = run_of([0.0, 0.1, 0.2, 0.1])
    scores.add(calm, said([0, 1, 1, 1]))
    assert (scores.n_calm, scores.n_calm_alarms) == (1, 0)
    scores.add(calm, said([0, 1, 2, 1]))
    assert (scores.n_calm, scores.n_calm_alarms, scores.n_sliding) == (2, 1, 0)


def test_nodes_are_counted_inside_the_contact_only() -> None:
    nodes = np.zeros((7, 3, 4), np.uint8)
    nodes[:, 1, :] = 1
    nodes[5, :, :] = 2  # all of row 1 slips then, the other rows are not touched
    scores = Scores()
    scores.add(run_of(SHARE), said([1] * 7, nodes=nodes))
    slipping, found, sticking, called = scores.nodes
    assert (found, called) == (4, 0)
    assert slipping + sticking == 28


def first_run(board: Board) -> Run:
    mesh = MeshSettings(cells_x=16, cells_y=13)
    return simulate(TwinUnit.build(board, twin=load_twin(board).model_copy(update={"mesh": mesh})), JUDGED[0])


def test_the_board_foresees_that_a_ball_slides() -> None:
    board = find_board("gelslim")
    run = kept(first_run, board)
    assert run.gross is not None
    with Pipeline(board, kept(default_calibration, board)) as pipeline:
        noisy = watch(pipeline, run, Disturbance(white_um=WHITE_UM), np.random.default_rng(1))
        again = watch(pipeline, run, Disturbance(white_um=WHITE_UM), np.random.default_rng(1))
    assert noisy.contact == again.contact  # the run before leaves nothing behind
    scores = Scores()
    scores.add(run, noisy)
    assert scores.n_detected == 1
    assert scores.n_false_frames == 0
    assert scores.lead_frames[0] >= 3
    assert abs(scores.friction_late[-1]) < 0.06
