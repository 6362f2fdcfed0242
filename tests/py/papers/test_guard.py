"""Figures are guarded: a worse one fails, a better one asks to be frozen, and every figure is stated as wanted."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from papers import experiments
from papers.experiments import Experiment, Figure, Options
from papers.guard import check_method, check_ours
from papers.judged import Frozen, freeze_ours, load_frozen
from papers.wanted import Row, WantedFigure, load_wanted, rows_of, table

from ruffini.boards import Board, board_names, boards_folder, find_board
from ruffini.cli import main
from ruffini.errors import InputError

WITH_WANTED = [name for name in board_names() if (boards_folder() / name / "wanted.toml").is_file()]
WANTED = """
schema = 1
[[figure]]
name = "force"
unit = "N"
at_most = 0.5
worse_part = 0.1
limit = "a bound of the twin"
[[figure]]
name = "told"
unit = "%"
at_least = 90
worse_part = 0.0
worse_by = 2.0
[[figure]]
name = "within 2 sigma"
at_least = 92
at_most = 98
worse_part = 0.0
worse_by = 1.0
"""
FROZEN = {"force": 1.0, "told": 95.0, "within 2 sigma": 97.0}


@pytest.fixture
def board(tmp_path: Path) -> Board:
    folder = tmp_path / "gelslim"
    shutil.copytree(find_board("gelslim").folder or Path(), folder)
    (folder / "wanted.toml").write_text(WANTED)
    made = find_board(str(folder))
    freeze_ours(made, FROZEN, quick=False)
    freeze_ours(made, {}, quick=True)
    return made


def states(board: Board, **now: float) -> dict[str, str]:
    values = FROZEN | {name.replace("_", " "): value for name, value in now.items()}
    measured = {name: Figure(value) for name, value in values.items()}
    check = check_ours(rows_of(board, measured), load_frozen(board), quick=False)
    return {v.name: v.state for v in check.verdicts if v.state != "same"} | {"passed": str(check.is_passed)}


@pytest.mark.parametrize(
    ("now", "found"),
    [
        ({}, {"passed": "True"}),
        ({"force": 1.09}, {"passed": "True"}),
        ({"force": 1.11}, {"force": "worse", "passed": "False"}),
        ({"force": 0.89}, {"force": "better", "passed": "True"}),
        ({"told": 93.1}, {"passed": "True"}),
        ({"told": 92.9}, {"told": "worse", "passed": "False"}),
        ({"told": 97.1}, {"told": "better", "passed": "True"}),
        ({"within_2_sigma": 93.0}, {"passed": "True"}),  # anywhere in the range is alike
        ({"within_2_sigma": 98.9}, {"passed": "True"}),
        ({"within_2_sigma": 99.1}, {"within 2 sigma": "worse", "passed": "False"}),
        ({"within_2_sigma": 90.9}, {"within 2 sigma": "worse", "passed": "False"}),
        ({"force": float("nan")}, {"force": "not measured", "passed": "False"}),
    ],
)
def test_worse_fails_and_better_asks(board: Board, now: dict[str, float], found: dict[str, str]) -> None:
    assert states(board, **now) == found


def test_a_figure_that_a_run_no_longer_gives_or_that_nobody_froze_fails(board: Board) -> None:
    rows = rows_of(board, {"force": Figure(1.0), "told": Figure(95.0)})
    check = check_ours(rows, load_frozen(board), quick=False)
    assert [(v.name, v.state) for v in check.verdicts if v.state != "same"] == [("within 2 sigma", "not measured")]
    assert not check.is_passed
    assert {v.state for v in check_ours(rows, load_frozen(board), quick=True).verdicts} == {"not frozen"}
    assert not check_ours(rows, None, quick=False).is_passed


def test_what_is_frozen_and_no_longer_wanted_is_not_forgotten(board: Board) -> None:
    freeze_ours(board, FROZEN | {"gone": 1.0}, quick=False)
    assert states(board) == {"gone": "not measured", "passed": "False"}


def test_a_measured_figure_that_nobody_wants_is_refused(board: Board) -> None:
    with pytest.raises(InputError, match=r"wanted\.toml .* does not state what is wanted of 'depth'"):
        rows_of(board, {"depth": Figure(1.0)})


def test_freezing_ours_leaves_the_method_and_the_other_subset(board: Board) -> None:
    before = load_frozen(find_board("gelslim"))
    freeze_ours(board, {"force": 3.0}, quick=True)
    after = load_frozen(board)
    assert before is not None
    assert after is not None
    assert (after.digest, after.figures, after.beyond) == (before.digest, before.figures, before.beyond)
    assert (after.ours, after.ours_quick) == (FROZEN, {"force": 3.0})


@pytest.mark.parametrize(
    ("value", "paper", "state"),
    [
        (1.0, 1.2, "same"), (1.02, 1.2, "same"), (1.1, 1.2, "better"), (0.9, 1.2, "worse"), (1.6, 1.2, "worse"),
        (1.1, None, "worse"), (0.9, None, "worse"), (None, 1.2, "not measured"),
    ],
)  # fmt: skip
def test_a_method_may_move_towards_its_paper_only(value: float | None, paper: float | None, state: str) -> None:
    result = {"quick": False, "rows": [{"name": "a", "twin": value, "paper": paper}]}
    frozen = Frozen("", False, {"a": 1.0}, {})
    check = check_method(result, frozen)
    assert [v.state for v in check.verdicts] == [state]
    assert check.is_passed == (state in ("same", "better"))
    quick = check_method({"quick": True, "rows": [{"name": "a", "twin": 1.0, "paper": None}]}, frozen)
    assert [v.state for v in quick.verdicts] == ["not frozen"]


def test_the_table_says_what_is_met_and_why_not(board: Board) -> None:
    figures = {"force": Figure(1.0, 2.5, 3.25), "told": Figure(95.0)}
    lines = table(board, rows_of(board, figures), quick=False).splitlines()
    assert lines[2].split() == ["force,", "N", "1", "2.5", "3.25", "<=", "0.5", "NO"]
    assert lines[3].split() == ["told,", "%", "95", "-", "-", ">=", "90", "yes"]
    assert lines[4].split()[-3:] == ["NO:", "not", "measured"]
    assert lines[5:] == [
        "  met: 1 of 3", "  not met, force: a bound of the twin", "  not met, within 2 sigma: NO REASON STATED",
    ]  # fmt: skip
    quick = table(board, rows_of(board, figures), quick=True)
    assert "met: 1 of 2; not in the quick subset: 1" in quick


def test_a_reason_of_the_quick_run_alone_is_no_reason_of_the_whole_one(board: Board) -> None:
    row = Row(WantedFigure(name="depth", at_most=0.1, limit_quick="few presses"), Figure(0.2))
    assert "not met, depth: few presses" in table(board, [row], quick=True)
    assert "not met, depth: NO REASON STATED" in table(board, [row], quick=False)
    assert [row.tree(quick=quick)["limit"] for quick in (True, False)] == ["few presses", ""]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("at_most = 0.5\n", "", "needs at_most or at_least"),
        ('name = "told"', 'name = "force"', "named twice"),
        ("worse_part = 0.1", "worse = 0.1", "Extra inputs"),
    ],
)
def test_a_wrong_wanted_file_is_refused(board: Board, old: str, new: str, message: str) -> None:
    path = (board.folder or Path()) / "wanted.toml"
    path.write_text(WANTED.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        load_wanted(board)


def played(monkeypatch: pytest.MonkeyPatch, force: float) -> None:
    def reproduce(board: Board, out: Path, options: Options) -> Experiment:
        out.mkdir(parents=True, exist_ok=True)
        return Experiment({"simulated": True}, "", [], {n: Figure(v) for n, v in (FROZEN | {"force": force}).items()})

    monkeypatch.setattr(experiments, "reproduce", reproduce)


def test_the_verb_fails_on_a_planted_worse_figure(
    board: Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def verb(*more: str) -> int:
        words = ["reproduce", str(board.folder), "--out", str(tmp_path / "out"), *more]
        monkeypatch.setattr("sys.argv", ["ruffini", *words])
        return int(main() or 0)

    played(monkeypatch, 1.0)
    assert verb("--check") == 0
    played(monkeypatch, 1.5)
    assert verb("--check") == 1
    assert "worse" in capsys.readouterr().out
    assert verb() == 0  # only --check judges
    played(monkeypatch, 0.5)
    assert verb("--check") == 0
    assert "run again with --freeze" in capsys.readouterr().out
    assert verb("--freeze") == 0
    played(monkeypatch, 1.0)
    assert verb("--check") == 1  # what was reached once stays


@pytest.mark.parametrize("name", WITH_WANTED)
def test_every_frozen_figure_is_wanted_and_met_or_has_a_reason(name: str) -> None:
    board = find_board(name)
    wanted: dict[str, WantedFigure] = {one.name: one for one in load_wanted(board)}
    frozen = load_frozen(board)
    assert frozen is not None
    for figures, quick in ((frozen.ours, False), (frozen.ours_quick, True)):
        assert set(figures) <= set(wanted)
        unmet = [wanted[n] for n, value in figures.items() if not wanted[n].is_met(value)]
        assert [one.name for one in unmet if not one.reason(quick=quick)] == []


def test_every_board_of_a_paper_has_wanted_figures() -> None:
    of_paper = {name for name in board_names() if (boards_folder() / name / "frozen.toml").is_file()}
    assert of_paper == set(WITH_WANTED)
