"""Averaging of a held contact, from the truth of the twin to the forces of the board: gain, and no delay."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from ruffini.bench import steady
from ruffini.boards import find_board
from ruffini.errors import InputError

ROOT = Path(__file__).resolve().parents[3]
sys.path.append(str(ROOT / "tests" / "bench"))
import gels  # noqa: E402
import steady as command  # noqa: E402


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A gelslim with two thirds of its nodes along each way, before a coarse truth."""
    folder = tmp_path_factory.mktemp("board") / "gelslim"
    shutil.copytree(ROOT / "boards" / "gelslim", folder)
    board = (folder / "board.toml").read_text()
    assert "n_x = 31\nn_y = 25\n" in board
    (folder / "board.toml").write_text(board.replace("n_x = 31\nn_y = 25\n", "n_x = 21\nn_y = 17\n"))
    (folder / "twin.toml").write_text((folder / "twin.toml").read_text() + "[mesh]\ncells_x = 16\ncells_y = 13\n")
    return steady.run(find_board(str(folder)), quick=True)


def test_held_noise_and_false_shear_fall(result: dict[str, Any]) -> None:
    each, averaged = (result["held"][name] for name in steady.NAMES)
    assert averaged["shear_n"] < 0.7 * each["shear_n"]
    assert averaged["normal_n"] < 0.8 * each["normal_n"]
    assert averaged["false_shear"] < each["false_shear"]
    assert averaged["tangential"] < each["tangential"]
    assert averaged["normal"] < each["normal"]


def test_a_step_of_force_shows_whole_in_its_frame(result: dict[str, Any]) -> None:
    assert list(result["steps"]) == ["5 %", "10 %", "30 %", "100 %"]
    for name, step in result["steps"].items():
        assert step["lost_un"] < 1e-3, name
        assert step["seen"] == pytest.approx(step["seen_each"], abs=0.3 if name == "5 %" else 0.15), name
        assert step["error_ratio"] <= 1.03, name
    assert result["steps"]["100 %"]["error_ratio"] == 1.0  # nothing of the frames before


def test_slip_is_not_smeared(result: dict[str, Any]) -> None:
    (moving,) = result["moving"].values()
    each, averaged = (moving[name] for name in steady.NAMES)
    assert moving["worst_ratio"] < 1.1
    assert averaged["tangential"] <= 1.01 * each["tangential"]
    assert averaged["normal"] <= 1.01 * each["normal"]


def test_the_text_and_the_row_hold_both(result: dict[str, Any]) -> None:
    text = steady.table(result)
    assert "SIMULATED" in text
    assert all(re.search(rf"(?m)^ *{name} ", text) for name in (*steady.NAMES, "5 %", "flat sheared until it slides"))
    row = command.row(result, "12345678", "2026-01-02")
    assert row.startswith("| gelslim | ")
    assert row.count("|") == len(command.COLUMNS) + 1
    document = (ROOT / "docs" / "results" / "accuracy.md").read_text()
    assert row in gels.with_row(document, row, command.SECTION, command.COLUMNS)


def test_a_board_that_already_averages_is_set_back() -> None:
    board = find_board("gelslim")
    assert board.contact.steady_frames == 1
    twelve = steady.averaging(board, 12)
    assert twelve.contact.steady_frames == 12
    assert steady.averaging(twelve, 1).contact.steady_frames == 1


def test_a_board_without_a_field_is_refused() -> None:
    with pytest.raises(InputError, match="no field of forces"):
        steady.run(find_board("ninedtact"))
