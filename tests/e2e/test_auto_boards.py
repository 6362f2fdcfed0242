"""`ruffini cal auto --rig sim` on each board: what its estimator presses is collected, kept and judged, or one sentence
says what to do instead. What the estimators make of such logs is tested with each of them."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from test_bad_input import run_host
from tiny_sensor import ROOT

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.calibrate.auto.fingertip import eyes_apart_mm
from ruffini.calibrate.gates import MIN_PRESSES
from ruffini.cli.auto import simulated_site
from ruffini.estimators.table import task_of
from ruffini.estimators.task import Turned
from ruffini.estimators.wrench.log import features_of, read_feature_runs
from ruffini.rig.collect import collect, rehearse
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.program import PROGRAMS
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce

ALWAYS = {"gelslim", "ftouch", "digit-tactile"}  # a field by a stage, a wrench by a person, a gel without markers
BOARDS = [
    pytest.param(name, marks=() if name in ALWAYS else pytest.mark.long)
    for name in sorted(path.parent.name for path in (ROOT / "boards").glob("*/board.toml"))
]
COARSE = "cells_x = 10\ncells_y = 8"
LEAST_N = 0.1


def coarse(name: str, folder: Path, cells: str = COARSE) -> Board:
    """A board whose twin's pad has few elements."""
    shutil.copytree(ROOT / "boards" / name, folder / name)
    twin = folder / name / "twin.toml"
    text, n = re.subn(r"cells_x = \d+\ncells_y = \d+", cells, twin.read_text())
    is_flat = "[shape]" not in text
    twin.write_text(f"{text}\n[mesh]\n{cells}\n" if is_flat and not n else text)
    return find_board(folder / name)


@pytest.mark.parametrize("name", BOARDS)
def test_what_a_boards_estimator_presses_is_collected_or_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    board = coarse(name, tmp_path)
    task = task_of(board)
    if isinstance(task, Turned):  # played whole in tests/py/auto
        parts = Counter(run.settings.part for run in runs_of(load_reproduce(board, task.presses), quick=True))
        assert parts["fit"] >= MIN_PRESSES  # of --quick, too: the gate refuses fewer
        assert parts["judge"] > 1
        assert eyes_apart_mm(board) > 0
        return
    site = simulated_site(board, task, tmp_path, 1e-3 * task.depth_mm, 1e-3 * task.shear_mm, 1)
    fitted, judged = task.fitted(site.span, task.quick.fitted, 2), task.judged(site.span, task.quick.judged, 1001)
    log = LogWriter(tmp_path / "log.h5", {"board": board.name, "program": task.program, "tip": site.tip})
    with site.open(task.program, None, 2) as (bench, truth):
        if PROGRAMS[task.program].is_by_stage:
            assert bench.stage is not None
            for touches in (fitted, judged):
                assert rehearse(touches, bench.stage.limits).lines
        collect(bench, fitted[:1], log)
    (touch,) = read_log(tmp_path / "log.h5").touches
    assert truth is not None
    true = truth.of(touch)
    assert np.nanmax(np.linalg.norm(true[:, :3], axis=1)) > LEAST_N
    if board.writes("features") and features_of(board).grid is not None:
        (run,) = read_feature_runs([tmp_path / "log.h5"], board)
        size, force = np.linalg.norm(run.features, axis=1), -run.at(0.0)[:, 2]
        assert np.corrcoef(size, force)[0, 1] > 0.95
    word = task.word(board, read_log(tmp_path / "log.h5"), touch, true)
    assert np.isfinite(word.true).all()
    assert task.figures([word])["largest_force_n"] > LEAST_N


@pytest.mark.long
def test_a_board_with_moments_of_depth_is_calibrated_from_its_colours_on(tmp_path: Path) -> None:
    """Its features need the unit's colours, which the same run fits first."""
    folder = tmp_path / "digit-tactile"
    text = coarse("digit-tactile", tmp_path).text
    head = text[: text.index("stages = ")]
    grid = head[head.index("[picture_features]") : head.index("[depth]")]
    stages = '["difference", "photometric", "poisson", "depth_moments", "feature_wrench"]'
    (folder / "board.toml").write_text(f"{head.replace(grid, '')}stages = {stages}\n")
    out = tmp_path / "out"
    code, said, text = run_host(
        "cal", "auto", "--board", str(folder), "--rig", "sim", "--quick", "--json", "--out", str(out)
    )
    assert code == 0, text
    file = container.read(out / "calibration.safetensors")
    assert {"photometric", "wrench"} <= set(file.kinds)
    assert file.metadata["wrench.features"] == "depth"
    after = json.loads(said)["after"]
    assert after["axes_rmse_n_nm"][2] < 0.1 * after["largest_force_n"]
