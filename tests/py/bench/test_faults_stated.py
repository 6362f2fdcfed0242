"""The table of stated sigmas under faults: its arithmetic on errors that are known, and faults as large as they say."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from kept import kept

from ruffini.bench.coverage import Stated
from ruffini.bench.states import Recipe, State, Touch
from ruffini.boards import Board, find_board
from ruffini.estimators.operator.error_model import VARIANCE_RANGE, WRENCH_RANGES, node_places
from ruffini.estimators.operator.fit import board_slab, make_operator
from ruffini.fem.finite_strain import (
    EXACT,
    FITTED,
    FITTED_GROWTH,
    LINEAR_GROWTH,
    UNWEIGHTED_GROWTH,
    ErrorGrowth,
    Weights,
    error_growth,
)
from ruffini.fem.operators import Noise
from ruffini.fem.touches import UNMEASURED
from ruffini.sim.unit import PadError

ROOT = Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / "tests" / "bench"), str(ROOT / "tests" / "oracle")]
import faults_stated  # noqa: E402
import gels  # noqa: E402
import large_strain  # noqa: E402
from compare import kept_press  # noqa: E402
from presses import PRESSES  # noqa: E402

BOARD = find_board("gelslim")
SHAPE = (BOARD.grid.n_y, BOARD.grid.n_x, 3)
STEP_MM = (20 / 30, 16 / 24)
NOISE, N_FEW = Noise((5e-6, 5e-6, 20e-6)), 40


def contact() -> State:
    """A square of 7 nodes across in the middle, pressed and sheared."""
    force = np.zeros(SHAPE)
    force[9:16, 12:19] = (0.01, 0.0, -0.03)
    displacement = np.zeros(SHAPE)
    displacement[9:16, 12:19] = (5e-5, 0.0, -3e-4)
    return State(Recipe("square", (Touch("flat", 2, 0, 0),)), 0.6, force, displacement)


@pytest.fixture
def methods(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Says a force 20 % too large and a sigma of an eighth of it; with a hole, no sigma to speak of."""
    monkeypatch.setattr(faults_stated, "on_pad", lambda *_, **__: [contact()])
    monkeypatch.setattr(faults_stated, "drawn_modulus", lambda *_: 1.0)

    def stated(u: Any, *, is_fitted: bool, strain: str) -> Stated:
        calibrated.append(strain)
        force = 1.2 * contact().force
        sigma = np.where(np.isnan(u).any(), 1e-9, 0.125 * abs(force) + 1e-6)
        return Stated(force, sigma, np.diag([1.0] * 6))

    calibrated: list[str] = []
    places = node_places(board_slab(BOARD), BOARD.observed)
    return SimpleNamespace(board=BOARD, step_mm=STEP_MM, places=places, stated=stated, calibrated=calibrated)


def test_known_errors_and_sigmas_are_what_the_row_says(methods: Any) -> None:
    cells = faults_stated.judge(methods, faults_stated.FAULTS[0])
    total_mn = 0.2 * 49 * np.hypot(10, 30)
    assert cells == ["none", "0.20", "0.20", f"{total_mn:.0f} mN", "50, 100 %", "0, 100 %", "100, 100 %"]
    hole = faults_stated.judge(methods, faults_stated.FAULTS[2])
    assert hole[4:6] == ["50, 50 %", "0, 0 %"], "shear along y is right"
    row = f"| {' | '.join((*cells, '12345678', '2026-01-02'))} |"
    assert row.count("|") == len(faults_stated.COLUMNS) + 1
    document = (ROOT / "docs" / "results" / "accuracy.md").read_text()
    assert row in gels.with_row(document, row, faults_stated.SECTION, faults_stated.COLUMNS)


