"""`cal fit` of a glowing skin on a log whose law is known: pictures as the line brings them, a one-axis reference."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from test_glowing_skin import BOARD, LENS, PARTS, SCALE, SHIFT_MM, A, B

from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome
from ruffini.calibrate.fit.run import finished, gates_of_stages, run_stages
from ruffini.calibrate.gates import Gate, failed
from ruffini.errors import InputError
from ruffini.estimators.skin.judge import OFF_X, REFERENCE, SAID, judged_presses
from ruffini.estimators.skin.log import pictured_presses, untouched_of, whole
from ruffini.estimators.skin.openings import lattice_mm
from ruffini.estimators.skin.presses import TOUCHED_N
from ruffini.estimators.skin.report import skin_report_of, write_skin_page
from ruffini.estimators.skin.response import Layout, Memory, layout_of
from ruffini.estimators.skin.rubber import pyramid_force
from ruffini.estimators.table import applying
from ruffini.rig.log_file import Log, TouchRecord, read_log, write_log

Array = npt.NDArray[np.float64]
STEP_PX, TAKEN = 2, (3, 30, 36, 42)  # pictures: one before, three while it is held
LEVEL, HALF_PX = 40, 2
N_PRESSES = 24  # of the fit; its table of fewer presses goes to 20


def pictures(light: Array) -> npt.NDArray[np.uint8]:
    """Openings as bright squares, `light` (t, n) times their level at rest, each second pixel."""
    out = np.zeros((len(light), BOARD.camera.height_px, BOARD.camera.width_px, 3), np.uint8)
    for i, (x, y) in enumerate(np.round(LENS.project(lattice_mm(BOARD))).astype(int)):
        level = np.clip(np.round(LEVEL * light[:, i]), 0, 255)[:, None, None, None]
        out[:, y - HALF_PX : y + HALF_PX, x - HALF_PX : x + HALF_PX, :2] = level
    return out[:, ::STEP_PX, ::STEP_PX]


def touch(
    number: int, place: Array, strength: float, layout: Layout, *, gain: float = 1.0, taken: tuple[int, ...] = TAKEN
) -> TouchRecord:  # fmt: skip
    """Down in 0.5 s, held for 0.7 s; force by the rubber's law with memory."""
    time_s = np.arange(45) / 30.0
    way = strength * np.clip((time_s - time_s[8]) / 0.5, 0, 1)
    off = np.abs(layout.away(place - SHIFT_MM))
    u = way[:, None] * np.exp(-off[:, 0] / 8 - off[:, 1] / 15)
    each = SCALE * (pyramid_force(A * u + B) - pyramid_force(np.array(B)))
    total = np.where(u > 0.02, each, 0).sum(axis=1)
    force = total - np.array(PARTS) @ Memory.of([time_s]).of_load(total)
    host_s, none = 100.0 + 5 * number + time_s, np.full((len(time_s), 6), np.nan)
    reference = none.copy()
    reference[:, 2] = -gain * force
    arrays = {
        "stream_s": host_s - 77, "stream_host_s": host_s, "stream_frame": np.arange(45),
        "stream_flags": np.zeros(45, int), "stream_wrench": none, "stream_validity": np.zeros((45, 6), int),
        "reference_s": host_s, "reference_wrench": reference,
        "stage_s": host_s[-1:], "stage_place": np.array([[*place * 1e-3, -1e-3]]),
        "image_s": host_s[list(taken)] - 77, "image": pictures(np.exp(u[list(taken)])),
    }  # fmt: skip
    facts = {"held_host_s": host_s[24], "lifted_host_s": host_s[-1], "touched_host_s": host_s[8],
             "image_step_px": STEP_PX}  # fmt: skip
    return TouchRecord(facts, arrays)


def skin_log(path: Path, n: int, seed: int, *, gain: tuple[float, float] = (1.0, 1.0), is_unit_ok: bool = True) -> Path:
    rng, layout = np.random.default_rng(seed), layout_of(BOARD, lattice_mm(BOARD))
    touches = [touch(i, np.array([rng.uniform(-110, 110), rng.uniform(-54, 54)]), rng.uniform(0.7, 1.6), layout,
                     gain=gain[i % 2]) for i in range(n)]  # fmt: skip
    found = {"checks": {"unit": {"ok": is_unit_ok, "text": "as the weight says"}}}
    write_log(path, Log({"board": BOARD.name, "rig": "sim"}, touches, found))
    return path


