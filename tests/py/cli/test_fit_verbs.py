"""The verbs of fitting and judging: what they refuse before anything is done, and one whole round on a small board."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_board import SHAPE, Files, Run

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.estimators.material.prior import Prior, write_prior
from ruffini.rig.log_file import Log, TouchRecord, write_log


def small_log(files: Files, path, *, board: str = "small"):
    """Touches as the board's linear estimate would have them: enough for a judge, not for a fit."""
    rng, records = np.random.default_rng(1), []
    for i in range(12):
        time_s = 10.0 * i + 0.05 * np.arange(8)
        wrench = np.tile([0, 0, -1.0 - 0.1 * i, 0, 0, 0], (8, 1))
        dent = np.zeros(SHAPE)
        dent[2 + i % 5, 2 + i % 7, 2] = -3e-4
        arrays = {
            "stream_s": time_s, "stream_host_s": time_s, "stream_frame": np.arange(8), "stream_flags": np.zeros(8, int),
            "stream_wrench": wrench, "stream_validity": np.ones((8, 6)), "reference_s": time_s,
            "reference_wrench": wrench, "stage_s": time_s[:1], "stage_place": np.zeros((1, 3)), "field_s": time_s[-1:],
            "field_displacement": dent[None], "rest_field_s": time_s[:1],
            "rest_field_displacement": rng.normal(0, 1e-6, (1, *SHAPE)),
        }  # fmt: skip
        records.append(TouchRecord({"held_host_s": time_s[0] - 1, "lifted_host_s": time_s[-1] + 1}, arrays))
    write_log(path, Log({"board": board}, records, {}))
    return path


def test_fit_refuses_what_cannot_be(files: Files, run: Run, tmp_path):
    log, out = small_log(files, tmp_path / "log.h5"), tmp_path / "cal"
    words = ("cal", "fit", log, "--board", files.folder, "--out", out)
    assert run(*words, "--strain", "large")[0] == 2
    code, _, error = run(*words, "--skip", "polish")
    assert code == 2
    assert "there is no such stage" in error
    code, _, error = run(*words)
    assert code == 2
    assert "nothing gives this board its colours" in error
    assert "in stage photometric; --skip photometric goes on without it" in error
    code, _, error = run("cal", "fit", small_log(files, tmp_path / "b.h5", board="other"), *words[3:], "--with",
                         files.calibration)  # fmt: skip
    assert code == 2
    assert "collected on board 'other', not 'small'" in error
    assert not out.exists()


def test_the_first_line_names_a_board_only_where_one_is_named(files: Files, run: Run, tmp_path):
    words = (
        "cal",
        "fit",
        small_log(files, tmp_path / "log.h5"),
        "--out",
        tmp_path / "x",
        "--previous",
        tmp_path / "none",
    )
    assert run(*words)[2].splitlines()[0] == "cal fit ..."
    assert run(*words, "--board", "gelslim")[2].splitlines()[0] == "cal fit: board gelslim"


def test_report_refuses_a_prior_that_its_stage_does_not_use(run: Run, tmp_path):
    calibration, board = tmp_path / "wrench.safetensors", find_board("ftouch")
    container.write(calibration, container.pack({"wrench.shift": np.ones(6, np.uint8)}, container.base_metadata(board)))
    code, _, error = run("cal", "report", calibration, "--log", tmp_path / "log.h5", "--out", tmp_path / "page.html",
                         "--prior", tmp_path / "fleet.json")  # fmt: skip
    assert code == 2
    assert "are of no use to the report of stage wrench: leave the option out" in error


def fit_with_prior(run: Run, folder, board: str, words=()) -> tuple[int, str]:
    """Exit code and stderr of a fit of a log that does not exist."""
    prior = folder / "fleet.json"
    write_prior(prior, find_board(board), Prior("fleet of 4", np.array([1e5, 0.48, 4e-3]), np.eye(3)))
    command = ("cal", "fit", folder / "log.h5", "--board", board, "--out", folder / "cal", "--prior", prior)
    code, _, error = run(*command, *words)
    return code, error


def test_fit_takes_a_prior_where_the_stage_material_runs(run: Run, tmp_path):
    code, error = fit_with_prior(run, tmp_path, "gelslim")
    assert code == 2
    assert "in stage photometric" in error
    assert "--prior" not in error


