"""`make gels`: it writes the row of each board that it measured into docs/results/accuracy.md, and no other line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ruffini.errors import InputError

ROOT = Path(__file__).parents[3]
sys.path.append(str(ROOT / "tests" / "bench"))

import gels  # noqa: E402

RESULT = {"board": "ninedtact", "after": {"largest_force_n": 1.571, "axes_rmse_n_nm": [0, 0, 0.0193, 0, 0, 0]}}
RESIDUALS = {"stages": {"wrench": {"axes": {"Fz": {"rmse": 0.0108}}}}}
ROW = "| ninedtact | 1.57 N | 0.011 | 0.019 | not fitted, 0.010 | 12345678 | 2026-01-02 |"
HEAD = f"| {' | '.join(gels.COLUMNS)} |\n{'| --- ' * len(gels.COLUMNS)}|\n"
OLD = "| ninedtact | 9 N | 9 | 9 | 9, 9 | 0 | - |\n"
OTHER = "| digit-tactile | 1 N | 1 | 1 | 1, 1 | 0 | - |\n"
BEFORE = f"# Results\n\n{HEAD}{OLD}\nof another section\n\n{gels.SECTION}\n\nWords.\n\n{HEAD}"
AFTER = "\n## Next\n\n| board |\n| --- |\n| ninedtact |\n"


def test_a_row_has_the_figures_of_the_run() -> None:
    assert gels.row_of(RESULT, RESIDUALS, [None, 0.0104]).text("12345678", "2026-01-02") == ROW


def test_a_row_replaces_that_of_its_board_in_its_section() -> None:
    assert gels.with_row(BEFORE + OLD + OTHER + AFTER, ROW) == BEFORE + f"{ROW}\n" + OTHER + AFTER


def test_the_row_of_a_new_board_ends_the_table() -> None:
    assert gels.with_row(BEFORE + OTHER + AFTER, ROW) == BEFORE + OTHER + f"{ROW}\n" + AFTER


def test_a_document_without_the_table_is_refused() -> None:
    with pytest.raises(InputError, match="has no section"):
        gels.with_row(f"# Results\n\n{HEAD}{OLD}", ROW)
    with pytest.raises(InputError, match="with a table"):
        gels.with_row(f"{gels.SECTION}\n\n| board |\n| --- |\n| ninedtact |\n", ROW)


@pytest.mark.parametrize("code", [0, 4])
def test_only_a_calibration_in_force_gets_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def auto(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        assert command[command.index("--board") + 1] == "ninedtact"
        return subprocess.CompletedProcess(command, code, stdout=json.dumps(RESULT))

    path = tmp_path / "accuracy.md"
    path.write_text(BEFORE + OLD + AFTER)
    monkeypatch.setattr(gels, "commit", lambda _: "12345678")
    monkeypatch.setattr(gels.subprocess, "run", auto)
    monkeypatch.setattr(gels, "of_fewer", lambda *_: [None, 0.0104])
    monkeypatch.setattr(gels.container, "read", lambda _: None)
    monkeypatch.setattr(gels.container, "residuals", lambda _: RESIDUALS)
    words = ["--board", "ninedtact", "--table", str(path)]
    if code:
        with pytest.raises(SystemExit, match="exit code 4: no row is written"):
            gels.main(words)
        assert path.read_text() == BEFORE + OLD + AFTER
    else:
        assert gels.main(words) == 0
        assert path.read_text().count(" | 12345678 | ") == 1
        assert path.read_text().startswith(BEFORE + "| ninedtact | 1.57 N |")


def test_the_document_has_a_row_for_every_such_board() -> None:
    text = (ROOT / "docs" / "results" / "accuracy.md").read_text()
    section = text.split(gels.SECTION)[1].split("\n## ")[0]
    rows = [line.split(" | ")[0].removeprefix("| ") for line in section.splitlines() if line.startswith("| ")]
    assert sorted(rows[2:]) == gels.boards()
