"""A screw, a coin and a key on the pad: their shapes, and the errors and pictures of what the board makes of them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image
from typer.testing import CliRunner

from ruffini.bench import fine_objects, fine_objects_picture
from ruffini.bench.fine_objects import METHODS, coin, key, screw
from ruffini.bench.resolution import Nodes, Observer
from ruffini.bench.states import Recipe, State
from ruffini.boards import Board, find_board
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.sim.contact import Pose
from ruffini.sim.unit import TwinUnit

ROOT = Path(__file__).parents[3]
STEP_MM = 0.01


def test_a_thread_has_the_pitch_the_depth_and_the_hand_of_its_standard() -> None:
    x = np.arange(-3.5, 3.5, STEP_MM)  # four pitches
    along = screw(x, np.zeros_like(x))
    assert np.ptp(along) == pytest.approx(0.541 * 1.75, rel=0.01)  # ISO 68-1: 5/8 of the sharp triangle
    period = round(1.75 / STEP_MM)
    np.testing.assert_allclose(along[period:], along[:-period], atol=1e-9)
    crests, roots = (along < 1e-9).mean(), (along > np.max(along) - 1e-9).mean()
    assert (crests, roots) == (pytest.approx(1 / 8, abs=0.02), pytest.approx(1 / 4, abs=0.02))
    # x, y and z (from the pad to the object) are right-handed, and so is the thread: at its lower side x grows with y.
    y = 3.0
    ahead = 1.75 * np.arcsin(y / 6) / (2 * np.pi)
    at_y = screw(x, np.full_like(x, y))
    assert screw(np.array([ahead]), np.array([y]))[0] == pytest.approx(at_y.min(), abs=1e-9)
    assert screw(np.array([-ahead]), np.array([y]))[0] > at_y.min() + 1e-3


def test_of_a_coin_the_rim_and_the_digit_stand_out() -> None:
    rim, face, digit = coin(np.array([5.0, 3.0, -1.5]), np.array([0.0, 0.0, -1.5]))
    assert (rim, face, digit) == (0, 0.15, 0)
    assert coin(np.array([6.5]), np.array([0.0]))[0] == pytest.approx(0.15 + 1.0)  # a side of 45 degrees


def test_of_a_key_the_cuts_are_six_depths_and_the_back_is_straight() -> None:
    middles = -7.5 + 2.5 * (np.arange(6) + 0.5)
    y = np.arange(-2, 3.5, STEP_MM)
    edges = [y[np.flatnonzero(key(np.full_like(y, x), y) <= 1e-9)[-1]] for x in middles]
    np.testing.assert_allclose(edges, 3.0 - np.array((0.6, 1.4, 0.9, 1.6, 0.7, 1.2)), atol=2 * STEP_MM)
    x = np.linspace(-7, 7, 50)
    assert np.ptp(key(x, np.full_like(x, -2.9))) == 0
    assert key(np.array([0.0]), np.array([-1.2]))[0] == pytest.approx(0.5)


@pytest.fixture
def coarse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Board:
    """A gelslim with half of its nodes along each way, before a coarse truth in few steps."""
    folder = tmp_path / "gelslim"
    shutil.copytree(ROOT / "boards" / "gelslim", folder)
    board = (folder / "board.toml").read_text()
    assert "n_x = 31\nn_y = 25\n" in board
    (folder / "board.toml").write_text(board.replace("n_x = 31\nn_y = 25\n", "n_x = 16\nn_y = 13\n"))
    (folder / "twin.toml").write_text((folder / "twin.toml").read_text() + "[mesh]\ncells_x = 12\ncells_y = 10\n")
    for name, value in {"NODE_MM": 1.0, "STEP_MM": 0.5, "FORCE_N": 1.0, "TURN": 0.1, "N_TURNS": 2}.items():
        monkeypatch.setattr(fine_objects, name, value)
    return find_board(str(folder))


def test_an_object_goes_down_until_it_carries_its_force_and_then_turns(
    coarse: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = fine_objects.fine_unit(coarse)
    seen = list(fine_objects.moments(unit, "key"))
    turns = [moment.pose.turn_rad for moment in seen]
    *rising, first, second = turns
    assert not any(rising)
    assert (first, second) == (pytest.approx(fine_objects.TURN / 2), fine_objects.TURN)
    pressing = [-moment.state.force[..., 2].sum() for moment in seen[: len(rising)]]
    assert pressing[-1] >= 1.0
    assert all(force < 1.0 for force in pressing[:-1])
    torque = [_torque(coarse, moment.state.force) for moment in seen]
    assert torque[-1] > 5 * abs(torque[len(rising) - 1])  # the pad is turned with it
    for moment in seen:
        area_m2 = fine_objects.hat_areas(unit.model).reshape(moment.pressure_pa.shape)
        assert (moment.pressure_pa * area_m2).sum() == pytest.approx(-moment.state.force[..., 2].sum())
    monkeypatch.setattr(fine_objects, "FORCE_N", 1e3)
    monkeypatch.setattr(fine_objects, "MOST_STEPS", 1)
    with pytest.raises(InputError, match=r"the key carries less than 1000 N 0\.5 mm deep"):
        list(fine_objects.moments(unit, "key"))


def _torque(board: Board, force: npt.NDArray[np.float64]) -> float:
    """About the object's axis, N m."""
    nodes = Nodes.of(board)
    x, y = np.meshgrid(nodes.x_mm - fine_objects.PLACE_MM[0], nodes.y_mm - fine_objects.PLACE_MM[1])
    return float((x * force[..., 1] - y * force[..., 0]).sum() * 1e-3)


