"""The table of `make hostile`: rows add up over seeds, and no figure outlives its commit."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

HOSTILE = Path(__file__).parents[2] / "hostile"
sys.path.append(str(HOSTILE))

import hostile  # noqa: E402
import table  # noqa: E402
from row import Row, Wanted  # noqa: E402

WHAT = {"pictures": "camera faults", "stores": "files"}
RUN = table.Run("12345678", "2026-01-02", "x86_64, 2 cores")
PLATE = Row("gelslim", "plates", tried=8, right=7, wrong=1, worst_n=0.344, n_good=5, n_flagged=2)


def lines(path: Path) -> list[str]:
    """The runs and the rows below them, without the dividers."""
    return [line for line in path.read_text().splitlines() if line.startswith(("| ", "Seeds ")) and "---" not in line]


def test_seeds_of_one_commit_add_up(tmp_path: Path) -> None:
    path = tmp_path / "hostile.md"
    table.add(path, "pictures", PLATE, 7, WHAT, RUN)
    table.add(path, "pictures", PLATE._replace(right=8, wrong=0, worst_n=0.0), 9, WHAT, RUN)
    assert lines(path) == [
        "Seeds 7, 9; commit 12345678; 2026-01-02:",
        "| family | gelslim |",
        "| plates | 1/16; 4/10; 0.344 N |",
    ]


def test_the_same_seed_counts_once(tmp_path: Path) -> None:
    path = tmp_path / "hostile.md"
    for seed in (7, 9, 7):
        table.add(path, "pictures", PLATE, seed, WHAT, RUN)
    assert lines(path)[0] == "Seeds 7, 9; commit 12345678; 2026-01-02:"
    assert lines(path)[2:] == ["| plates | 2/16; 4/10; 0.344 N |"]


def test_runs_of_changed_files_do_not_add_up(tmp_path: Path) -> None:
    path, changed = tmp_path / "hostile.md", replace(RUN, commit="12345678" + table.CHANGED)
    for seed in (7, 9):
        table.add(path, "pictures", PLATE, seed, WHAT, changed)
    assert lines(path)[0] == "Seeds 9; commit 12345678 changed; 2026-01-02:"
    assert lines(path)[2:] == ["| plates | 1/8; 2/5; 0.344 N |"]


def test_another_commit_replaces_its_cell_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "hostile.md"
    other = Row("ftouch", "plates", tried=3, right=3, wrong=0)
    for row in (PLATE, PLATE._replace(family="balls", worst_n=0.0, n_good=0), other):
        table.add(path, "pictures", row, 7, WHAT, RUN)
    table.add(path, "stores", Row("", "cuts", tried=2, right=1, wrong=1, worst_n=0.5), 7, WHAT, RUN)
    assert lines(path)[1:4] == [
        "| family | gelslim | ftouch |",
        "| plates | 1/8; 2/5; 0.344 N | 0/3 |",
        "| balls | 1/8 |  |",
    ]
    table.add(path, "pictures", other, 8, WHAT, replace(RUN, commit="99999999", date="2026-01-03"))
    assert lines(path) == [
        "Seeds 7; commit 12345678; 2026-01-02:",
        "| family | gelslim |",
        "| plates | 1/8; 2/5; 0.344 N |",
        "| balls | 1/8 |",
        "Seeds 8; commit 99999999; 2026-01-03:",
        "| family | ftouch |",
        "| plates | 0/3 |",
        "Seeds 7; commit 12345678; 2026-01-02:",
        "| family | - |",
        "| cuts | 1/2; -; 0.500 N |",
    ]


@pytest.mark.parametrize("is_quick", [False, True])
def test_only_full_runs_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_quick: bool
) -> None:
    class Cases:
        @staticmethod
        def rows(seed: int, quick: bool, is_wanted: Wanted) -> list[Row]:
            return [row for row in (PLATE, Row("ftouch", "plates", 3, 3, 0)) if is_wanted(row.board)]

    monkeypatch.setattr(hostile.importlib, "import_module", lambda _: Cases)
    path = tmp_path / "hostile.md"
    words = ["--only", "punches", "--board", "gelslim", "--table", str(path), *(["--quick"] if is_quick else [])]
    assert hostile.main(words) == 1
    assert "gelslim plates" in capsys.readouterr().out
    assert path.exists() is not is_quick
    if not is_quick:
        assert lines(path)[1] == "| family | gelslim |"
