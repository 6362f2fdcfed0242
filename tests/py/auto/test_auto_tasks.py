"""`cal auto` without a bench: what it presses, how it judges a word, and that it never makes a unit worse."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import find_board, parse_board
from ruffini.calibrate import container
from ruffini.calibrate.auto.page import table_of
from ruffini.calibrate.auto.run import BETTER, Auto, Site
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import gates_in
from ruffini.cli import main
from ruffini.errors import RefusedError
from ruffini.estimators.contact_model.task import TASK as CONTACT
from ruffini.estimators.fingertip.task import TASK as FINGERTIP
from ruffini.estimators.operator.task import TASK as FORCES
from ruffini.estimators.operator.task import judged_touches
from ruffini.estimators.skin.task import TASK as SKIN
from ruffini.estimators.table import task_of
from ruffini.estimators.task import NO_SHORE, Counts, Task, Word
from ruffini.estimators.wrench.task import TASK as WRENCH
from ruffini.estimators.wrench.task import judged_loads
from ruffini.rig.emulated_person import _loads
from ruffini.rig.log_file import Log, TouchRecord, write_log
from ruffini.rig.program import CONDITIONS, DRAWN_SHAPES, Condition, Indent, Span, Touch
from ruffini.sim.units import fleet_error

Array = npt.NDArray[np.float64]

FTOUCH, ELTAC = find_board("ftouch"), find_board("eltac")
SPAN = Span(8e-3, 6e-3, 1e-3, 3e-4)
FULL = np.array([1, 1, 8, 0.02, 0.02, 0.02])
N_FRAMES = 60


def test_each_board_has_the_task_of_its_estimator():
    tasks = {"gelslim": "forces", "ftouch": "wrench", "eltac": "skin", "contact-glitter": "contact"}
    assert {name: task_of(find_board(name)).name for name in tasks} == tasks
    text = (
        find_board("gelslim")
        .text.replace('"photometric", "poisson", ', "")
        .replace("[depth]", '[depth]\nsource = "markers"')
    )
    by_markers = parse_board(text, "sample")
    assert by_markers.depth.source == "markers"
    assert task_of(by_markers).name == "forces"


@pytest.mark.parametrize("n", [6, 8, 20])
def test_judged_touches_are_spread_over_the_span_and_are_not_fitted_ones(n: int):
    touches = judged_touches(SPAN, n, 1001)
    places = np.array([(t.x_m, t.y_m) for t in touches if isinstance(t, Touch)]) / (SPAN.half_x_m, SPAN.half_y_m)
    assert np.abs(places).max() <= 1
    assert len({tuple(q) for q in (places > 0).tolist()}) == 4  # all quarters
    fitted = {(t.x_m, t.y_m) for t in FORCES.fitted(SPAN, 40, 2) if isinstance(t, Touch)}
    assert not fitted & {(t.x_m, t.y_m) for t in touches if isinstance(t, Touch)}


def test_judged_loads_mix_axes_as_no_condition_does_and_only_press():
    loads = [load for load in judged_loads(SPAN, 20, 1001) if isinstance(load, Condition)]
    assert len(loads) == 20
    assert not {load.signs for load in loads} & set(CONDITIONS)
    assert all(load.signs[2] <= 0 and any(load.signs) for load in loads)


def test_indenters_are_half_balls_of_sizes_and_hardnesses_that_no_judged_one_has():
    board = find_board("contact-glitter")
    span = CONTACT.span(board, 1.7e-3, 0.0, None)
    fitted = [i for i in CONTACT.fitted(span, 18, 2) if isinstance(i, Indent)]
    judged = [i for i in CONTACT.judged(span, 6, 1001) if isinstance(i, Indent)]
    assert len(fitted) == 18
    assert sum(i.tool.shape == "sphere" for i in fitted) == 9
    assert {i.tool.shape for i in judged} == set(DRAWN_SHAPES)
    assert not {i.tool.radius_m for i in fitted} & {i.tool.radius_m for i in judged}
    assert np.ptp([i.tool.shore_a for i in fitted]) > 60
    places = np.array([(i.x_m, i.y_m) for i in fitted])
    assert np.abs(places).max() <= 2.2e-3  # their surroundings stay on the pad
    assert [i.told() for i in CONTACT.fitted(span, 18, 2)] == [i.told() for i in fitted]


def test_a_contact_models_word_is_every_frame_of_a_press_and_the_hardness_told_last():
    time_s = np.linspace(0, 2, 21)
    wrench = np.zeros((21, 6))
    wrench[:, 2] = -np.linspace(0, 4, 21)
    touch = TouchRecord(
        {"held_host_s": 1.0, "lifted_host_s": 2.0, "tool": {"shape": "flat", "radius_m": 5e-3, "shore_a": 40.0}},
        {
            "stream_host_s": time_s,
            "stream_wrench": 1.1 * wrench,
            "stream_validity": np.ones((21, 6), int),
            "contact_shore": np.array([np.nan, 30.0, 44.0, np.nan]),
        },
    )
    word = CONTACT.word(find_board("contact-glitter"), Log({}, [touch]), touch, wrench)
    assert len(word.said) == 9
    untold = touch._replace(arrays={**touch.arrays, "contact_shore": np.full(4, np.nan)})
    second = CONTACT.word(find_board("contact-glitter"), Log({}, [untold]), untold, wrench)
    figures = CONTACT.figures([word, second])
    assert figures["shore_rmse"] == pytest.approx(4.0)
    assert figures["untold"] == 1
    assert figures["normal_rmse_n"] == pytest.approx(0.1 * np.sqrt(np.mean(wrench[11:20, 2] ** 2)))
    assert figures["error"] == pytest.approx(100 * figures["normal_rmse_n"] / 3.8)


def skin_touch(tip_m: tuple[float, float], contacts: list[tuple[int, float, float, float]]) -> TouchRecord:
    """Held from 1 to 2 s; `contacts`: number, x, y (m) and force (N) in each of its ten frames."""
    time_s = np.linspace(0, 2, 21)
    rows = [(t, *c) for t in time_s[11:20] for c in contacts]
    contact = np.array(rows).reshape(-1, 5)
    return TouchRecord({"held_host_s": 1.0, "lifted_host_s": 2.0}, {
        "stream_s": time_s, "stream_host_s": time_s, "stage_place": np.array([[*tip_m, 0.0]]),
        "contact_s": contact[:, 0], "contact_number": contact[:, 1], "contact_place": contact[:, 2:4],
        "contact_force": contact[:, 4],
    })  # fmt: skip


def test_a_skins_word_is_of_the_contact_at_the_tip_even_across_the_tubes_seam():
    round_m = ELTAC.pad.size_x_um * 1e-6
    touch = skin_touch((0.49 * round_m, 0.01), [(1, 0.0, 0.01, -1.0), (2, -0.495 * round_m, 0.011, -4.5)])
    word = SKIN.word(ELTAC, Log({}, [touch]), touch, np.tile([0, 0, -5.0, 0, 0, 0], (21, 1)))
    assert word.said[0, 2] == pytest.approx(-4.5)
    assert word.off_m[0] == pytest.approx([0.015 * round_m, 1e-3])
    blind = skin_touch((0.0, 0.0), [])
    missed = SKIN.word(ELTAC, Log({}, [blind]), blind, np.tile([0, 0, -5.0, 0, 0, 0], (21, 1)))
    figures = SKIN.figures([word, missed])
    assert figures["untold"] == 1
    assert figures["error"] == pytest.approx((10 + 100) / 2)  # per cent: what is not told is 0 N
    assert figures["place_mm"] == pytest.approx(1e3 * np.hypot(0.015 * round_m, 1e-3))


def test_a_wrenchs_error_counts_an_axis_that_is_not_measured_as_all_of_it():
    rng = np.random.default_rng(1)
    true = rng.uniform(-1, 1, (500, 6)) * FULL
    said = true * 1.1
    said[:, 5] = np.nan
    figures = WRENCH.figures([Word(said, true, np.full((500, 2), np.nan), NO_SHORE)])
    part = np.array([0.1] * 5 + [1.0]) / np.sqrt(3)  # root mean square of a uniform load
    assert figures["error"] == pytest.approx(100 * np.sqrt(np.mean(part**2)), rel=0.1)
    assert figures["not_measured"] == ["Tz"]
    true[:, 5] = 0.0  # not loaded
    alone = WRENCH.figures([Word(true * 1.1, true, np.full((500, 2), np.nan), NO_SHORE)])
    assert alone["error"] == pytest.approx(10 / np.sqrt(3), rel=0.1)


def loaded(path: Path, n: int, seed: int, said_off: float) -> Path:
    """A log of loads whose targets follow the wrench; the sensor's word meanwhile is off by a part."""
    rng, made_by = np.random.default_rng(seed), np.random.default_rng(1).normal(size=(9, 6)) * 5 / FULL
    touches = []
    for k in range(n):
        host_s = 10.0 * k + 100 + np.arange(N_FRAMES) / 30
        wrench = np.sin(np.pi * np.arange(N_FRAMES) / N_FRAMES)[:, None] ** 2 * rng.uniform(-1, 1, 6) * FULL
        wrench[:8] = 0.0
        moved = (wrench @ made_by.T + rng.normal(size=(N_FRAMES, 9)) * 0.02).reshape(-1, 3, 3)
        touches.append(TouchRecord({"held_host_s": host_s[10], "lifted_host_s": host_s[-2], "kind": "condition"}, {
            "stream_s": host_s - 90, "stream_host_s": host_s, "stream_frame": np.arange(N_FRAMES),
            "stream_flags": np.zeros(N_FRAMES, int), "stream_validity": np.ones((N_FRAMES, 6), int),
            "stream_wrench": wrench * (1 + said_off) + rng.normal(size=wrench.shape) * 1e-3 * FULL,
            "reference_s": host_s, "reference_wrench": wrench, "stage_s": np.zeros(0), "stage_place": np.zeros((0, 3)),
            "marker_s": host_s - 90, "marker_displacement": moved,
        }))  # fmt: skip
    write_log(path, Log({"board": "ftouch", "rig": "bench"}, touches, {}))
    return path


