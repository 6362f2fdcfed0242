"""`cal auto` fits a pad on a bench at finite strain and the twin's at linear strain, unless it is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_line import run_ruffini

import ruffini.calibrate.auto.run as auto_run
import ruffini.cli.auto as verb
from ruffini.boards import find_board
from ruffini.calibrate.fit.job import Outcome
from ruffini.errors import InputError
from ruffini.fem.finite_strain import MAX_NODES

ENOUGH = "enough was seen"


def asked(monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str) -> bool:
    """Whether the run's fit is told of finite strain."""
    seen: list[bool] = []

    def fit(job: Any, *_: Any, **__: Any) -> None:
        seen.append(job.is_finite)
        raise InputError(ENOUGH)

    def run(self: auto_run.Auto) -> None:
        self._fit(folder / "log.h5", None)

    for site in ("simulated_site", "_real"):
        monkeypatch.setattr(verb, site, lambda *_, **__: auto_run.Site(None, None, None, False))
    monkeypatch.setattr(auto_run, "run_stages", fit)
    monkeypatch.setattr(auto_run.Auto, "run", run)
    code, _, error = run_ruffini("cal", "auto", "--board", "gelslim", "--out", str(folder / "auto"), *words)
    assert code == 2
    assert ENOUGH in error
    return seen[0]


def test_the_default_is_the_benchs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert asked(monkeypatch, tmp_path, "--rig", "bench.toml")
    assert not asked(monkeypatch, tmp_path, "--rig", "sim")
    assert not asked(monkeypatch, tmp_path, "--rig", "bench.toml", "--strain", "linear")
    assert asked(monkeypatch, tmp_path, "--rig", "sim", "--strain", "finite")


def test_a_grid_that_is_too_fine_is_refused_before_anything_is_pressed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    board = tmp_path / "fine"
    board.mkdir()
    text = (find_board("gelslim").text).replace("n_x = 31\n", f"n_x = {MAX_NODES + 2}\n")
    (board / "board.toml").write_text(text.replace('name = "gelslim"', 'name = "fine"'))
    monkeypatch.setattr(verb, "_real", lambda *_, **__: pytest.fail("the bench was opened"))
    code, _, error = run_ruffini("cal", "auto", "--board", str(board), "--rig", "b.toml", "--out", str(tmp_path / "a"))
    assert code == 2
    assert "make [grid] coarser, or give --strain linear" in error


def test_a_board_without_a_second_pass_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def stop(*_: Any, **__: Any) -> None:
        raise InputError(ENOUGH)

    monkeypatch.setattr(verb, "simulated_site", stop)
    words = ("cal", "auto", "--board", "gelsight-mini", "--rig", "sim", "--out", str(tmp_path / "a"))
    assert "has no second pass: --strain changes nothing" in run_ruffini(*words, "--strain", "finite")[2]
    assert "second pass" not in run_ruffini(*words)[2]


def test_what_a_stage_remarks_is_said(tmp_path: Path) -> None:
    said: list[str] = []
    run = auto_run.Auto(None, None, None, tmp_path, None, 1, said.append)
    run._tell("material", Outcome("fitted", "E 200 kPa", remarks=("nu stopped at 0.49",)))
    assert said == ["material: fitted, E 200 kPa", "material: nu stopped at 0.49"]


def test_another_word_is_refused_before_anything_is_pressed(tmp_path: Path) -> None:
    code, _, error = run_ruffini(
        "cal", "auto", "--board", "gelslim", "--rig", "sim", "--strain", "some", "--out", str(tmp_path)
    )
    assert code == 2
    assert "--strain 'some': choose linear or finite" in error
