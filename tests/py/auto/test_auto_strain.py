"""`cal auto` fits a pad on a bench at finite strain and the twin's at linear strain, unless it is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_line import run_ruffini

import ruffini.calibrate.auto.run as auto_run
import ruffini.cli.auto as verb
from ruffini.errors import InputError

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


def test_another_word_is_refused_before_anything_is_pressed(tmp_path: Path) -> None:
    code, _, error = run_ruffini(
        "cal", "auto", "--board", "gelslim", "--rig", "sim", "--strain", "some", "--out", str(tmp_path)
    )
    assert code == 2
    assert "--strain 'some': choose linear or finite" in error