class Collected(Auto):
    """A run whose logs are made up; notes which calibration was in force for each."""

    said_off: Mapping[str, float] = MappingProxyType({})

    def _collect(self, name, program, touches, seed, calibration) -> Path:  # type: ignore[no-untyped-def]
        self.in_force = [*getattr(self, "in_force", []), (name, calibration)]
        return loaded(self.folder / f"{name}.h5", len(touches), seed, self.said_off[name])


def run_of(folder: Path, previous: CalibrationFile | None) -> Collected:
    def nobody(*_: object):  # type: ignore[no-untyped-def]
        raise AssertionError("no bench is needed")

    return Collected(FTOUCH, WRENCH, Site(nobody, SPAN, None, False), folder, Counts(0, 10, 4, 0), 1, lambda _: None,
                     previous)  # fmt: skip


def test_a_wrench_is_fitted_judged_and_reported(tmp_path: Path):
    run = run_of(tmp_path, None)
    run.said_off = {"after": 0.02, "fitted": np.nan}
    result = json.loads(json.dumps(run.run()))
    file = container.read(tmp_path / "calibration.safetensors")
    assert "wrench" in file.kinds
    assert [name for name, _ in run.in_force] == ["fitted", "after"]  # nothing was in force: nothing to judge before
    assert run.in_force[-1][1] is not None
    assert run.in_force[-1][1].sha256 == file.sha256
    assert result["before"] is None
    assert 0.3 < result["after"]["error"] < 2.0  # two per cent of loads that are 0.4 of their largest
    assert "nothing was measured before" in (tmp_path / "auto.html").read_text()
    assert "Error of each axis" in (tmp_path / "report.html").read_text()
    assert "not measured" in table_of([tmp_path])[1]
    assert BETTER not in {gate.name for gate in gates_in(file) or []}