@pytest.mark.parametrize(
    ("board", "words"),
    [
        ("gelsight-wedge", ()),
        ("eltac", ()),
        ("stereo-fingertip", ()),
        ("gelslim", ("--only", "threshold")),
        ("gelslim", ("--skip", "material")),
    ],
)
def test_fit_refuses_a_prior_that_no_stage_uses(run: Run, tmp_path, board, words):
    code, error = fit_with_prior(run, tmp_path, board, words)
    assert code == 2
    assert f"only stage material begins with the numbers of a fleet's pads, and this fit of board {board!r}" in error


def test_fit_takes_a_calibration_of_other_units_where_forces_come_from_features(run: Run, tmp_path):
    prior = tmp_path / "others.safetensors"
    for board in ("gelslim", "digit-tactile"):
        container.write(prior, container.pack({"wrench.shift": np.ones(6, np.uint8)},
                                              container.base_metadata(find_board(board))))  # fmt: skip
        code, _, error = run("cal", "fit", tmp_path / "log.h5", "--board", board, "--out", tmp_path / "cal",
                             "--prior", prior)  # fmt: skip
        assert code == 2
        assert ("only stage wrench begins with a calibration of other units" in error) == (board == "gelslim")
    code, _, error = run(
        "cal", "fit", "--only", "wrench", tmp_path / "log.h5", "--board", "ninedtact", "--prior", prior
    )
    assert code == 4
    assert "digit-tactile" in error
    code, _, error = run("cal", "fit", tmp_path / "log.h5", "--board", "ninedtact", "--out", tmp_path / "cal",
                         "--prior", prior)  # fmt: skip
    assert code == 4
    assert "digit-tactile" in error


def test_report_says_in_json_and_exit_code_that_gates_fail(files: Files, run: Run, tmp_path):
    log = small_log(files, tmp_path / "log.h5")
    page = tmp_path / "report.html"
    code, out, _ = run(
        "cal", "report", files.calibration, "--log", log, "--out", page, "--board", files.folder, "--json"
    )
    tree = json.loads(out)
    assert code == 1
    assert not tree["passed"]
    assert tree["log"]["touches"] == 12
    assert {"pad", "on the board"} <= {g["name"] for g in tree["gates"] if g["ok"] is False}
    assert json.loads(page.with_suffix(".json").read_text())["gates"] == tree["gates"]
    assert "FAILS" in page.read_text()


def test_a_file_that_fails_is_not_flashed_and_the_way_out_is_named(files: Files, run: Run, tmp_path):
    good = container.read(files.calibration)
    gate = {"name": "error", "ok": False, "value": 0.2, "limit": 0.05, "text": "0.2 of the largest force"}
    bad = container.pack(good.tensors, {**good.metadata, "residuals": json.dumps({"gates": [gate]})})
    container.write(tmp_path / "bad", bad)
    code, _, error = run("cal", "flash", tmp_path / "bad")
    assert code == 4
    assert "error: 0.2 of the largest force" in error
    assert "--force" in error


def test_auto_and_check_refuse_before_anything_moves(files: Files, run: Run, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text('schema = 1\n[reference]\nkind = "weight"\nsigma_g = 0.1\n[limits]\nmax_force_n = 5.0\n')
    for board in ("contact-glitter", "stereo-fingertip"):
        code, _, error = run("cal", "auto", "--rig", rig, "--board", board, "--out", tmp_path / "auto")
        assert code == 2
        assert "[[indenters]] in its file" in error
        assert not list(tmp_path.glob("auto/*"))
    assert run("cal", "check")[0] == 2
    assert run("cal", "check", "--grams", 100, "--ball-mm", 6)[0] == 2
    code, _, error = run("cal", "check", "--grams", 100, "--rig", "sim")
    assert code == 2
    assert "--rig sim needs --board and --calibration" in error


def test_fleet_names_what_it_cannot_fit(files: Files, run: Run, tmp_path):
    logs = [small_log(files, tmp_path / f"{i}.h5", board="other") for i in range(2)]
    code, _, error = run("cal", "fleet", *logs, "--board", files.folder, "--out", tmp_path / "f.html", "--workers", 1)
    assert code == 2
    assert "no unit could be fitted; the first:" in error
    assert "collected on board 'other'" in error
