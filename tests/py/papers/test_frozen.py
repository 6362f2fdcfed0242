"""Twins are frozen before our estimators are judged on them: a change is noticed, and what is far off has a reason."""

import re
import shutil

import pytest
from papers.judged import WITHIN, freeze, is_frozen, load_frozen

from ruffini.boards import board_names, boards_folder, find_board
from ruffini.errors import InputError
from ruffini.sim.reproduce.make import digest
from ruffini.sim.reproduce.settings import load_reproduce

FROZEN = [name for name in board_names() if (boards_folder() / name / "frozen.toml").is_file()]


@pytest.mark.parametrize("name", FROZEN)
def test_nobody_changed_a_frozen_twin(name):
    assert is_frozen(find_board(name)), (
        f"board.toml, twin.toml or reproduce.toml of {name} changed since its paper's method was judged: take it back, "
        f"or judge again with `ruffini reproduce {name} --only method --freeze` and say in its README what changed"
    )


@pytest.mark.parametrize("name", FROZEN)
def test_every_figure_of_the_paper_is_met_or_has_a_reason(name):
    board = find_board(name)
    kept = load_frozen(board)
    assert kept is not None
    for printed in load_reproduce(board).published:
        value = kept.figures.get(printed.name)
        is_met = value is not None and abs(value / (printed.value_1e6 * 1e-6) - 1) <= WITHIN
        assert is_met or len(kept.beyond.get(printed.name, "")) > 20, (printed.name, value)


def copied(tmp_path, name="gelslim"):
    folder = tmp_path / name
    shutil.copytree(find_board(name).folder, folder)
    return folder


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("twin.toml", "friction_1e3 = 700", "friction_1e3 = 701"),
        ("twin.toml", "read_1e3 = 800", "read_1e3 = 790"),
        ("board.toml", "modulus_pa = 200000", "modulus_pa = 200001"),
        ("reproduce.toml", "displacement_noise_um = [5, 5, 20]", "displacement_noise_um = [5, 5, 19]"),
        ("reproduce.toml", "depth_um = 600", "depth_um = 601"),
    ],
)
def test_a_change_of_any_constant_is_noticed(tmp_path, file, old, new):
    folder = copied(tmp_path)
    result = {"quick": True, "rows": [{"name": "a", "twin": 1.0, "paper": None, "ratio": None}]}
    freeze(find_board(folder), result)
    assert is_frozen(find_board(folder))
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    assert not is_frozen(find_board(folder))


def test_a_comment_changes_nothing(tmp_path):
    folder = copied(tmp_path)
    before = digest(find_board(folder))
    with (folder / "twin.toml").open("a") as file:
        file.write("# nothing\n")
    assert digest(find_board(folder)) == before


def test_reasons_stay_only_where_they_are_needed(tmp_path):
    folder = copied(tmp_path)
    board = find_board(folder)

    def rows(value):
        return {"quick": False, "rows": [{"name": "a", "twin": value, "paper": 1.0, "ratio": value}]}

    path = freeze(board, rows(3.0))
    with path.open("a") as file:
        file.write('\n[beyond]\n"a" = "because of the wind"\n')
    freeze(board, rows(2.0))
    kept = load_frozen(board)
    assert kept is not None
    assert (kept.figures, kept.beyond, kept.is_quick) == ({"a": 2.0}, {"a": "because of the wind"}, False)
    freeze(board, rows(1.1))
    kept = load_frozen(board)
    assert kept is not None
    assert kept.beyond == {}


def test_what_is_no_frozen_file_is_refused(tmp_path):
    folder = copied(tmp_path)
    (folder / "frozen.toml").write_text("digest = 3\n")
    with pytest.raises(InputError, match="not as it should be"):
        load_frozen(find_board(folder))


def cells_of_readme():
    """(board, what, column, cell) of the table in host/papers/README.md."""
    text = (boards_folder().parent / "host" / "papers" / "README.md").read_text("utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    board = ""
    for named, what, *values in rows[1:]:
        board = match[1] if (match := re.match(r"\[([a-z-]+)\]", named)) else board
        for column, cell in zip(("twin", "paper"), values, strict=False):
            if board in FROZEN and re.search(r"\d", cell):
                yield board, what, column, cell


def test_the_readmes_table_is_of_frozen_figures():
    n_numbers = 0
    for name, what, column, cell in cells_of_readme():
        board = find_board(name)
        kept = load_frozen(board)
        assert kept is not None
        printed = [p.value_1e6 * 1e-6 for p in load_reproduce(board).published]
        known = list(kept.figures.values()) if column == "twin" else printed
        for number in re.findall(r"\d+\.?\d*", cell):
            half = 0.5 * 10.0 ** -len(number.partition(".")[2])
            assert any(abs(value - float(number)) <= half * 1.01 for value in known), (name, what, column, number)
            n_numbers += 1
    assert n_numbers > 40