@pytest.mark.parametrize(("name", "cells"), [("gelslim", (30, 24)), ("gelslim-dense", (32, 26))])
def test_the_truth_is_never_coarser_than_the_boards_twin(
    name: str, cells: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(TwinUnit, "build", lambda board, *, twin, progress: asked.append(twin.mesh))
    fine_objects.fine_unit(find_board(name))
    assert [(mesh.cells_x, mesh.cells_y) for mesh in asked] == [cells]


def test_of_noise_alone_plain_inverse_fem_makes_forces_everywhere_and_the_board_does_not(coarse: Board) -> None:
    """Which of the two is which."""
    observer = Observer(coarse)
    try:
        noise = np.random.default_rng(1).normal(scale=5e-6, size=(13, 16, 3))
        found = {name: estimate(noise) for name, estimate in observer.vectors().items()}
        normal = {name: estimate(noise) for name, estimate in observer.estimates().items()}
    finally:
        observer.close()
    is_force = {name: (force != 0).any(axis=2).mean() for name, force in found.items()}
    assert 0 < is_force["default"] < 0.5
    assert is_force["raw"] == 1
    assert all(np.array_equal(found[name][..., 2], normal[name]) for name in METHODS)


def test_a_title_says_how_far_a_field_is_off(coarse: Board) -> None:
    true = np.zeros((13, 16, 3))
    true[5, 6] = (0.5, 0.0, -2.0)
    state = State(Recipe("key", ()), 0.5, true, true)
    moment = fine_objects.Moment(state, np.zeros((1, 1)), Pose(0, 0, 0))
    measured = fine_objects.Measured(moment, true, {"raw": true * (0.8, 0.8, 0.75)})
    assert fine_objects_picture._title(coarse, measured, "raw") == "iFEM raw, 1.50 N: off by 0.20, 0.25"


def test_the_verb_prints_the_errors_and_draws_each_object(coarse: Board, tmp_path: Path) -> None:
    """What the board makes of a coarse truth is near to it."""
    folder = coarse.folder
    words = ["bench", "ifem", "--board", str(folder), "--only", "objects", "--out", str(tmp_path / "o.png"), "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0
    result = json.loads(done.stdout)
    assert [Path(path).name for path in result["pictures"]] == ["o.png", "o-screw.webp", "o-coin.webp", "o-key.webp"]
    for name, methods in result["objects"].items():
        assert 0 < methods["default"]["normal"] < 0.4, name
        assert methods["default"]["resultant_n"] < 0.3, name  # of 1 N and more
        with Image.open(tmp_path / f"o-{name}.webp") as animation:
            assert animation.n_frames >= 2  # the last one is held
    text = fine_objects.table(result)
    assert all(part in text for part in ("screw, default", "key, raw", "SIMULATED"))


@pytest.mark.parametrize("name", fine_objects.OBJECTS)
def test_their_maps_reach_beyond_what_can_touch(name: str) -> None:
    indenter = fine_objects.indenter_of(name)
    half_x, half_y = (half * 1e-3 for half in fine_objects.HALF_SIZE_MM[name])
    assert indenter.height(0.0, half_y) > 0.9e-3
    assert name == "screw" or indenter.height(half_x, 0.0) > 0.45e-3


def test_what_cannot_be_measured_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="measures no field of forces"):
        fine_objects.measure(find_board("ftouch"))
    for least_mm, said in (((17.0, 16.5), r"17 x 16\.5"), ((20.5, 13.0), r"20\.5 x 13")):
        monkeypatch.setattr(fine_objects, "LEAST_PAD_MM", least_mm)
        with pytest.raises(InputError, match=f"has a pad of 20 x 16 mm: the objects need {said} mm"):
            fine_objects.measure(find_board("gelslim"))
    words = ["bench", "ifem", "--board", "gelslim", "--only", "objects"]
    for more, said in ((["--quick"], "no quick form"), (["--out", "o.jpg"], "give a .png")):
        done = CliRunner().invoke(app, [*words, *more])
        assert done.exit_code != 0
        assert said in str(done.exception)
