"""Errors for programs (`--json`) and for terminals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run_ruffini
from small_board import Files, Run

from ruffini.calibrate import container, keys
from ruffini.cli.common import emit


def test_with_json_an_error_is_an_object_on_stdout(run: Run, tmp_path: Path) -> None:
    missing = tmp_path / "missing.safetensors"
    code, out, err = run("cal", "file", "show", missing, "--json")
    assert code == 2
    assert json.loads(out) == {"error": f"{missing}: cannot be read: No such file or directory", "exit_code": 2}
    assert str(missing) in err
    assert run("cal", "file", "show", missing)[1] == ""


def test_control_characters_do_not_reach_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    emit({}, False, "serial \x1b]0;owned\x07\n\x9b31m next")
    assert capsys.readouterr().out == "serial \\x1b]0;owned\\x07\n\\x9b31m next\n"


@pytest.mark.parametrize(("option", "most"), [("--version", 10**12 - 1), ("--epoch", 10**9)])
def test_a_number_beyond_the_firmwares_limit_is_not_signed(
    run: Run, files: Files, tmp_path: Path, option: str, most: int
) -> None:
    out = tmp_path / "signed.safetensors"
    assert run("key", "sign", files.calibration, "--out", out, option, most + 1)[0] == 2
    assert not out.exists()
    assert run("key", "sign", files.calibration, "--out", out, option, most)[0] == 0
    assert run("cal", "file", "verify", out, "--board", files.folder)[0] == 0


def test_a_calibration_for_one_sensor_is_verified_on_the_host(run: Run, files: Files, tmp_path: Path) -> None:
    out = tmp_path / "one.safetensors"
    file = keys.sign(container.read(files.calibration), None, {"sensor_serial": "R-0042"})
    container.write(out, file)
    code, text, _ = run("cal", "file", "verify", out, "--board", files.folder)
    assert code == 0
    assert "signed by development key" in text


@pytest.mark.parametrize(
    "words", [("cal", "file", "show"), ("info", "--nonsense"), ("nonsense",), ("monitor", "--n", "-1")]
)
def test_wrong_usage_is_an_object_too(words: tuple[str, ...]) -> None:
    done = run_ruffini(*words, "--json")
    assert done.code == 2
    assert json.loads(done.out) == {"error": "wrong usage: stderr says what is wrong", "exit_code": 2}
    assert run_ruffini(*words).out == ""