def test_pads_that_were_not_measured_are_off_either_way_and_as_stiff_as_the_board_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []
    monkeypatch.setattr(faults_stated, "on_pad", lambda *given: asked.append(given) or 200 * [contact()])
    pads = faults_stated.on_pads_as_stated("gelslim", PadError(thickness=1.05))
    assert asked == 2 * [("gelslim", PadError(thickness=1.05)), ("gelslim", PadError(thickness=0.95))]
    stiffer = np.array([state.force.sum() for state in pads]) / contact().force.sum()
    assert stiffer.std() == pytest.approx(BOARD.pad.stiffness_sigma_1e3 * 1e-3, rel=0.1)
    asked.clear()
    faults_stated.on_pads_as_stated("gelslim", PadError(modulus=1.05))
    assert asked == [("gelslim", pad) for pad in faults_stated.UNMEASURED_PADS], "nothing of them is known"
    off = [(pad.poisson - 1, pad.thickness - 1) for pad in faults_stated.UNMEASURED_PADS]
    assert np.std(off, axis=0) == pytest.approx((UNMEASURED.poisson, UNMEASURED.thickness))


def test_the_board_has_seen_the_noise_of_its_row() -> None:
    assert max(faults_stated.measured_share("gelslim", faults_stated.WHITE_NOISE) or (1,)) < 0.03
    assert min(faults_stated.measured_share("gelslim", faults_stated.CORRELATED_NOISE) or (0,)) > 0.1


def test_finite_strain_is_judged_on_its_own_contacts_alone(methods: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(faults_stated, "on_pad", lambda *given: asked.append(given) or [contact()])
    fault = next(one for one in faults_stated.FAULTS if one.strain == "finite")
    assert faults_stated.judge(methods, fault)[1] == "0.20"
    assert asked == [("gelslim", None, "finite")], "no pads whose material is off"
    assert set(methods.calibrated) == {"finite"}


def test_noise_correlates_with_the_next_node_as_the_row_says() -> None:
    noise = faults_stated.CORRELATED(np.zeros((300, 300, 3)), SimpleNamespace(), np.random.default_rng(1))
    assert (noise.std(axis=(0, 1)) * 1e6).tolist() == pytest.approx([5, 5, 20], rel=0.03)
    beside = np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2)
    assert beside == pytest.approx(faults_stated.BESIDE, abs=0.02)


def test_the_hole_is_under_the_contact_and_as_wide_as_the_row_says(methods: Any) -> None:
    state = contact()
    u = faults_stated.FAULTS[2].observe(state.displacement, methods, np.random.default_rng(1))
    missing = np.argwhere(np.isnan(u).any(axis=-1))
    assert state.force[tuple(np.round(missing.mean(axis=0)).astype(int))][2] < 0
    across_mm = np.ptp(missing, axis=0) * STEP_MM[0]
    assert (across_mm > faults_stated.HOLE_MM - 2 * STEP_MM[0]).all()
    assert (across_mm <= faults_stated.HOLE_MM).all()


def test_no_constant_of_the_depth_is_left_once_the_rim_is_zero(methods: Any) -> None:
    fault = next(one for one in faults_stated.FAULTS if "any constant" in one.name)
    u = contact().displacement
    found = fault.observe(u, methods, np.random.default_rng(3))
    deeper = fault.observe(u - [0, 0, 1e-4], methods, np.random.default_rng(3))
    np.testing.assert_allclose(deeper, found, atol=1e-15)
    rim = np.concatenate([found[0], found[-1], found[1:-1, 0], found[1:-1, -1]])  # of the outermost nodes
    assert abs(rim[:, 2].mean()) < 5e-6 < abs(u[..., 2].min())


