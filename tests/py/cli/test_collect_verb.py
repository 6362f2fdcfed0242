"""`ruffini cal collect` without a bench: the dry run, and what it refuses before anything moves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_board import Files, Run
from twinless import board_without_twin

from ruffini.errors import NoDeviceError
from ruffini.files import only_writer
from ruffini.rig.log_file import read_log

RIG = """schema = 1
[reference]
kind = "text"
port = "/dev/none"
unit = "g"
full_scale_n = 20.0
sigma_n = 0.005
[stage]
kind = "marlin"
port = "/dev/none"
origin_mm = [0.0, 0.0, 10.0]
[limits]
half_x_mm = 10.0
half_y_mm = 10.0
top_mm = 3.0
bottom_mm = -2.0
deepest_mm = 0.5
max_force_n = 6.0
"""


def test_dry_run_prints_every_move_and_moves_nothing(files: Files, run: Run, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.h5"
    rig.write_text(RIG)
    words = ("cal", "collect", "--board", files.folder, "--rig", rig, "--out", out, "--n", 10, "--depth-mm", 0.5)
    code, text, _ = run(*words, "--dry-run", "--json")
    result = json.loads(text)
    assert code == 0
    assert (result["state"], result["touches"], result["simulated"]) == ("dry-run", 10, False)
    assert 10 * 0.8 < result["least_s"] < 300
    moves = np.array(result["moves_m"])
    assert len(moves) > 10 * (5 + 5)  # the way down in steps of 0.2 mm, the press in steps of 0.1 mm
    assert moves[:, 2].min() == pytest.approx(-0.0007, abs=2e-4)
    assert moves[-1, 2] == pytest.approx(0.003)
    code, text, _ = run(*words, "--dry-run")
    assert text.count("press at x") == 10
    assert text.count("z ") == len(moves)
    assert list(tmp_path.iterdir()) == [rig]


def test_what_is_not_chosen_is_what_the_boards_estimator_is_fitted_to(run: Run, tmp_path):
    rig, words = tmp_path / "rig.toml", ("--n", 4, "--out", tmp_path / "log.h5", "--dry-run", "--json")
    rig.write_text(RIG.replace("deepest_mm = 0.5", "deepest_mm = 4.0").replace("bottom_mm = -2.0", "bottom_mm = -6.0"))
    turning = tmp_path / "turning.toml"
    turning.write_text(rig.read_text().replace("[limits]", 'rotary_axis = "A"\n[limits]'))
    benches = {"eltac": turning}
    programs = {
        board: json.loads(run("cal", "collect", "--board", board, "--rig", benches.get(board, rig), *words)[1])[
            "program"
        ]
        for board in ("gelslim", "ftouch", "eltac", "gelsight-wedge")
    }
    assert programs == {"gelslim": "grid", "ftouch": "conditions", "eltac": "balls",
                        "gelsight-wedge": "balls"}  # fmt: skip


def test_programs_by_hand_say_what_a_person_will_be_told(files: Files, run: Run, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.h5"
    rig.write_text('schema = 1\n[reference]\nkind = "weight"\nsigma_g = 0.1\n[limits]\nmax_force_n = 5.0\n')
    words = ("cal", "collect", "--board", files.folder, "--rig", rig, "--out", out, "--dry-run")
    assert "0: 20 g at x" in run(*words, "--program", "weights", "--n", 3)[1]
    assert "2: press by hand at x" in run(*words, "--program", "free", "--n", 3)[1]
    text = run(*words, "--program", "conditions")[1]
    assert "1: load -Fz -Tx -Ty, up to 2 N and 10 N mm, then let go" in text
    assert text.count("load") == 18
    code, _, error = run(*words[:-1], "--program", "grid")
    assert code == 2
    assert "a stage needs them" in error
    code, _, error = run(*words, "--program", "weights", "--grams", "20,x")
    assert code == 2
    assert "--grams" in error


def test_a_board_without_a_twin_has_no_simulated_bench(run: Run, tmp_path):
    board = board_without_twin(tmp_path).folder
    code, _, error = run("cal", "collect", "--board", board, "--rig", "sim", "--out", tmp_path / "log.h5")
    assert code == 2
    assert "has no optics to simulate" in error


def test_convert_writes_a_log_once(run: Run, tmp_path):
    csv, out = tmp_path / "a.csv", tmp_path / "a.h5"
    csv.write_text("\n".join(["time_s,fz_N", *(f"{0.1 * k:.1f},{-1.0 * (20 < k < 40)}" for k in range(60))]))
    code, text, _ = run("cal", "convert", csv, "--out", out, "--json")
    assert (code, json.loads(text)["touches"]) == (0, 1)
    assert read_log(out).touches[0].facts["kind"] == "converted"
    code, _, error = run("cal", "convert", csv, "--out", out)
    assert code == 2
    assert "exists" in error


def test_plan_out_of_the_benchs_limits_is_refused_before_anything_is_opened(files: Files, run: Run, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.h5"
    rig.write_text(RIG)
    words = ("cal", "collect", "--board", files.folder, "--rig", rig, "--out", out)
    code, _, error = run(*words, "--depth-mm", 0.8)
    assert code == 4
    assert "is not within 0 to 0.5 mm" in error
    assert not out.with_name("log.h5.parts").exists()
    rig.write_text(RIG.replace("top_mm", "topp_mm"))
    code, _, error = run(*words)
    assert code == 2
    assert "limits.top" in error


def test_a_tip_that_the_benchs_file_describes_is_not_named_again(files: Files, run: Run, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.h5"
    rig.write_text(f'{RIG}[tip]\nshape = "sphere"\ndiameter_mm = 6.0\n')
    code, _, error = run("cal", "collect", "--board", files.folder, "--rig", rig, "--out", out, "--tip", "pen",
                         "--depth-mm", 0.3)  # fmt: skip
    assert code == 2
    assert "the bench's file describes the tip in [tip]; leave the option out" in error
    assert not out.exists()


def test_a_tip_that_was_not_lifted_is_told(run: Run, tmp_path, monkeypatch):
    error = NoDeviceError("it was reset")
    error.add_note("THE TIP WAS NOT LIFTED: it was reset")

    def fail(*_):
        raise error

    monkeypatch.setattr("ruffini.boards.find_board", fail)
    code, _, text = run("cal", "collect", "--board", "x", "--rig", "sim", "--out", tmp_path / "log.h5")
    assert code == 3
    assert "THE TIP WAS NOT LIFTED" in text


@pytest.mark.parametrize("board", ["gelslim", "stereo-fingertip"])
def test_two_runs_of_cal_auto_do_not_share_a_folder(run: Run, tmp_path: Path, board: str) -> None:
    with only_writer(tmp_path):
        code, _, err = run("cal", "auto", "--board", board, "--rig", "sim", "--quick", "--out", tmp_path)
    assert code == 2
    assert "another run writes there now: wait for it, or choose another --out" in err
    assert list(tmp_path.iterdir()) == []
