"""The host's settings of a board: what the parser in libruffini read, compared with another reader of TOML."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import tomllib

from ruffini import native
from ruffini.boards import Board, board_names, find_board, parse_board
from ruffini.errors import InputError, RuffiniError
from ruffini.native import library

FOLDER = Path(__file__).parents[2] / "data" / "boards"
BASE = (FOLDER / "base.toml").read_text()
EVERYTHING = BASE + (FOLDER / "optional.toml").read_text()
# The keys that exclude others, or that a board may leave out.
OTHERS = (
    EVERYTHING.replace("red_1e3 = 1500\nblue_1e3 = 1700", "white_kelvin = 5000")
    .replace('polarity = "dark"\nn_x = 19\nn_y = 15',
             'polarity = "light"\nlayout = "scattered"\nplaces_um = [[0, 0], [1, 2], [3, 4], [5, 6]]\nn_x = 2\nn_y = 2')
    .replace("[eeprom]\n", "[eeprom]\nboard_address = 81\n")
    .replace("[led_driver]\n", "[led_driver]\nmax_milli_celsius = 60000\n")
)  # fmt: skip
SPELLINGS = (
    BASE.replace("width_px = 320", "width_px = 0x140").replace("200000", "200_000").replace("n_x = 31", "n_x = +31")
    .replace('"sample"', "'a \"b\" \\ c'").replace('"a board for tests"', '"\\u0061 \\"board\\" \\\\ {}:,"')
)  # fmt: skip
DEFAULTS = {
    "pad": {"stiffness_sigma_1e3": 100},
    "markers": {"layout": "lattice"},
    "depth": {"source": "light"},
    "contact": {"steady_frames": 1},
    "light": {"alternation": "none"},
    "pipeline": {"cores": 1},
}
# Of sections that no stage of the board reads: the pad's corners as nodes, all of it observed.
LEFT_OUT: dict[str, dict[str, Any]] = {
    "grid": {"n_x": 2, "n_y": 2, "n_layers": 2},
    "depth": {"gauge": "margin", "margin_um": 0, "step_px": 1, "source": "light"},
    "contact": {"threshold_un": 1, "min_nodes": 1, "steady_frames": 1},
    "field": {"force_lsb_un": 10},
}


def expected(text: str) -> dict[str, Any]:
    """The tree of the file with the defaults of boards/README.md."""
    tree = tomllib.loads(text)
    tree.setdefault("memory", {"calibration_kb": 131_072})
    if "grid" not in tree:
        size = {f"max_{axis}_um": tree["pad"][f"size_{axis}_um"] for axis in "xy"}
        tree |= {"window": {"min_x_um": 0, "min_y_um": 0, **size}}
    tree = LEFT_OUT | tree
    for section, keys in DEFAULTS.items():
        if section in tree:
            tree[section] = {**keys, **tree[section]}
    return tree


def texts() -> list[str]:
    return [BASE, EVERYTHING, OTHERS, SPELLINGS, *(find_board(name).text for name in board_names())]


def test_settings_are_what_another_reader_of_toml_finds() -> None:
    assert len(board_names()) >= 2
    for text in texts():
        board = parse_board(text, "here")
        assert board.text == text
        assert board.model_dump(by_alias=True, exclude_none=True) == expected(text)


def test_together_the_texts_have_every_key() -> None:
    boards = [parse_board(text, "here") for text in (EVERYTHING, OTHERS)]
    for name in Board.model_fields:
        sections = [getattr(board, name) for board in boards]
        assert None not in sections, name
        for key in getattr(type(sections[0]), "model_fields", {}):
            assert any(getattr(section, key) is not None for section in sections), f"{name}.{key}"


def test_json_has_its_keys_in_order_and_plain_integers() -> None:
    def in_order(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        assert [key for key, _ in pairs] == sorted(key for key, _ in pairs)
        return dict(pairs)

    def never(text: str) -> None:
        raise AssertionError(f"{text} is no integer")

    for text in texts():
        raw = text.encode()
        said = library().ruffini_board_json(raw, ctypes.c_size_t(len(raw)), b"here")
        assert json.loads(said, object_pairs_hook=in_order, parse_float=never, parse_constant=never) == expected(text)


@pytest.mark.parametrize(
    ("find", "put", "said"),
    [
        ("n_y = 25", "n_y = 1", "b.toml:27: grid.n_y = 1 is outside 2 to 255 (boards/README.md lists the keys)"),
        ("schema", "[", "b.toml:1: not TOML: "),
        ("a board", "\u00e4", "b.toml:5: a character that is not plain ASCII"),
        ("a board", "\0", "b.toml:5: a character that is not plain ASCII"),
    ],
)
def test_the_sentence_is_the_parser_s(find: str, put: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        parse_board(BASE.replace(find, put), "b.toml")
    assert str(error.value).startswith(said)


def test_a_file_s_name_may_be_any_bytes() -> None:
    with pytest.raises(InputError, match=r"^a\\udcff\\n/b\.toml: schema must be 1"):
        parse_board("", os.fsdecode(b"a\xff\n/b.toml"))


def test_boards_are_found_by_name_and_by_folder(tmp_path: Path) -> None:
    for name in board_names():
        assert find_board(name).name == name
    with pytest.raises(InputError, match=r"no board 'nothing'.*gelslim"):
        find_board("nothing")
    (tmp_path / "sample").mkdir()
    (tmp_path / "sample" / "board.toml").write_text(BASE)
    assert find_board(tmp_path / "sample").folder == tmp_path / "sample"
    (tmp_path / "sample").rename(tmp_path / "other")
    with pytest.raises(InputError, match="'sample' but the folder is called 'other'"):
        find_board(tmp_path / "other")


def run_without_library(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A verb in a package that was installed without its library."""
    code = """
import sys
import ruffini.native
from ruffini.cli import main
ruffini.native.__file__ = "/nowhere/at/all/native.py"
sys.argv[0] = "ruffini"
sys.exit(main())
"""
    environment = {**os.environ, "RUFFINI_NATIVE_DIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", code, *words], env=environment, capture_output=True, text=True, timeout=60, check=False
    )


def test_without_the_library_one_sentence_says_so_and_other_verbs_work(tmp_path: Path) -> None:
    needs_it = run_without_library(tmp_path, "board", "check", "gelslim")
    assert "libruffini.so was not found: run `make build`, or set RUFFINI_NATIVE_DIR to its folder" in needs_it.stderr
    assert (needs_it.returncode, len(needs_it.stderr.splitlines())) == (1, 1)
    for words in (["--help"], ["board", "check", "--help"], ["board", "list"]):
        done = run_without_library(tmp_path, *words)
        assert (done.returncode, done.stderr) == (0, ""), words


@pytest.mark.parametrize("content", [b"", b"made for another machine"])
def test_a_library_that_cannot_be_loaded_is_one_sentence(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "libruffini.so").write_bytes(content)
    monkeypatch.setenv("RUFFINI_NATIVE_DIR", str(tmp_path))
    with pytest.raises(RuffiniError, match=r"libruffini\.so cannot be used on this machine: .*: run `make build`$"):
        native.library.__wrapped__()


def test_a_library_older_than_the_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    older = ctypes.CDLL(None)  # has none of the functions
    monkeypatch.setattr(ctypes, "CDLL", lambda _: older)
    with pytest.raises(RuffiniError, match=r"cannot be used on this machine: .*ruffini_error: run `make build`$"):
        native.library.__wrapped__()
