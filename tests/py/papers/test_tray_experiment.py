"""How the sprung tray's experiment judges: made-up runs whose errors are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from papers import experiments
from papers.experiments import Options, reproduce
from papers.ftouch.experiment import BENCH, RANGES, Played, _judge, table
from papers.recorded import Recorded

from ruffini.boards import Board, find_board
from ruffini.errors import InputError
from ruffini.estimators.wrench.model import AXES
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce

LATE, FLAG = 5, 8


@pytest.fixture(scope="module")
def board() -> Board:
    return find_board("ftouch")


def played(board: Board, *, ours: float, paper: float, sigma: float) -> Played:
    """A swelling load, errors in per cent of the range; five frames are flagged, one is out of range."""
    run = next(r for r in runs_of(load_reproduce(board, BENCH)) if r.settings.part == "judge")
    truth = np.linspace(0, 0.9, 60)[:, None] * RANGES
    truth[-1, 0] = 1.01
    sign = np.where(np.arange(60) % 2, 1.0, -1.0)[:, None] * RANGES / 100
    flags = np.zeros(60, np.int64)
    flags[:LATE] = FLAG
    said = truth + ours * sign
    said[:LATE] += 50.0  # what is flagged may be wrong
    theirs = truth + paper * sign
    theirs[10] = np.nan
    return Played(Recorded(run, Path()), truth, truth, said, theirs, np.full((60, 6), sigma) * RANGES / 100, flags,
                  np.zeros((60, 3, 3)), np.zeros((3, 3)), None)  # fmt: skip


def test_errors_of_both_on_the_frames_that_both_have(board: Board) -> None:
    said = _judge([played(board, ours=1.0, paper=3.0, sigma=1.0)])
    assert said["frames"] == 60 - LATE - 1
    assert said["flagged"] == LATE
    assert said["paper_lost"] == 1
    assert said["ours"] == pytest.approx((RANGES / 100).tolist())
    assert said["paper"] == pytest.approx((3 * RANGES / 100).tolist())
    assert said["unflagged_wrong"] == 0
    assert _judge([played(board, ours=1.0, paper=3.0, sigma=0.7)])["within_1_sigma"] == [0.0] * 6
    assert said["within_2_sigma"] == said["within_5_sigma"] == [1.0] * 6
    assert said["r2"][0] == pytest.approx(0.998, abs=0.001)


def test_what_is_wrong_without_a_flag_is_counted(board: Board) -> None:
    assert _judge([played(board, ours=6.0, paper=3.0, sigma=1.0)])["unflagged_wrong"] == 60 - LATE - 1
    assert _judge([played(board, ours=6.0, paper=3.0, sigma=1.3)])["unflagged_wrong"] == 0


def test_an_axis_that_the_board_does_not_measure_is_not_judged(board: Board) -> None:
    """Neither right nor wrong: the log hardly loaded it, and every frame says so."""
    run = played(board, ours=6.0, paper=3.0, sigma=1.3)
    run.ours[:, 5] = np.nan
    run.sigma[:, 5] = 0.0
    said = _judge([run])
    assert said["unflagged_wrong"] == 0
    assert said["ours"][5] is said["r2"][5] is said["within_2_sigma"][5] is None
    assert said["within_2_sigma"][0] == 0.0
    assert said["within_5_sigma"][0] == 1.0
    text = table({"board": "b", "quick": False, "sets": {"hand": said}, "published": dict.fromkeys(AXES, 1.0)})
    assert "not measured" in next(row for row in text.splitlines() if row.strip().startswith("Tz"))


def test_the_table_has_both_and_the_papers_columns(board: Board) -> None:
    settings = load_reproduce(board, BENCH)
    result = {
        "board": board.name, "quick": False, "sets": {"hand": _judge([played(board, ours=1.0, paper=3.0, sigma=1.1)])},
        "published": {p.name: p.value_1e6 * 1e-6 for p in settings.published},
    }  # fmt: skip
    line = next(row for row in table(result).splitlines() if row.strip().startswith("Fz"))
    assert line.split() == ["Fz", "0.08", "(1.00", "%)", "0.24", "(3.00", "%)", "0.33", "0.998", "0.984",
                            "100.0,", "100.0,", "100.0", "0.094", "(1.18", "%)", "0.668", "(3.3", "%)"]  # fmt: skip
    assert "SIMULATED" in table(result)


def test_a_board_without_an_experiment_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = load_reproduce(find_board("gelslim")).model_copy(update={"method": "nobody"})
    monkeypatch.setattr(experiments, "load_reproduce", lambda _: named)
    with pytest.raises(InputError, match="is not written"):
        reproduce(find_board("gelslim"), tmp_path, Options())