def test_each_press_is_judged_with_the_weights_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Presses of the outside oracle; forces that are off by a fifth more ask for larger variances."""
    monkeypatch.setattr(large_strain, "make_operator", partial(kept, make_operator))
    monkeypatch.setattr(large_strain, "N_TOUCHES", N_FEW)
    solved = kept_press(ROOT / "tests" / "data" / "oracle" / "presses.npz", BOARD, PRESSES[0])
    presses = [[one.state] for one in solved or ()]
    fitted_on: list[list[float]] = []

    def weights_for(others: list[State]) -> Weights:
        fitted_on.append([state.depth_mm for state in others])
        return FITTED

    right = large_strain.growth(BOARD, presses, weights_for)
    leaking = [[replace(s, force=s.force + 0.05 * s.force[..., [2, 2, 2]] * [1, 0, 0]) for s in p] for p in presses]
    leaks = large_strain.growth(BOARD, leaking, lambda _: FITTED).crosstalk
    assert leaks == pytest.approx(0.05, rel=0.4), "of the pressure, along x alone"
    assert fitted_on == [[0.6, 1.0], [0.3, 1.0], [0.3, 0.6]]
    assert large_strain.growth(BOARD, presses, lambda _: EXACT).normal != right.normal
    off = [[replace(state, force=1.2 * state.force) for state in press] for press in presses]
    wrong = large_strain.growth(BOARD, off, lambda _: FITTED)
    assert min(right.shear, right.normal, right.wrench) > 0
    assert right.crosstalk < 0.01
    assert wrong.normal > 2 * right.normal
    assert wrong.wrench > 2 * right.wrench


@pytest.mark.parametrize(
    ("thickness_m", "wanted"), [(4e-3, FITTED_GROWTH), (8e-3, UNWEIGHTED_GROWTH)], ids=["as fitted", "thicker"]
)
def test_a_pad_unlike_those_of_the_fit_states_more(thickness_m: float, wanted: ErrorGrowth) -> None:
    found = error_growth(replace(board_slab(BOARD), thickness_m=thickness_m))
    assert vars(found) == pytest.approx(vars(wanted))
    assert all(vars(UNWEIGHTED_GROWTH)[name] >= fitted for name, fitted in vars(FITTED_GROWTH).items())
    assert UNWEIGHTED_GROWTH.wrench > FITTED_GROWTH.wrench


def cut(board: Board) -> Board:
    """Half of the board's pad, with nodes as far apart and the same margin outside the window."""
    pad, grid, window = board.pad, board.grid, board.window
    n_x, n_y = 21, 17
    x_um = round(pad.size_x_um * (n_x - 1) / (grid.n_x - 1))
    y_um = round(pad.size_y_um * (n_y - 1) / (grid.n_y - 1))
    seen = {
        "max_x_um": window.max_x_um - pad.size_x_um + x_um,
        "max_y_um": window.max_y_um - pad.size_y_um + y_um,
    }
    return board.model_copy(
        update={
            "pad": pad.model_copy(update={"size_x_um": x_um, "size_y_um": y_um}),
            "grid": grid.model_copy(update={"n_x": n_x, "n_y": n_y}),
            "window": window.model_copy(update=seen),
        }
    )


@pytest.mark.parametrize("name", ["gelslim", "gelsight-mini"])  # with fitted weights, with hardly any
def test_a_pad_at_finite_strain_states_more_than_a_linear_one(name: str) -> None:
    """The touches of the error model are those of a linear pad: every term of the variances grows."""
    board = cut(find_board(name))
    growth = error_growth(board_slab(board))
    made = {
        finite: kept(make_operator, board, method="support", noise=NOISE, n_touches=N_FEW, is_finite=finite).tensors
        for finite in (False, True)
    }
    for table in ("support.error_reported", "support.error_quiet", "support.error_local"):
        linear, finite = made[False][table], made[True][table]
        more = (growth.shear / LINEAR_GROWTH.shear, growth.normal / LINEAR_GROWTH.normal)
        for axes, factor in zip((0, 1), more, strict=True):
            at_least = VARIANCE_RANGE[0] if table != "support.error_local" else 0
            wanted = np.maximum(factor * linear[axes], at_least)
            is_raised = linear[axes] == at_least  # by the board's own limit
            np.testing.assert_allclose(finite[axes][~is_raised], wanted[~is_raised], rtol=0.01, atol=factor)
    linear, finite = (made[is_finite]["support.error_wrench"] for is_finite in (False, True))
    is_raised = linear <= np.array(WRENCH_RANGES)[:, :1]
    np.testing.assert_allclose(
        finite[~is_raised], np.sqrt(growth.wrench / LINEAR_GROWTH.wrench) * linear[~is_raised], rtol=0.01, atol=2
    )
    assert is_raised.mean() < 0.25
    assert made[True]["support.error_crosstalk"] >= round(growth.crosstalk * (1 << 20))
    assert min(growth.shear / LINEAR_GROWTH.shear, growth.normal / LINEAR_GROWTH.normal) > 1
