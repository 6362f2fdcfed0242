"""A fingertip's calibration: eyes, turns, labels, and a small fit that the core then says alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.core import Pipeline
from ruffini.core.pipeline import TipRow
from ruffini.errors import InputError
from ruffini.estimators.fingertip import fit as fingertip
from ruffini.estimators.fingertip.field import field_of
from ruffini.estimators.fingertip.fit import Bench, Eyes, ModeFit, Pins, Scale, fit_fingertip, labels_of, told_by
from ruffini.estimators.fingertip.presses import FACES, Press, face_area, read_press, told_of
from ruffini.estimators.fingertip.rim import LEAST_PX
from ruffini.estimators.fingertip.tables import calibration
from ruffini.estimators.fingertip.turns import Samples, turned
from ruffini.sim.indenters.outline import OUTLINES
from ruffini.sim.optics.patterns.discs import pin_feet, pin_tips
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pose import Pose
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]
BOARD = find_board(Path(__file__).parents[3] / "boards" / "stereo-fingertip")
EYES = Eyes.of(BOARD, 10.0)
DENT_MM2 = 40.0
fingertip_mode = fingertip._fit_mode
NAMES = ("force_un", "way_um", "x_um", "y_um", "roll_urad", "pitch_urad")


@pytest.fixture(scope="module")
def dome() -> Renderer:
    return Renderer.over_chart(BOARD, load_twin(BOARD))


@pytest.fixture(scope="module")
def tips(dome: Renderer) -> Array:
    """Pins of the design, mm."""
    pins = dome.twin.pins
    assert pins is not None
    return pin_tips(pins, dome.surface.deform(dome.at_rest()), pin_feet(pins))


def directions(roll_deg: float, pitch_deg: float) -> Array:
    return fingertip.axes(np.deg2rad(roll_deg), np.deg2rad(pitch_deg))[:, 2]


def dent(normal: Array, told: Array) -> Array:
    """A smooth dent, (n, 3) mm, as deep as the way, about the direction of the tool's axis; it leans with x and y."""
    axis = directions(told[4], told[5])
    away2 = 22.0**2 * ((normal - axis) ** 2).sum(axis=1)
    part = told[1] * np.exp(-away2 / (DENT_MM2 * told[6] / 80))
    sideways = fingertip.axes(*np.deg2rad(told[[4, 5]])) @ [told[2] / 20, told[3] / 20, 0]
    return part[:, None] * (sideways - axis)


def press(tips: Array, rng: np.random.Generator, name: str) -> Press:
    """Eight frames of a press of some tool anywhere, and two at rest."""
    rest = EYES.project(tips)
    tool = [*rng.uniform(-5, 5, 2), *rng.uniform(-35, 35, 2), rng.uniform(50, 110)]
    told = np.full((10, 7), np.nan)
    told[2:] = [[0.5 * way, way, *tool] for way in np.linspace(0.25, 2, 8)]
    moved = np.zeros((10, *rest.shape))
    for i in range(2, 10):
        moved[i] = EYES.project(tips + dent(EYES.normals(tips), told[i])) - rest
    moved += rng.normal(0, 0.01, moved.shape)
    return Press(name, "flat", rest, moved, told)


def test_places_and_pixels_are_one_another(tips: Array) -> None:
    np.testing.assert_allclose(EYES.place(EYES.project(tips)), tips, atol=1e-9)


def test_dots_of_both_eyes_are_paired_and_a_wrong_distance_is_refused(tips: Array) -> None:
    rng, (left, right) = np.random.default_rng(1), EYES.project(tips)
    order = rng.permutation(len(tips))
    pairs = EYES.pairs(left + rng.normal(0, 0.1, left.shape), right[order])
    assert len(pairs) > 280
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])
    with pytest.raises(InputError, match="distance between the eyes"):
        Eyes.of(BOARD, 19.0).pairs(left, right)


@pytest.mark.parametrize("baseline_mm", [0.0, -10.0, 44.1, float("nan"), float("inf")])
def test_eyes_that_are_not_in_the_fingertip_are_one_sentence(baseline_mm: float, tmp_path: Path) -> None:
    words = [
        "cal",
        "fit",
        "--only",
        "fingertip",
        "--board",
        str(BOARD.folder),
        "--presses",
        str(tmp_path),
        "--out",
        "x",
    ]
    done = CliRunner().invoke(app, [*words, "--baseline-mm", str(baseline_mm)])
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith(f"--baseline-mm {baseline_mm:g}: the eyes are 0.1 to 44 mm apart")


