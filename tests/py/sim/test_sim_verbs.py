"""The twin's verbs as a person types them: one JSON object, documented exit codes, one sentence when it is wrong."""

import json
import shutil

import pytest
from command_line import refusal_in
from twinless import board_without_twin

from ruffini.boards import find_board

COARSE = "\n[mesh]\ncells_x = 10\ncells_y = 8\n"


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards") / "gelslim"
    shutil.copytree(find_board("gelslim").folder, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write(COARSE)
    return folder


def test_press_with_a_scenario(board, ruffini, tmp_path):
    (tmp_path / "s.toml").write_text(
        'schema = 1\nprogram = "rest"\nn = 3\n'
        '[[fault]]\nkind = "drop"\nshare_1e3 = 1000\nfirst_frame = 1\nn_frames = 1\n'
    )
    done = ruffini("sim", "press", "--board", board, "--scenario", tmp_path / "s.toml", "--out", tmp_path / "out",
        "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert json.loads(done.out) == {"folder": str(tmp_path / "out"), "frames": 2, "simulated": True}
    assert sorted(p.name for p in (tmp_path / "out" / "frames").iterdir()) == ["000000.png", "000002.png"]


def test_dataset_goes_on_where_it_was(board, ruffini, tmp_path):
    words = ("sim", "dataset", "--board", board, "--n", 3, "--shard-size", 2, "--out", tmp_path / "d", "--json")
    first, again = (json.loads(ruffini(*words).out) for _ in range(2))
    assert (first["shards_made"], first["shards_kept"]) == (2, 0)
    assert (again["shards_made"], again["shards_kept"], again["samples_per_s"]) == (0, 2, None)


def test_bench_is_one_object(board, ruffini):
    result = json.loads(ruffini("bench", "twin", "--board", board, "--json").out)
    assert min(result["rendering_fps"], result["mechanics_fps"]) > 0


def test_serve_feeds_a_daemon_and_ends_with_it(board, serve_once):
    serve_once(board)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("press", "--program", "dance", "--out", "out"), "unknown program 'dance'"),
        (("press", "--program", "grid", "--n", "0", "--out", "out"), "options: n: "),
        (("press", "--scenario", "missing.toml", "--out", "out"), "missing.toml: cannot be read"),
        (("dataset", "--n", "0", "--out", "out"), "dataset: n: "),
        (("dataset", "--n", "1", "--out", "twin.toml"), "twin.toml cannot be written"),
        (("serve", "--socket", "no/such/folder/s"), "choose another --socket"),
        (("serve", "--socket", "s" * 200), "choose another --socket"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(board, ruffini, tmp_path, words, sentence):
    (tmp_path / "twin.toml").write_text("a file, no folder")
    done = ruffini("sim", words[0], "--board", board, *words[1:], cwd=tmp_path)
    assert done.code == 2, done.err
    assert sentence in refusal_in(done.err)
    assert not done.out


def test_board_without_optics_is_refused(ruffini, tmp_path):
    out, board = ("--out", tmp_path / "out"), board_without_twin(tmp_path).folder
    for words in (("sim", "press", *out), ("sim", "dataset", "--n", 1, *out), ("bench", "twin")):
        done = ruffini(*words, "--board", board)
        assert done.code == 2
        assert "has no optics to simulate" in refusal_in(done.err)
    assert not (tmp_path / "out").exists()