@pytest.mark.parametrize(
    ("task", "name"), [(WRENCH, "ftouch"), (CONTACT, "contact-glitter"), (FINGERTIP, "stereo-fingertip")]
)
def test_a_force_that_the_sensor_calls_invalid_is_not_stated(task: Task, name: str) -> None:
    time_s = np.linspace(0, 2, 21)
    wrench = np.tile([0, 0, -0.8, 0, 0, 0], (21, 1))
    validity = np.ones((21, 6), int)
    validity[15] = 3
    touch = TouchRecord(
        {"held_host_s": 1.0, "lifted_host_s": 2.0, "tilt_deg": [0.0, 0.0], "tool": {"shore_a": 40.0}},
        {"stream_host_s": time_s, "stream_wrench": wrench, "stream_validity": validity},
    )
    normal = task.word(find_board(name), Log({}, [touch]), touch, wrench).said[:, 2]
    assert np.flatnonzero(np.isnan(normal)).tolist() == [4]  # of the frames after 1 s
    assert np.nanmax(np.abs(normal + 0.8)) < 1e-9


@pytest.mark.parametrize(("said_off", "is_better"), [(0.2, True), (0.0, False)])
def test_what_is_no_better_than_what_is_in_force_is_not_flashed(tmp_path: Path, said_off: float, is_better: bool):
    """The sensor said of the same touches what they were, or a fifth too much."""
    before = container.pack({"wrench.gain": np.zeros((6, 9), np.int32)}, container.base_metadata(FTOUCH))
    run = run_of(tmp_path, before)
    run.said_off = {"before": said_off, "fitted": said_off, "after": 0.0}
    if is_better:
        result = run.run()
        assert result["before"]["error"] > 5 * result["after"]["error"]
    else:
        with pytest.raises(RefusedError, match=r"not flashed, what is in force stays.*than before: touches left out"):
            run.run()
        assert [name for name, _ in run.in_force] == ["before", "fitted"]
        assert "FAILS: than before" in (tmp_path / "report.html").read_text()
    gate = next(g for g in gates_in(container.read(tmp_path / "calibration.safetensors")) or [] if g.name == BETTER)
    assert gate.ok is is_better  # `cal flash` refuses it, too


