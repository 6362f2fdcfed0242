"""ruffini cal fit --only: one way for every stage, whatever its inputs and its options."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from small_board import Files, Run
from test_dark_verb import write_dark

from ruffini.calibrate import container
from ruffini.calibrate.fit.job import Job, Outcome
from ruffini.errors import InputError
from ruffini.estimators.commands import COMMANDS
from ruffini.estimators.material import stage as material
from ruffini.estimators.material.stage import MATERIAL
from ruffini.estimators.table import ESTIMATORS

NUMBERS = {"modulus_pa": 2.1e5, "poisson": 0.48, "thickness_m": 4e-3, "interval_95": {"modulus_pa": 3e4}, "touches": 3}


def test_the_table_of_commands_is_that_of_the_estimators() -> None:
    """Help reads the one, a fit the other."""
    assert {one.name: one.command for one in ESTIMATORS if one.command} == {one.name: one for one in COMMANDS}


def test_an_option_has_a_name_that_no_option_of_every_stage_has() -> None:
    shared = {"logs", "more_logs", "board", "previous", "json_", "only", "options"}
    own = {one.name: {f.name for f in dataclasses.fields(one.options)} for one in COMMANDS if one.options}
    assert len(own) == 7
    assert {name: fields & shared for name, fields in own.items() if fields & shared} == {}


def test_tables_of_one_stage_are_added_to_the_calibration_before(files: Files, run: Run, tmp_path: Path) -> None:
    out, recording = tmp_path / "new.safetensors", write_dark(tmp_path / "dark")
    code, text, err = run(
        "cal", "fit", "--only", "dark", recording, "--previous", files.calibration, "--out", out, "--board",
        files.folder, "--json",
    )  # fmt: skip
    assert code == 0, err
    before, file = container.read(files.calibration), container.read(out)
    assert file.kinds == sorted([*before.kinds, "dark"])
    assert json.loads(text)["frames"] == 12
    assert json.loads(file.metadata["residuals"])["stages"]["dark"]["frames"] == 12
    assert "gates" not in file.metadata  # nobody has judged the rest


def test_tables_that_belong_together_go_together(files: Files, run: Run, tmp_path: Path) -> None:
    """A second pass stays with no operator but its own, and what relaxes is in the operator that it is solved for."""
    first, out = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    words = ("cal", "fit", "--only", "operator", "--board", files.folder, "--touches", 0)
    assert run(*words, "--out", first)[0] == 0
    with_memory = container.read(first)
    memory = {"relaxation.part": np.array([2**18], np.int32), "relaxation.time_ms": np.array([100], np.int32)}
    container.write(first, container.pack({**with_memory.tensors, **memory}, with_memory.metadata))
    assert run(*words, "--previous", first, "--out", out)[0] == 0
    modulus_pa, _, _ = (float(v) for v in container.read(out).metadata["operator.material"].split(","))
    assert modulus_pa == pytest.approx(files.board.pad.modulus_pa / (1 - 0.25 * (1 - np.exp(-5))), rel=1e-4)
    assert container.read(out).kinds == ["operator", "relaxation", "support"]
    assert run(*words, "--previous", first, "--method", "optimal", "--out", out)[0] == 0
    assert "support" not in container.read(out).kinds


def test_numbers_for_the_operator_are_json_with_their_gates(
    files: Files, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MATERIAL, "fit_alone", lambda *_: Outcome("fitted", "E and the others", NUMBERS))
    out, operator = tmp_path / "m.json", tmp_path / "o.safetensors"
    words = ("cal", "fit", "--only", "material", "--log", tmp_path, "--calibration", files.calibration)
    code, text, _ = run(*words, "--board", files.folder, "--out", out)
    assert (code, text.splitlines()[-1]) == (1, "FAILS interval of E: it will not be flashed")
    tree = json.loads(out.read_text())
    assert [(gate["name"], gate["ok"]) for gate in tree["gates"]] == [("interval of E", False), ("modulus", True)]
    run("cal", "fit", "--only", "operator", "--board", files.folder, "--material", out, "--out", operator,
        "--method", "optimal")  # fmt: skip
    file = container.read(operator)
    assert file.metadata["operator.material"] == "210000,0.48,0.004"
    assert file.metadata["gates"] == "failed: interval of E"


def test_strain_reaches_the_fit_of_the_material_and_the_operator_names_another(
    files: Files, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def fit_material(*_: object, is_finite: bool, **__: object) -> None:
        asked.append(is_finite)
        raise InputError("enough was seen")

    monkeypatch.setattr(material, "log_from_recording", lambda *_, **__: None)
    monkeypatch.setattr(material, "fit_material", fit_material)
    words = ("cal", "fit", "--only", "material", tmp_path, "--previous", files.calibration, "--board", files.folder)
    for strain in ("finite", "linear"):
        assert "enough was seen" in run(*words, "--out", tmp_path / "x", "--strain", strain)[2]
    assert asked == [True, False]
    path, out = tmp_path / "m.json", tmp_path / "o.safetensors"
    path.write_text(json.dumps({"board": files.board.name, "strain": "linear", **NUMBERS}))
    words = ("cal", "fit", "--only", "operator", "--board", files.folder, "--material", path, "--out", out)
    words += ("--touches", 0)
    assert "was fitted at linear strain and is used at finite" in run(*words, "--strain", "finite")[2]
    assert "strain" not in run(*words)[2]


def test_a_recording_needs_the_calibration_that_sees_it(run: Run, tmp_path: Path) -> None:
    for stage in ("material", "relaxation"):
        words = ("cal", "fit", "--only", stage, tmp_path, "--board", "gelslim", "--out", tmp_path / "x")
        code, _, err = run(*words)
        assert code == 2
        assert "give --previous FILE" in err


def test_a_log_of_no_board_has_none(tmp_path: Path) -> None:
    assert Job(None, []).header()["board"] == "none"