def write_points(path: Path) -> Path:
    place = np.column_stack([np.linspace(-120, 120, 30), np.tile(np.linspace(-55, 55, 10), 3)])
    rows = np.column_stack([LENS.project(place), place[:, 1]])
    path.write_text("x_px,y_px,z_mm\n" + "\n".join(",".join(f"{v:.3f}" for v in row) for row in rows))
    return path


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_points(tmp_path_factory.mktemp("points") / "points.csv")


def fit(
    path: Path, points: Path | None, skip: frozenset[str] = frozenset(), **more
) -> tuple[Job, dict[str, Outcome], CalibrationFile, list[Gate]]:
    job = Job(BOARD, [path], points=points, **more)
    outcomes = run_stages(job, skip, tell=lambda *_: None)
    return job, outcomes, *finished(job, outcomes)


def fit_of_log(n: int, seed: int, **how) -> tuple[dict[str, Array], dict[str, Outcome], CalibrationFile, list[Gate]]:
    with tempfile.TemporaryDirectory() as folder:
        job, *found = fit(skin_log(Path(folder) / "log.h5", n, seed, **how), write_points(Path(folder) / "points.csv"))
    return job.tensors, *found


@pytest.fixture(scope="module")
def fitted():
    return kept(fit_of_log, N_PRESSES, 3)


def test_a_log_makes_a_skins_calibration_that_passes(fitted) -> None:
    _, outcomes, file, gates = fitted
    report = outcomes["skin"].report
    assert failed(gates) == []
    of_the_fit = {"touches", "coverage", "skin force", "skin place"}
    assert {g.name for g in gates} == {"reference unit", "on the board"} | of_the_fit
    assert set(file.kinds) == {"skin", "relaxation"}
    assert report["n_taxels"] == len(lattice_mm(BOARD))
    assert report["n_presses"] == N_PRESSES
    assert 1 <= report["n_at_rim"] <= 12  # a sixth of the places asked for
    assert report["force_error_percent"] < 5
    assert report["place_error_mm"] < 2.5
    fewer = report["accuracy_of_presses"]
    assert [row["presses"] for row in fewer] == [5, 10, 20]
    assert fewer[-1]["force_error_percent"] < 5


def test_presses_that_a_fit_did_not_see_on_the_boards_integers(fitted, tmp_path: Path) -> None:
    _, _, file, _ = fitted
    other = skin_log(tmp_path / "other.h5", 10, seed=9)
    rows = judged_presses(BOARD, file, [other])
    assert len(rows) == 30
    hard = rows[rows[:, REFERENCE] > 1.5]
    assert len(hard) > 6
    assert np.mean(np.abs(hard[:, SAID] / hard[:, REFERENCE] - 1)) < 0.06
    assert np.mean(np.linalg.norm(hard[:, OFF_X:], axis=1)) < 2.5


def test_report_says_how_well_and_shows_it(fitted, tmp_path: Path) -> None:
    _, _, file, gates = fitted
    log = skin_log(tmp_path / "other.h5", 6, seed=21)
    report = skin_report_of(BOARD, file, [log], previous=file)
    tree = json.loads(json.dumps(report.tree))
    assert tree["passed"]
    assert not tree["log"]["in_the_fit"]
    assert tree["log"]["touches"] == 6
    assert tree["skin"] == tree["previous"]
    assert tree["skin"]["force_rmse_n"] < 0.15
    assert tree["skin"]["place_error_mm"] < 2.5
    assert tree["valid_for"]["temperature_c"] is None
    assert {g["name"] for g in tree["gates"]} == {"reference unit", "on the board"} < {g.name for g in gates}
    write_skin_page(tmp_path / "report.html", file, report)
    text = (tmp_path / "report.html").read_text()
    assert text.count("data:image/png;base64,") == 1
    assert "SIMULATED" in text
    assert "288 taxels" in text


def test_a_reference_that_is_wrong_by_touch_and_one_that_failed_its_checks_are_refused() -> None:
    *_, gates = kept(fit_of_log, 14, 4, gain=(1.0, 1.6), is_unit_ok=False)
    assert {"skin force", "reference unit"} <= {g.name for g in failed(gates)}


