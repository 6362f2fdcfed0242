"""ruffini cal fit --only wrench --videos as typed: videos beside a load cell in, a table that the core takes out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pressed_gel import small_wedge, write_video
from small_board import Run

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.core import Pipeline

LARGEST_N = 8.0


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    """The verb on four closings on two objects, without --board."""
    (tmp_path / "gelsight-wedge").mkdir()
    (tmp_path / "gelsight-wedge" / "board.toml").write_text(small_wedge())
    (tmp_path / "videos.toml").write_text('force = "load"\nframe = "frame"\nrecording = \'(.*)_\\d\'\n')
    for seed, name in enumerate(("ball_0", "ball_1", "brick_0", "brick_1")):
        load = np.concatenate([np.zeros(35), (LARGEST_N - seed) * np.sin(np.linspace(0, np.pi, 45)) ** 2])
        rows = [f"{k},{one:.4f}" for k, one in enumerate(load)]
        write_video(tmp_path / f"{name}.avi", load.tolist(), rows, noise=2.0, seed=seed)
    return ["cal", "fit", "--only", "wrench", str(tmp_path), "--videos", str(tmp_path / "videos.toml"), "--out",
            str(tmp_path / "wrench.safetensors")]  # fmt: skip


def test_videos_make_a_normal_force_and_nothing_else(words: list[str], run: Run, tmp_path: Path) -> None:
    (tmp_path / "ring_0.avi").write_bytes((tmp_path / "ball_0.avi").read_bytes())
    code, text, err = run(*words, "--board", tmp_path / "gelsight-wedge", "--json")
    assert code == 0, err
    said = json.loads(text)
    assert said["n_recordings"] == 2
    assert said["held_out_by"] == "recording"
    assert set(said["not_measured"]) == {"Fx", "Fy", "Tx", "Ty", "Tz"}
    assert 0.001 < said["axes"]["Fz"]["rmse"] / LARGEST_N < 0.1
    assert "ring_0.avi: left out, no ring_0.csv is beside it" in err
    file = container.read(tmp_path / "wrench.safetensors")
    assert file.kinds == ["wrench"]
    assert file.metadata["gates"] == "passed"
    assert run("cal", "file", "verify", tmp_path / "wrench.safetensors", "--board", tmp_path / "gelsight-wedge")[0] == 0


def test_rigid_objects_make_a_table_of_softness(words: list[str], run: Run, tmp_path: Path) -> None:
    board = tmp_path / "gelsight-wedge"
    (board / "board.toml").write_text(small_wedge().replace("n_x = 4", "n_x = 10").replace("n_y = 3", "n_y = 8"))
    with (tmp_path / "videos.toml").open("a") as file:
        file.write('rigid = ["brick"]\nsqueeze_n = [1, 4]\n')
    code, text, err = run(*words, "--board", board, "--json")
    assert code == 0, err
    assert json.loads(text)["softness"]["force_n"] == [1, 4]
    file = container.read(tmp_path / "wrench.safetensors")
    assert file.kinds == ["softness", "wrench"]
    low, high, *_ = file.tensors["softness.map"].tolist()
    assert (low, high) == (1_000_000, 4_000_000)
    with Pipeline(find_board(board), file.data) as core:
        assert "softness" in core.slots


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (
            ["--columns", "columns.toml", "--board", "gelsight-wedge"],
            "leave --columns and the options that name columns out",
        ),
        (
            ["--time", "t", "--features", "f*", "--wrench", "w", "--board", "gelsight-wedge"],
            "leave --columns and the options",
        ),
        ([], "--videos needs --board"),
    ],
)
def test_options_that_do_not_go_with_videos_are_refused(
    words: list[str], run: Run, tmp_path: Path, more: list[str], sentence: str
) -> None:
    (tmp_path / "columns.toml").write_text('time = "t"\nfeatures = ["f*"]\nwrench = ["w"]\n')
    more = [str(tmp_path / word) if word in ("columns.toml", "gelsight-wedge") else word for word in more]
    code, _, err = run(*words, *more)
    assert code == 2
    assert sentence in err
    assert not (tmp_path / "wrench.safetensors").exists()