def test_a_fit_of_which_nobody_knows_is_not_flashed(tmp_path: Path):
    before = container.pack({"wrench.gain": np.zeros((6, 9), np.int32)}, container.base_metadata(FTOUCH))
    run = run_of(tmp_path, before)
    run.said_off = {"before": 0.2, "fitted": 0.2, "after": 0.0}
    run.task = replace(run.task, left_out=lambda _: float("nan"))
    with pytest.raises(RefusedError, match="than before: no touch left out tells"):
        run.run()
    assert [name for name, _ in run.in_force] == ["before", "fitted"]


def test_cal_report_judges_a_wrench_on_its_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    run = run_of(tmp_path, None)
    run.said_off = {"after": 0.02, "fitted": np.nan}
    run.run()
    calibration = tmp_path / "calibration.safetensors"
    words = ["cal", "report", calibration, "--log", tmp_path / "fitted.h5", "--board", "ftouch",
             "--previous", calibration]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["ruffini", *map(str, words), "--out", str(tmp_path / "page.html")])
    assert main() == 0
    assert "passes its gates" in capsys.readouterr().out
    assert "Error of each axis" in (tmp_path / "page.html").read_text()
    tree = json.loads((tmp_path / "page.json").read_text())
    assert all(axis["rmse"] < 0.05 * axis["largest"] for axis in tree["axes"].values())
    assert tree["previous"] == {name: axis["rmse"] for name, axis in tree["axes"].items()}
    (few,) = tree["accuracy_of_presses"]  # ten loads: five fitted, five judged
    assert few["presses"] == 5
    assert few["error_percent"] > 5  # five loads do not tell six axes


def test_a_force_is_judged_along_the_axes_that_the_board_measures():
    true = np.array([[0.3, -0.4, -2.0, 0, 0, 0], [0.0, 0.5, -1.0, 0, 0, 0]])
    said = true * [1.1, 1.1, np.nan, 1, 1, 1]
    blank = np.full((2, 2), np.nan)
    figures = FORCES.figures([Word(said, true, blank, NO_SHORE)])
    assert figures["error"] == pytest.approx(50)  # mN, a tenth of 0.5 N
    assert figures["largest_force_n"] == pytest.approx(0.5)
    assert np.isnan(FORCES.figures([Word(np.full((2, 6), np.nan), true, blank, NO_SHORE)])["error"])


def test_unit_zero_is_as_its_board_file_says():
    assert fleet_error(FTOUCH, 0).modulus == 1.0
    assert fleet_error(FTOUCH, 1).modulus != 1.0


def test_a_person_hears_how_hard_to_press():
    rng = np.random.default_rng(1)
    for normal_n, most_n in ((8.0, 8.0), (1.0, 1.0)):
        loads = _loads(Condition((0, 1, -1, 0, 0, 0), 1.0, 0.02, normal_n).told(), rng)
        assert -1.3 * most_n < loads[:, 2].min() < -0.4 * most_n
        assert 0.4 < loads[:, 1].max() < 1.3
