"""A ball's cap tells the depth's scale, a weight the force's; what is allowed is what the report said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.errors import InputError
from ruffini.rig.check import Checked, allowed_n, ball_radius_m, check_weight

RADIUS_M, DEPTH_M = 3e-3, 7e-4


@pytest.fixture(scope="module")
def board() -> Board:
    return parse_board((Path(__file__).parents[2] / "data" / "boards" / "base.toml").read_text(), "test")


def dent(board: Board, depth_m: float) -> np.ndarray:
    """A ball in the pad: its cap inside the contact, a slope beside it."""
    x = np.linspace(-0.5, 0.5, board.grid.n_x) * board.pad.size_x_um * 1e-6 - 4e-4
    y = np.linspace(-0.5, 0.5, board.grid.n_y)[:, None] * board.pad.size_y_um * 1e-6 + 3e-4
    r = np.hypot(x, y)
    contact_m = np.sqrt(RADIUS_M * depth_m)
    cap = RADIUS_M - depth_m - np.sqrt(np.maximum(RADIUS_M**2 - np.minimum(r, contact_m) ** 2, 0))
    z = np.where(r < contact_m, cap, cap * np.exp(-(r - contact_m) / contact_m))
    return np.stack([0 * z, 0 * z, z], axis=-1)


def test_the_balls_radius_is_found_and_a_wrong_depth_scale_shows(board: Board) -> None:
    rng = np.random.default_rng(1)
    u = dent(board, DEPTH_M)
    u[..., 2] += rng.normal(0, 3e-6, u.shape[:2])
    assert ball_radius_m(board, u, 2.5e-3) == pytest.approx(RADIUS_M, rel=0.06)
    u[..., 2] *= 0.75
    assert ball_radius_m(board, u, 2.5e-3) > 1.2 * RADIUS_M
    with pytest.raises(InputError, match="press deeper, or take a larger ball"):
        ball_radius_m(board, dent(board, 5e-5), 3e-3)


def test_what_is_allowed_is_what_the_report_said(board: Board) -> None:
    report = {"stages": {"material": {"left_out": {"force_p95_n": 0.03}}}}
    metadata = {**container.base_metadata(board), "residuals": json.dumps(report)}
    file = container.pack({"relaxation.part": np.ones(1, np.int32)}, metadata)
    assert allowed_n(file, 1.0) == pytest.approx(0.06)
    assert allowed_n(None, 1.0) == pytest.approx(0.07)
    assert allowed_n(container.pack(file.tensors, container.base_metadata(board)), 2.0) == pytest.approx(0.12)
    assert Checked("x", 1.0, 1.06, 0.07, "N").ok
    assert not Checked("x", 1.0, 0.92, 0.07, "N").ok


def test_what_a_weight_on_a_fingertip_may_be_off_is_three_times_the_rms_of_its_presses_left_out(board: Board) -> None:
    report = {"stages": {"fingertip": {"mean_error_of_presses_left_out": {"both": {"force_n": 0.02}}}}}
    file = container.pack(
        {"fingertip.rest": np.ones(1, np.int32)},
        {**container.base_metadata(board), "kinds": "fingertip", "residuals": json.dumps(report)},
    )
    assert allowed_n(file, 0.5) == pytest.approx(0.075)


class Person:
    """Puts the weight there when asked, and takes it away."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def confirm(self, text: str) -> None:
        self.told.append(text)


class Stream:
    def __init__(self, force_n: float) -> None:
        self._force_n = force_n

    def since(self, _: float):
        frame = type("Frame", (), {"wrench": np.array([0, 0, -self._force_n, 0, 0, 0])})
        return type("Window", (), {"frames": [frame] * 4})


@pytest.mark.parametrize(("force_n", "is_ok"), [(0.97, True), (0.80, False), (float("nan"), None)])
def test_a_weight_is_asked_for_and_compared(force_n: float, is_ok: bool | None) -> None:
    person = Person()
    bench = type("Bench", (), {"person": person, "weight": None, "stream": Stream(force_n),
                               "hold": staticmethod(lambda begun: begun + 0.1)})()  # fmt: skip
    if is_ok is None:
        with pytest.raises(InputError, match="flash a calibration first"):
            check_weight(bench, 100, None)
        return
    done = check_weight(bench, 100, None)
    assert done.wanted == pytest.approx(0.980665)
    assert done.ok == is_ok
    assert person.told[0].startswith("put 100 g at")
    assert person.told[1] == "take it away"
