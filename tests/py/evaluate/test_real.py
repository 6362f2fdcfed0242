"""The table of real recordings: its kinds by folder, as page and as Markdown."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ruffini.calibrate.report.html import Page
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.evaluate import real


def _kind(folder: Path, page: Page, progress: real.Progress) -> list[real.Row]:
    page.text(f"read {folder.name}")
    progress(1.0)
    return [real.Row("made", "MAE Fx", "N", 0.05551, {"ridge": 0.0748}), real.Row("made", "found, of 32", "", 32, {})]


def test_one_table_on_the_terminal_in_a_file_and_on_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real, "KINDS", {"made": _kind, "absent": _kind})
    (tmp_path / "made").mkdir()
    page, table = tmp_path / "new" / "real.html", tmp_path / "results" / "real.md"
    command = ["eval", "real", str(tmp_path), "--out", str(page), "--table", str(table)]
    said = CliRunner().invoke(app, command, catch_exceptions=False)
    assert table.read_text() == (
        "| recordings | figure | unit | ruffini | ridge |\n| --- | --- | --- | --- | --- |\n"
        "| made | MAE Fx | N | 0.0555 | 0.0748 |\n| made | found, of 32 |  | 32 |  |\n"
    )
    assert table.read_text() in said.stdout
    assert "read made" in page.read_text()
    rows = json.loads(CliRunner().invoke(app, [*command, "--json"], catch_exceptions=False).stdout)["rows"]
    assert [row["ours"] for row in rows] == [0.05551, 32]


def test_a_folder_without_recordings_names_what_it_may_hold(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"holds none of marker-force, gelsight-ball-presses, wedge-load-cell: .*eval wrench"
    ):
        real.evaluate(tmp_path, tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()