def test_shifts_become_displacements(tips: Array) -> None:
    moved = np.random.default_rng(2).normal(0, 0.1, tips.shape)
    shift = (EYES.project(tips + moved) - EYES.project(tips)).transpose(1, 0, 2).reshape(-1, 4)
    both, left, right = np.einsum("mncd,nd->mnc", EYES.gains(tips), shift)
    np.testing.assert_allclose(both, moved, atol=0.01)
    inwards = 0.5 * EYES.normals(tips)
    shift = (EYES.project(tips - inwards) - EYES.project(tips)).transpose(1, 0, 2).reshape(-1, 4)
    for eye in np.einsum("mncd,nd->mnc", EYES.gains(tips)[1:], shift):  # radial is what one eye takes for likely
        aside = np.hypot(*tips[:, :2].T) > 14
        assert np.linalg.norm(eye + inwards, axis=1)[aside].mean() < 0.1
    assert left.shape == right.shape == tips.shape


def test_half_a_turn_and_a_mirror_of_a_press(tips: Array) -> None:
    one = press(tips, np.random.default_rng(3), "one")
    normal = EYES.normals(tips)
    own = Samples(EYES.place(one.rest + one.moved[2:]) - tips, one.told[2:])
    half = turned(own, normal, np.pi, is_mirrored=False)
    np.testing.assert_allclose(half.told[:, 2:6], -own.told[:, 2:6], atol=1e-9)
    mirrored = turned(own, normal, 0.0, is_mirrored=True)
    np.testing.assert_allclose(mirrored.told[:, 2:6], own.told[:, 2:6] * [1, -1, -1, 1], atol=1e-9)
    some = turned(own, normal, 0.7, is_mirrored=False)
    expected = np.array([dent(normal, told) for told in some.told])
    inner = normal[:, 2] > 0.6  # the outermost pins are read from beyond the others
    off = (some.moved - expected)[:, inner] - np.median(some.moved - expected, axis=1, keepdims=True)
    assert np.sqrt((off**2).mean()) < 0.02


def test_a_press_is_alike_wherever_it_is(tips: Array) -> None:
    normal = EYES.normals(tips)
    fields = []
    for roll, pitch in ((0.0, 0.0), (14.0, -9.0), (-11.0, 20.0)):
        told = np.array([0.5, 1.5, 0.0, 0.0, roll, pitch, 80.0])
        fields.append(field_of(dent(normal, told)[None], normal, EYES.radius_mm).features[0, 2:-2:3])
    for other in fields[1:]:
        assert np.abs(other - fields[0]).max() < 0.12  # of 1.5: the pins stand elsewhere under it
    assert np.abs(fields[0]).max() > 1


def test_labels_and_what_the_bench_told_are_one_another(tips: Array) -> None:
    one = press(tips, np.random.default_rng(5), "one")
    normal, told = EYES.normals(tips), one.told[2:]
    field = field_of(np.array([dent(normal, t) for t in told]), normal, EYES.radius_mm)
    scale = Scale.of(BOARD)
    back = told_by(labels_of(told, field.turn, scale), field.turn, scale)
    np.testing.assert_allclose(back[:, :6], told[:, :6], atol=1e-9)
    np.testing.assert_allclose(back[:, 6] ** 2, told[:, 6])


def test_a_fingertip_for_ten_times_the_force_is_fitted_on_ten_times_the_force() -> None:
    thin, thick = (Scale.of(find_board(BOARD.folder.parent / name)) for name in (BOARD.name, f"{BOARD.name}-thick"))
    assert (thin.full_n, thick.full_n) == (1.0, 10.0)
    told = np.array([[0.5, 1, 0, 0, 0, 0, 80], [5, 1, 0, 0, 0, 0, 80], [20, 1, 0, 0, 0, 0, 80]], dtype=float)
    assert thin.used(told).tolist() == [True, False, False]
    assert thick.used(told).tolist() == [True, True, False]
    turn = np.eye(3)[None].repeat(3, axis=0)
    assert labels_of(told, turn, thick)[1] == pytest.approx(labels_of(told, turn, thin)[0])


@pytest.mark.parametrize("shape", FACES)
def test_areas_of_faces_are_those_of_the_twins_tools(shape: str) -> None:
    step = 1 / 200
    x, y = np.meshgrid(*2 * [np.arange(-400, 400) * step + step / 2])
    inside = np.clip(0.5 - OUTLINES[shape](x, y) / step, 0, 1).sum() * step**2
    assert face_area(shape, 5.0) == pytest.approx(25 * inside, rel=1e-3)
    assert np.isnan(face_area("sphere", 5.0))


def test_axes_are_those_of_the_twins_poses() -> None:
    np.testing.assert_allclose(fingertip.axes(0.3, -0.6), Pose(0, 0, 0, 0, 0.3, -0.6).rotation(), atol=1e-12)


def test_tables_of_a_press_are_checked(tmp_path: Path) -> None:
    (tmp_path / "press.csv").write_text("force_n,way_mm\n1,2\n")
    with pytest.raises(InputError, match="area_mm2"):
        told_of(tmp_path, 1)
    (tmp_path / "press.csv").write_text("force_n,way_mm,x_mm,y_mm,roll_deg,pitch_deg,area_mm2\n,,,,,,\n")
    assert np.isnan(told_of(tmp_path, 1)[1]).all()
    with pytest.raises(InputError, match="2 frames"):
        told_of(tmp_path, 2)
    with pytest.raises(InputError):
        read_press(BOARD, tmp_path)


