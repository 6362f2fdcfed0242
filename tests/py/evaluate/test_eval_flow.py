"""`ruffini eval flow`: the figures that flow must meet, beside OpenCV in the same run, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.evaluate.flow import board_for, evaluate, followed, glitter, speckle, table
from ruffini.evaluate.warps import Warp

DOTS = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")


@pytest.fixture(scope="module")
def judged() -> dict[str, Any]:
    return evaluate(None, None, n_fields=3)


def test_error_not_above_dis_medium_in_the_same_run(judged: dict[str, Any]) -> None:
    assert set(judged["textures"]) == {"speckle", "glitter"}
    for row in judged["textures"].values():
        assert 4 < row["largest_px"] < 16
        for where in ("rms_px", "dense_rms_px"):
            assert 0.01 < row["ruffini"][where] < row["medium"][where] < row["ultrafast"][where]
    assert "DIS ultrafast" in table(judged)


def test_quality_foretells_the_error(judged: dict[str, Any]) -> None:
    """What it states is near the error, and its worst quarter errs clearly more than its best."""
    for row in judged["textures"].values():
        quality = row["quality"]
        assert 0.6 < quality["stated_px"] / quality["rms_px"] < 1.6
        assert quality["worst_quarter_px"] > 1.5 * quality["best_quarter_px"]
        assert quality["rank_correlation"] < -0.2


@pytest.mark.parametrize("make", [speckle, glitter])
def test_patches_follow_the_field_and_say_when_they_do_not(make: object) -> None:
    assert callable(make)
    rng = np.random.default_rng(8)
    still = make(rng, (120, 200))
    warp = Warp.random(rng, (200, 120), 5.0)
    moved = warp.render(still, rng)
    moved[:, :60] = make(np.random.default_rng(9), (120, 60))  # another texture there
    places, found, quality, _ = followed(board_for(still), still, moved)
    lost = quality == 0
    inner = ((places > 20) & (places < np.array([180, 100]))).all(axis=1)
    apart = np.linalg.norm(found - warp.forward(places), axis=1)
    true = inner & ~lost & (places[:, 0] > 90)
    assert np.sqrt((apart[true] ** 2).mean()) < 0.1
    assert true.sum() > 0.7 * (inner & (places[:, 0] > 90)).sum()
    assert lost[inner & (places[:, 0] < 40)].mean() > 0.85


def test_the_verb_on_a_picture(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "pad.png"), speckle(np.random.default_rng(1), (150, 180)))
    words = ["eval", "flow", str(tmp_path / "pad.png"), "--fields", "2", "--json", "--out", str(tmp_path / "flow.png")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["textures"]["picture"]["fields"] == 2
    assert np.asarray(cv2.imread(result["picture"])).std() > 10


def test_what_cannot_be_judged() -> None:
    with pytest.raises(InputError, match="follows no texture"):
        evaluate(np.zeros((240, 320, 3), np.uint8), DOTS)
    with pytest.raises(InputError, match="too small for flow"):
        evaluate(np.zeros((30, 200, 3), np.uint8), None)
    with pytest.raises(InputError, match="no patch of the picture has texture enough"):
        evaluate(np.full((120, 160, 3), 90, np.uint8), None, n_fields=1)
    textured = board_for(np.zeros((240, 320, 3), np.uint8))
    with pytest.raises(InputError, match="the picture is 160x120"):
        evaluate(np.zeros((120, 160, 3), np.uint8), textured)