def test_few_presses_in_one_corner_fail_their_gates() -> None:
    report = {"n_presses": 4, "coverage": 1 / 9, "force_error_percent": 3.0, "place_error_mm": 8.0, "pitch_mm": 10.0,
              "n_at_rim": 4}  # fmt: skip
    gates = gates_of_stages(BOARD, {"skin": Outcome("fitted", "", report)})
    assert {g.name for g in failed(gates)} == {"touches", "coverage", "skin place"}
    assert not any("rim" in g.text for g in gates)


def test_a_force_that_fails_for_presses_at_the_rim_says_what_to_do() -> None:
    report = {"n_presses": 20, "coverage": 1.0, "force_error_percent": 13.0, "place_error_mm": 1.0, "pitch_mm": 10.0}
    said = []
    for n_at_rim in (17, 5):
        gates = gates_of_stages(BOARD, {"skin": Outcome("fitted", "", {**report, "n_at_rim": n_at_rim})})
        said += [g.text for g in failed(gates)]
    assert "17 of 20 presses are at a rim" in said[0]
    assert "press inside" in said[0]
    assert "rim" not in said[1]


def test_what_is_missing_is_said(fitted, points: Path, tmp_path: Path) -> None:
    tensors, _, before, _ = fitted
    log = skin_log(tmp_path / "log.h5", 2, seed=5)
    with pytest.raises(InputError, match="give --points FILE"):
        fit(log, None)
    with pytest.raises(InputError, match="needs a calibration with skin, and no file that was given has skin"):
        fit(log, None, skip=frozenset({"skin"}))
    job, outcomes, file, _ = fit(log, None, previous=before, skip=frozenset({"skin"}))
    assert outcomes["skin"].state == "kept"
    assert set(file.kinds) == {"skin", "relaxation"}
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(job.tensors[name], tensor)
    blind = read_log(log)
    for one in blind.touches:
        one.arrays.pop("image"), one.arrays.pop("image_s")
    write_log(tmp_path / "blind.h5", blind)
    with pytest.raises(InputError, match="holds no pictures of a press"):
        fit(tmp_path / "blind.h5", points)
    write_log(tmp_path / "other.h5", blind._replace(facts={"board": "another"}))
    with pytest.raises(InputError, match="collected on board 'another'"):
        fit(tmp_path / "other.h5", points)


def test_what_is_untouched_is_the_mean_over_touches(tmp_path: Path) -> None:
    log = read_log(skin_log(tmp_path / "log.h5", 2, seed=5))
    for one, level in zip(log.touches, (10, 20), strict=True):
        one.arrays["image"][0] = level
    assert (untouched_of(log, "log", BOARD) == 15).all()


def test_a_light_touch_on_the_way_down_is_not_taken_for_rest(tmp_path: Path) -> None:
    layout = layout_of(BOARD, lattice_mm(BOARD))
    one = touch(0, np.array([20.0, 5.0]), 1.2, layout, taken=(3, 11, 20, 42))
    write_log(tmp_path / "log.h5", Log({"board": BOARD.name, "rig": "sim"}, [one], {}))
    (press,) = pictured_presses(read_log(tmp_path / "log.h5"), "log", BOARD)
    assert 0 < press.force_n[1] < TOUCHED_N < press.force_n[2]
    assert press.n_rest == 1
    assert press.time_s[0] < press.touched_s < press.time_s[1]


def test_a_picture_of_each_second_pixel_lies_where_its_pixels_were() -> None:
    y, x = np.mgrid[: BOARD.camera.height_px, : BOARD.camera.width_px]
    ramp = np.stack([x // 6, y // 4, 0 * x], axis=2).astype(np.uint8)
    back = whole(ramp[::2, ::2], 2, BOARD)
    assert (back[::2, ::2] == ramp[::2, ::2]).all()
    assert np.abs(back.astype(int) - ramp)[:-2, :-2].max() <= 1
    with pytest.raises(InputError, match="the board's is 1280 x 720 px"):
        whole(ramp[::4, ::4], 1, BOARD)


def test_a_glowing_board_needs_this_stage_and_no_other_estimator() -> None:
    assert [estimator.name for estimator in applying(BOARD)] == ["camera", "skin"]