def test_presses_that_are_none_or_too_few_are_one_sentence(
    tips: Array, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="holds no press"):
        fit_fingertip(BOARD, tmp_path, 10.0, lambda _: None)
    presses = [press(tips, np.random.default_rng(9), str(i)) for i in range(8)]
    for one in presses[1:]:
        one.told[:, 2] = np.nan  # nobody wrote down where the tool stood
    monkeypatch.setattr(fingertip, "read_presses", lambda *_: presses)
    with pytest.raises(InputError, match=r"has 1 presses of 0.04 to 1.3 N: 8 are needed"):
        fit_fingertip(BOARD, tmp_path, 10.0, lambda _: None)


def test_the_core_says_what_was_fitted(
    tips: Array, dome: Renderer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in (("N_TURNS", 1), ("N_FOLDS", 2), ("N_ROUNDS", 40)):
        monkeypatch.setattr(fingertip, name, value)
    rng = np.random.default_rng(6)
    presses = [press(tips, rng, str(i)) for i in range(8)]
    monkeypatch.setattr(fingertip, "read_presses", lambda *_: presses)
    fitted: list[ModeFit] = []

    def fit_mode(bench: Bench, _: int) -> ModeFit:
        """One eye alone as both: it is slow."""
        if not fitted:
            fitted.append(fingertip_mode(bench, 0))
        return fitted[0]

    monkeypatch.setattr(fingertip, "_fit_mode", fit_mode)
    fit = fit_fingertip(BOARD, tmp_path, 10.0, lambda _: None)
    rim = calibration(BOARD, fit).tensors["fingertip.rim"]
    np.testing.assert_array_equal(rim, np.round(65536 * np.array(fit.report["rim_px"])))  # px Q16
    assert (rim >= np.round(65536 * LEAST_PX)).all()
    off = fit.report["mean_error_of_presses_left_out"]["both"]
    assert off["way_mm"] < 0.4  # of 0.25 to 2 mm
    assert off["roll_deg"] < 8  # of -35 to 35
    with Pipeline(BOARD, calibration(BOARD, fit).data) as path:
        for i in range(BOARD.pipeline.n_rest_frames):
            path.process(dome.image(dome.at_rest().reshape(-1, 3), np.random.default_rng(i)))
        path.process(dome.image(dome.at_rest().reshape(-1, 3), np.random.default_rng(40)))
        assert not path.tip().is_touched
        a, b = np.meshgrid(dome.node_a_mm, dome.node_b_mm)
        way = np.maximum(np.hypot(a, b).ravel(), 1e-9)
        normal = np.column_stack(
            [a.ravel() * np.sin(way / 22) / way, b.ravel() * np.sin(way / 22) / way, np.cos(way / 22)]
        )
        for told in ([0.5, 1.0, 2.0, -3.0, 12.0, -20.0, 80.0], [0.75, 1.5, -1.0, 2.0, -15.0, 5.0, 100.0]):
            frame = path.process(dome.image(dent(normal, np.array(told)) * 1e-3, np.random.default_rng(50)))
            tip = path.tip()
            assert tip.is_touched
            assert frame.wrench_validity[2] in (1, 3)
            np.testing.assert_allclose(np.rad2deg([tip.roll_urad * 1e-6, tip.pitch_urad * 1e-6]), told[4:6], atol=8)
            moved = path.features().reshape(2, -1, 2) / 65536
            _check_alike(fit, path, moved, tip)


def _check_alike(fit: fingertip.TipFit, path: Pipeline, moved: Array, tip: TipRow) -> None:
    """The core's numbers against the network's, which the tables were made of."""
    pins: Pins = fit.bench.pins
    one = Press("now", "", path.markers()[0], moved[None], np.full((1, 7), np.nan))
    shift = fingertip.taken(one, pins.rest)[1].transpose(0, 2, 1, 3).reshape(1, -1, 4)
    seen = np.einsum("ncd,tnd->tnc", fit.bench.eyes.gains(pins.place)[0], shift)
    field = field_of(seen, pins.normal, fit.bench.eyes.radius_mm)
    mean, sigma = fit.modes[0].network(field.features)
    said = told_by(mean, field.turn, fit.bench.scale)[0]
    core = np.array([getattr(tip, name) for name in NAMES], dtype=float)
    core *= [1e-6, 1e-3, 1e-3, 1e-3, np.rad2deg(1e-6), np.rad2deg(1e-6)]
    assert (np.abs(core - said[:6]) <= [0.002, 0.005, 0.03, 0.03, 0.05, 0.05]).all()
    assert core_sigma(tip) == pytest.approx(sigma[0, 0] * fit.bench.scale.one[0] * fit.modes[0].trust[0], rel=0.1)


def core_sigma(tip: TipRow) -> float:
    return 1e-6 * float(tip.sigma_force_un)
