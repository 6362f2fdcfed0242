"""`ruffini cal collect` without a bench: the dry run, and what it refuses before anything moves."""

from __future__ import annotations

import json

from small_board import Files, Run

from ruffini.errors import NoDeviceError

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


def test_dry_run_tells_how_long_and_moves_nothing(files: Files, run: Run, tmp_path):
    out = tmp_path / "log.h5"
    code, text, _ = run("cal", "collect", "--board", files.folder, "--rig", "sim", "--out", out, "--n", 10,
                        "--dry-run", "--json")  # fmt: skip
    result = json.loads(text)
    assert code == 0
    assert (result["state"], result["touches"], result["simulated"]) == ("dry-run", 10, True)
    assert 10 * 0.8 < result["least_s"] < 300
    assert list(tmp_path.iterdir()) == []


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


def test_a_tip_that_was_not_lifted_is_told(run: Run, tmp_path, monkeypatch):
    error = NoDeviceError("it was reset")
    error.add_note("THE TIP WAS NOT LIFTED: it was reset")

    def fail(*_):
        raise error

    monkeypatch.setattr("ruffini.boards.find_board", fail)
    code, _, text = run("cal", "collect", "--board", "x", "--rig", "sim", "--out", tmp_path / "log.h5")
    assert code == 3
    assert "THE TIP WAS NOT LIFTED" in text
