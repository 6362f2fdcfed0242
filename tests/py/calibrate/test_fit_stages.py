"""Stages, gates, report and fleet on logs of a pad that is off its board file."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from kept import kept
from test_material import TRUE, board, touches  # noqa: F401

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.calibrate.fit.job import HELD_S, Job, Outcome, material_of
from ruffini.calibrate.fit.run import finished, gates_of_stages, run_stages
from ruffini.calibrate.fleet import units
from ruffini.calibrate.fleet.units import fit_fleet, outliers_of
from ruffini.calibrate.gates import MAX_ERROR, Gate, failed, gates_in
from ruffini.calibrate.log.touches import Series, TouchLog, read_touch_log
from ruffini.errors import InputError, RefusedError
from ruffini.estimators.material import stage as material
from ruffini.estimators.material.fit import fit_material
from ruffini.estimators.operator import report as operator_report
from ruffini.estimators.operator import stage as operator
from ruffini.estimators.operator.fit import Material, board_slab, make_operator
from ruffini.estimators.operator.page import write_page
from ruffini.estimators.operator.report import report_of
from ruffini.estimators.relaxation import stage as relaxation
from ruffini.estimators.relaxation.fit import fit_relaxation, left_after
from ruffini.estimators.table import BY_NAME, applying
from ruffini.estimators.threshold import fit as contact_noise
from ruffini.estimators.threshold import stage as threshold
from ruffini.rig.log_file import Log, TouchRecord, write_log

N_FRAMES = 12
BOARD_FACTS = {"board": "sample", "rig": "sim"}
NOISE = np.array([1e-3] * 3 + [5e-6] * 3)  # of a frame, N and N m


@pytest.fixture(scope="module", autouse=True)
def kept_steps() -> Iterator[None]:
    """What takes long in the stages is kept between runs."""

    def without_progress(make: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments, progress, **how: kept(make, *arguments, **how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(material, "fit_material", without_progress(fit_material))
        patch.setattr(operator, "make_operator", without_progress(make_operator))
        patch.setattr(relaxation, "fit_relaxation", lambda log: kept(fit_relaxation, log))
        yield


def rig_log(board: Board, path: Path, n: int, seed: int, *, gain: float = 1.0) -> Path:  # noqa: F811
    """A log of n touches of the pad TRUE; `gain` of the reference, which may be wrong."""
    rng = np.random.default_rng(seed)
    u, wrench = touches(board, n, rng)
    rows, columns = board.observed
    shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
    records = []
    for i in range(n):
        strongest = 5 * i + 4  # an untouched frame, then four of each touch, one after the last
        time_s = 10.0 * i + 0.05 * np.arange(N_FRAMES)
        held = np.tile(gain * wrench[strongest], (N_FRAMES, 1))
        arrays = {
            "stream_s": time_s, "stream_host_s": time_s, "stream_frame": np.arange(N_FRAMES),
            "stream_flags": np.zeros(N_FRAMES, int), "stream_wrench": 0.9 * held,
            "stream_validity": np.ones((N_FRAMES, 6)),
            "reference_s": time_s, "reference_wrench": held, "stage_s": time_s[:1], "stage_place": np.zeros((1, 3)),
            "field_s": time_s[-2:], "field_displacement": np.tile(u[strongest].reshape(shape), (2, 1, 1, 1)),
            "rest_field_s": time_s[:2], "rest_field_displacement": rng.normal(0, 1e-6, (2, *shape)),
        }  # fmt: skip
        records.append(TouchRecord({"held_host_s": time_s[0] - 0.01, "lifted_host_s": time_s[-1] + 0.01}, arrays))
    found = {"checks": {"unit": {"ok": True, "text": "as the sensor says"}}}
    write_log(path, Log(BOARD_FACTS, records, found))
    return path


def colours(board: Board) -> container.CalibrationFile:  # noqa: F811
    tensors = {
        "photometric.unmix": np.zeros((13, 17, 2, 3), np.int16), "photometric.slope": np.zeros((65, 65, 2), np.int16)
    }  # fmt: skip
    return container.pack(tensors, container.base_metadata(board))


@pytest.fixture(scope="module")
def fitted(board: Board, tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, container.CalibrationFile, list[Gate]]:  # noqa: F811
    log = rig_log(board, tmp_path_factory.mktemp("log") / "log.h5", 14, seed=4)
    job = Job(board, [log], parts=[colours(board)])
    told = []
    outcomes = run_stages(job, frozenset(), tell=lambda name, *_: told.append(name))
    assert told == ["camera", "dark", "photometric", "material", "relaxation", "noise", "operator", "threshold"]
    file, gates = finished(job, outcomes)
    return job, file, gates


def test_a_log_makes_a_calibration_that_passes_and_says_so(fitted, board: Board) -> None:  # noqa: F811
    job, file, gates = fitted
    assert failed(gates) == []
    assert {"touches", "coverage", "error", "gain", "on the board", "rest", "reference unit"} <= {g.name for g in gates}
    assert gates_in(container.unpack(file.data)) == gates_rounded(gates)
    assert material_of(file) == pytest.approx(TRUE, rel=0.03)
    assert job.noise is not None
    assert job.noise.sigma_m[0] < 20e-6
    assert job.noise.long_share is None, "its grid has too few blocks"
    assert set(file.kinds) == {"operator", "photometric", "support"}
    residuals = json.loads(file.metadata["residuals"])
    assert residuals["stages"]["photometric"]["state"] == "given"
    assert residuals["stages"]["relaxation"]["state"] == "open"


def gates_rounded(gates: list[Gate]) -> list[Gate]:
    def short(value: float | None) -> float | None:
        return None if value is None else float(f"{value:.6g}")

    return [g._replace(value=short(g.value), limit=short(g.limit)) for g in gates]


def test_a_reference_that_is_wrong_by_touch_fails_the_gates(board: Board, tmp_path: Path) -> None:  # noqa: F811
    """Two logs of one unit whose references differ by 30 %: no pad fits both."""
    logs = [rig_log(board, tmp_path / f"{g}.h5", 8, seed=5, gain=g) for g in (1.0, 1.3)]
    job = Job(board, logs, parts=[colours(board)])
    file, gates = finished(job, run_stages(job, frozenset({"threshold"}), tell=lambda *_: None))
    bad = {g.name: g for g in failed(gates)}
    assert bad["error"].value > MAX_ERROR
    assert failed(gates_in(file) or []) != []


def test_skipped_stages_keep_what_was_before(fitted, board: Board, tmp_path: Path) -> None:  # noqa: F811
    _, before, _ = fitted
    log = rig_log(board, tmp_path / "log.h5", 3, seed=6)
    job = Job(board, [log], previous=before)
    outcomes = run_stages(job, frozenset({"material", "operator"}), tell=lambda *_: None)
    assert {n: o.state for n, o in outcomes.items()} == {
        "camera": "board", "dark": "board", "photometric": "kept", "material": "kept", "relaxation": "open",
        "noise": "fitted", "operator": "kept", "threshold": "open",
    }  # fmt: skip
    for name, tensor in before.tensors.items():
        np.testing.assert_array_equal(job.tensors[name], tensor)
    with pytest.raises(InputError, match="there is no such stage; there are camera, dark, photometric"):
        run_stages(job, frozenset({"polish"}), tell=lambda *_: None)
    with pytest.raises(InputError, match="nothing gives this board its colours"):
        run_stages(Job(board, [log]), frozenset(), tell=lambda *_: None)


def test_what_a_skipped_stage_needs_is_asked_of_the_previous_calibration() -> None:
    """A contact model's wrench is fitted with it: a file with either alone stands in for neither."""
    glitter = find_board("contact-glitter")

    def kept_of(*kinds: str) -> Outcome:
        tensors = {f"{kind}.x": np.zeros(2, np.int32) for kind in kinds}
        previous = container.pack(tensors, container.base_metadata(glitter)) if kinds else None
        return BY_NAME["contact"].keep(Job(glitter, [], previous))

    for kinds, missing in (
        ((), "contact_model or wrench"), (("contact_model", "contact_depth"), "wrench"), (("wrench",), "contact_model"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=rf"--skip contact needs .* no file that was given has {missing}: give"):
            kept_of(*kinds)
    assert kept_of("contact_model", "wrench").state == "kept"


def test_a_kept_wrench_keeps_the_softness_that_was_fitted_with_it() -> None:
    wedge = find_board("gelsight-wedge")
    tensors = {"wrench.x": np.zeros(2, np.int32), "softness.map": np.ones(6, np.int32)}
    job = Job(wedge, [], container.pack(tensors, container.base_metadata(wedge)))
    assert BY_NAME["wrench"].keep(job).state == "kept"
    assert job.tensors.keys() == tensors.keys()


def only_threshold(
    board: Board,  # noqa: F811
    before: container.CalibrationFile,
    alone_mn: float,
    serial: str = "*",
) -> tuple[container.CalibrationFile, list[Gate]]:
    """What `cal fit --only threshold` makes where a lone node's noise reaches so much."""
    job = Job(board, [], before, only="threshold")
    job.tensors["contact.noise_un"] = np.array([100, round(1e3 * alone_mn)], np.int32)
    return finished(job, {"threshold": Outcome("fitted", "", {"alone_mn": alone_mn})}, serial)


def test_a_stage_that_is_fitted_anew_takes_its_old_gates_away(fitted, board: Board) -> None:  # noqa: F811
    _, whole, gates = fitted
    limit_mn = board.contact.threshold_un * 1e-3
    noisy, bad = only_threshold(board, whole, 2 * limit_mn)
    assert [g.name for g in failed(bad)] == ["touch noise"]
    assert noisy.metadata["gates"] == "failed: touch noise"
    assert len(bad) == len(gates) + 1  # of the whole file, not of the stage alone
    quiet, good = only_threshold(board, noisy, limit_mn / 2)
    assert quiet.metadata["gates"] == "passed"
    assert failed(good) == []
    assert gates_in(quiet) == good
    assert [g.name for g in good] == [g.name for g in bad]
    stages = json.loads(quiet.metadata["residuals"])["stages"]
    assert stages["threshold"]["alone_mn"] == pytest.approx(limit_mn / 2)
    assert "left_out" in stages["material"]  # `cal check` asks for it


def test_only_one_stage_is_of_the_unit_that_is_named_or_refused(fitted, board: Board) -> None:  # noqa: F811
    _, whole, _ = fitted
    assert only_threshold(board, whole, 1.0)[0].metadata["sensor_serial"] == "*"
    mine, _ = only_threshold(board, whole, 1.0, "A1")
    assert mine.metadata["sensor_serial"] == "A1"
    assert only_threshold(board, mine, 1.0)[0].metadata["sensor_serial"] == "A1"
    with pytest.raises(RefusedError, match="--unit B2: the previous calibration is of sensor A1"):
        only_threshold(board, mine, 1.0, "B2")


def test_threshold_alone_takes_no_log_of_touches(fitted, board: Board, tmp_path: Path) -> None:  # noqa: F811
    _, before, _ = fitted
    log = rig_log(board, tmp_path / "log.h5", 2, seed=8)
    with pytest.raises(InputError, match="takes recordings of the untouched pad") as caught:
        threshold.THRESHOLD.fit_alone(Job(board, [log], before, only="threshold"), None, lambda _: None)
    assert "untouched frames in the log" not in str(caught.value)
    skipped = threshold.THRESHOLD.fit(Job(board, [log], before), lambda _: None)
    assert skipped.text == "the operator is not fitted here, and a log's untouched frames are judged with it"


def test_three_presses_are_enough_after_a_gel_was_changed(fitted, board: Board, tmp_path: Path) -> None:  # noqa: F811
    _, before, _ = fitted
    job = Job(board, [rig_log(board, tmp_path / "log.h5", 3, seed=7)], previous=before)
    _, gates = finished(job, run_stages(job, frozenset(), tell=lambda *_: None))
    assert failed(gates) == []
    assert job.fit is not None
    assert job.fit.prior.source == "previous"
    assert tuple(job.fit.material) == pytest.approx(TRUE, rel=0.03)
    assert not job.fit.is_finite
    finite = Job(board, job.paths, previous=before, is_finite=True)
    outcome = material.MATERIAL.fit(finite, lambda _: None)
    assert finite.fit is not None
    assert finite.fit.is_finite
    assert next(r for r in outcome.remarks if "strain" in r).startswith(
        "the prior (previous) was fitted at linear strain"
    )
    assert "previous pad was fitted at linear strain" in material.MATERIAL.keep(finite).remarks[0]
    assert material.MATERIAL.keep(job).remarks == ()
    assert not any("a real pad" in r for r in (*outcome.remarks, *material.MATERIAL.fit(job, lambda _: None).remarks))
    job.log().facts[0]["rig"] = "bench"
    assert "a real pad was pressed" in material.MATERIAL.fit(job, lambda _: None).remarks[-1]
    blind = board.model_copy(update={"pipeline": board.pipeline.model_copy(
        update={"stages": [stage for stage in board.pipeline.stages if stage != "support"]})})  # fmt: skip
    at_linear = Job(blind, job.paths, previous=before, is_finite=True)
    remarks = material.MATERIAL.fit(at_linear, lambda _: None).remarks
    assert at_linear.fit is not None
    assert not at_linear.fit.is_finite
    assert any("has no second pass: its pad was fitted, and is solved, at linear strain" in r for r in remarks)
    alone = Job(board, job.paths, parts=[colours(board)])
    with pytest.raises(InputError, match="3 touches above") as caught:
        run_stages(alone, frozenset(), tell=lambda *_: None)
    assert "in stage material" in caught.value.__notes__[0]


def test_report_judges_on_a_log_that_was_not_fitted(fitted, board: Board, tmp_path: Path) -> None:  # noqa: F811
    _, file, _ = fitted
    log = read_touch_log([rig_log(board, tmp_path / "other.h5", 13, seed=9)], board, None)
    report = report_of(board, file, log)
    tree = json.loads(json.dumps(report.tree))
    assert tree["passed"]
    assert not tree["log"]["in_the_fit"]
    rows = tree["accuracy_of_presses"]
    assert [r["presses"] for r in rows] == [0, 1, 2, 3, 5, 10]
    assert rows[-1]["board"] < 0.4 * rows[0]["board"]
    assert tree["valid_for"]["temperature_c"] is None
    assert sum(map(sum, tree["coverage"])) == 13
    page = tmp_path / "report.html"
    write_page(page, board, file, report)
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 3
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert "SIMULATED" in text


def test_a_calibration_of_finite_strain_is_reported_and_followed_at_it(
    fitted,
    board: Board,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, file, _ = fitted
    kinds = ",".join([*file.kinds, "finite_strain"])
    finite = SimpleNamespace(kinds=kinds.split(","), metadata={**file.metadata, "kinds": kinds}, tensors=file.tensors)
    asked: list[bool] = []

    def stop(*_: object, is_finite: bool) -> None:
        asked.append(is_finite)
        raise InputError("enough was seen")

    monkeypatch.setattr(operator_report, "_fitted", stop)
    log = read_touch_log([rig_log(board, tmp_path / "other.h5", 5, seed=9)], board, None)
    report_of(board, file, log)
    monkeypatch.setattr(operator_report, "is_of_finite_strain", lambda _: True)
    report_of(board, file, log)
    assert asked == [False, True]
    assert Job(board, [], previous=file).prior().is_finite is False
    assert Job(board, [], previous=finite).prior().is_finite is True


def test_a_fleet_at_finite_strain_says_so(
    board: Board,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(units, "outliers_of", lambda _: {})  # these pads are linear
    logs = [rig_log(board, tmp_path / f"unit{i}.h5", 5, seed=20 + i) for i in range(4)]
    linear, finite = (fit_fleet(logs, board, None, is_finite=is_finite).prior for is_finite in (False, True))
    assert linear is not None
    assert finite is not None
    assert (linear.is_finite, finite.is_finite) == (False, True)
    assert abs(finite.mean[0] / linear.mean[0] - 1) > 0.03


def test_a_fleet_has_a_spread_outliers_and_a_prior(board: Board, tmp_path: Path) -> None:  # noqa: F811
    good = [rig_log(board, tmp_path / f"unit{i}.h5", 5, seed=20 + i, gain=1 + 0.01 * i) for i in range(5)]
    odd = rig_log(board, tmp_path / "odd.h5", 5, seed=30, gain=1.9)
    few = rig_log(board, tmp_path / "few.h5", 2, seed=31)
    fleet = fit_fleet([*good, odd, few], board, None)
    tree = json.loads(json.dumps(fleet.report()))
    assert tree["fitted"] == 6
    assert list(tree["outliers"]) == ["odd.h5"]
    assert "2 touches above" in tree["units"][6]["error"]
    assert fleet.prior is not None
    assert fleet.prior.source == "fleet of 5"
    assert fleet.prior.mean[0] == pytest.approx(1.02 * TRUE.modulus_pa, rel=0.04)
    assert fleet.prior.is_finite is False
    assert tree["after_rmse_n"] < tree["before_rmse_n"]
    assert outliers_of(fleet.units[:5]) == {}
    with pytest.raises(InputError, match=r"several logs are called few\.h5"):
        fit_fleet([few, few], board, None)


def test_temperatures_of_touches_are_in_file_and_report(fitted, board: Board, tmp_path: Path) -> None:  # noqa: F811
    _, before, _ = fitted
    path = rig_log(board, tmp_path / "log.h5", 3, seed=7)
    with h5py.File(path, "r+") as file:
        for i, celsius in enumerate(({"gel": 24.5, "lamp": 41.0}, {"gel": 31.25}, {})):
            facts = json.loads(file[f"touch/{i:05d}"].attrs["facts"])
            file[f"touch/{i:05d}"].attrs["facts"] = json.dumps({**facts, "temperatures_c": celsius})
    job = Job(board, [path], previous=before)
    file, _ = finished(job, run_stages(job, frozenset({"material", "operator"}), tell=lambda *_: None))
    wanted = {"gel": [24.5, 31.25], "lamp": [41.0, 41.0]}
    assert json.loads(file.metadata["residuals"])["valid_for"]["temperature_c"] == wanted
    report = report_of(board, file, job.log())
    assert report.tree["valid_for"]["temperature_c"] == wanted
    write_page(tmp_path / "report.html", board, file, report)
    assert "temperature of gel, C" in (tmp_path / "report.html").read_text()
    assert json.loads(before.metadata["residuals"])["valid_for"]["temperature_c"] is None


def test_a_hold_that_is_not_still_is_paired_by_time(board: Board, tmp_path: Path) -> None:  # noqa: F811
    """The reference rises while the frames are kept: each frame has what it read then, not the hold's mean."""
    path = rig_log(board, tmp_path / "log.h5", 2, seed=8)
    with h5py.File(path, "r+") as file:
        touch = file["touch/00000"]
        ramp = np.linspace(0.5, 1.0, N_FRAMES)
        touch["reference_wrench"][...] = ramp[:, None] * touch["reference_wrench"][-1]
        touch["field_s"][...] = touch["stream_s"][[3, 6]]
        last = touch["reference_wrench"][-1]
    log = read_touch_log([path], board, None)
    assert log.wrench[0, 2] == pytest.approx(ramp[3] * last[2], rel=0.05)
    assert log.wrench[1, 2] == pytest.approx(ramp[6] * last[2], rel=0.05)


def test_a_reference_whose_place_is_not_known_has_no_moments(board: Board, tmp_path: Path) -> None:  # noqa: F811
    path = rig_log(board, tmp_path / "log.h5", 2, seed=8)
    assert np.isfinite(read_touch_log([path], board, None).wrench).all()
    with h5py.File(path, "r+") as file:
        file.attrs["found"] = json.dumps({"frame": {"why_not": "no stage pressed"}})
    wrench = read_touch_log([path], board, None).wrench
    assert np.isfinite(wrench[:, :3]).all()
    assert np.isnan(wrench[:, 3:]).all()


def test_each_board_has_the_stages_that_its_pipeline_needs(board: Board) -> None:  # noqa: F811
    def needed(one: Board) -> list[str]:
        return [estimator.name for estimator in applying(one)]

    assert needed(find_board("ftouch")) == ["camera", "dark", "photometric", "wrench"]
    assert needed(board) == [
        "camera",
        "dark",
        "photometric",
        "material",
        "relaxation",
        "noise",
        "operator",
        "threshold",
    ]


def test_axes_that_a_wrench_misses_are_gates() -> None:
    axes = {"Fx": {"rmse": 0.02, "full_scale": 1.0}, "Tz": {"rmse": 2.0, "full_scale": -9.0},
            "Ty": {"rmse": 0.0, "full_scale": 0.0}}  # fmt: skip
    gates = gates_of_stages(find_board("ftouch"), {"wrench": Outcome("fitted", "", {"axes": axes})})
    assert {g.name: g.ok for g in gates} == {"wrench Fx": True, "wrench Tz": False}


def held_touch(start_s: float, force_n: float, hold_s: float) -> Series:
    """Pressed within 0.2 s and held: the device says the elastic force, of which 0.2 goes within 0.6 s."""
    time_s = start_s + np.arange(0, hold_s + 1.0, 1 / 30)
    elastic = np.zeros((len(time_s), 6))
    elastic[:, 2] = -force_n * np.clip((time_s - start_s - 0.3) / 0.2, 0, 1) * (time_s < start_s + 0.5 + hold_s)
    h, lost = 0.0, np.zeros(len(time_s))
    for k in range(1, len(time_s)):
        h += (1 - np.exp(-1 / 30 / 0.6)) * ((elastic[k, 2] + elastic[k - 1, 2]) / 2 - h)
        lost[k] = 0.2 * h * (elastic[k, 2] != 0)
    true = elastic.copy()
    true[:, 2] -= lost
    noise = np.random.default_rng(int(start_s)).normal(size=(2, *true.shape)) * NOISE
    gain = 0.9 + 0.15 * np.cos(start_s)  # from place to place
    return Series(time_s, gain * elastic + noise[0], true + noise[1])


@pytest.mark.parametrize("hold_s", [3.0, 0.5])
def test_relaxation_is_learned_from_touches_that_were_held(board: Board, hold_s: float) -> None:  # noqa: F811
    """The device's forces are off by another part from place to place; E is of the moment at which fields are kept."""
    series = [held_touch(10.0 * i, 0.8 + 0.2 * i, hold_s if i % 2 else 0.5) for i in range(8)]
    none, unused = np.zeros((0, 1, 3)), np.zeros((8, 6))
    job = Job(board, [], _log=TouchLog(none, unused, np.arange(8), none, unused, series))
    outcome = relaxation.RELAXATION.fit(job, lambda _: None)
    if hold_s < 2:
        assert outcome.state == "open"
        assert "no touch is held for 2 s" in outcome.text
        return
    assert outcome.state == "fitted", outcome.text
    assert outcome.report["loss"] == pytest.approx(0.2, abs=0.03)
    assert job.instant_gain == pytest.approx(1 / (1 - 0.2 * (1 - np.exp(-HELD_S / 0.6))), rel=0.03)
    assert "relaxation.part" in job.tensors


def test_a_noisier_sensor_needs_a_harder_touch(fitted, board: Board, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    monkeypatch.setattr(contact_noise, "N_DRAWN", 20_000)
    known, _, _ = fitted
    n = known.log().displacement.shape[1]
    none, harder = np.zeros((0, n, 3)), []
    for noise_m in (1e-6, 3e-6):
        rest = np.random.default_rng(3).normal(0, noise_m, (contact_noise.MIN_FRAMES, n, 3))
        log = TouchLog(none, np.zeros((0, 6)), np.zeros(0, np.int64), rest, np.zeros((0, 6)))
        job = Job(board, [], matrix=known.matrix, _log=log)
        outcome = threshold.THRESHOLD.fit(job, lambda _: None)
        assert outcome.state == "fitted", outcome.text
        harder.append(outcome.report["alone_mn"])
        assert "contact.noise_un" in job.tensors
    assert harder[1] == pytest.approx(3 * harder[0], rel=0.05)
    few = TouchLog(none, np.zeros((0, 6)), np.zeros(0, np.int64), rest[:30], np.zeros((0, 6)))
    job = Job(board, [], matrix=known.matrix, _log=few)
    assert "30 untouched frames in the log, 100 are needed" in threshold.THRESHOLD.fit(job, lambda _: None).text


def test_relaxed_force_after_a_while() -> None:
    tensors = {"relaxation.part": np.array([104858], np.int32), "relaxation.time_ms": np.array([500], np.int32)}
    assert left_after(tensors, 0.5) == pytest.approx(1 - 0.1 * (1 - np.exp(-1)), abs=1e-6)
    assert left_after({}, 0.5) == 1.0


def test_board_is_what_the_tests_assume(board: Board) -> None:  # noqa: F811
    slab = board_slab(board)
    assert Material(slab.modulus_pa, slab.poisson, slab.thickness_m) == pytest.approx((2e5, 0.48, 4e-3))
