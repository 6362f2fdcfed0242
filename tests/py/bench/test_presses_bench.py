"""The comparison with recorded presses: it finds its own lamps again, and notices presses that are not theirs."""

import csv

import cv2
import numpy as np
import pytest

from ruffini.bench import presses as comparison
from ruffini.boards import find_board
from ruffini.estimators.photometric.presses import load_presses
from ruffini.sim.recording import record_balls
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """Presses of another twin: finer mesh, noise, errors of marking, lamps elsewhere than the fit starts."""
    board = find_board("gelslim")
    twin = load_twin(board).model_copy(update={"dots": None})
    twin = twin.model_copy(update={"mesh": twin.mesh.model_copy(update={"cells_x": 16, "cells_y": 13})})
    folder = tmp_path_factory.mktemp("presses") / "balls"
    record_balls(TwinUnit.build(board, twin=twin), 8, folder, ball_mm=6.0, seed=4)
    return folder


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(comparison, "THICKNESSES_UM", (4000,))
    monkeypatch.setattr(comparison, "MESH", {"cells_x": 14, "cells_y": 11})


def test_it_recognises_presses_of_a_twin(balls, tmp_path):
    result, text = comparison.run(load_presses(balls), tmp_path / "side.png")
    inside = result["rings"][0]
    assert inside["recorded_rms"] > 0.1
    assert inside["correlation"] > 0.9
    assert inside["difference_rms"] < 0.5 * inside["recorded_rms"]
    assert (result["fitted_on"], result["judged_on"]) == (4, 4)
    for row in result["rings"]:
        assert f"{row['correlation']:.3f}" in text
    picture = cv2.imread(str(tmp_path / "side.png"))
    assert picture.shape == (480, 4 * 320, 3)
    assert picture.std() > 5


def test_presses_with_each_others_circles_are_not_explained(balls):
    with (balls / "presses.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [row["image"] for row in rows]
    for row, name in zip(rows, names[1:] + names[:1], strict=True):
        row["image"] = name
    with (balls / "shuffled.csv").open("w") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    result, _ = comparison.run(load_presses(balls, truth=balls / "shuffled.csv"), None)
    assert result["rings"][0]["correlation"] < 0.6


def test_modelled_light_is_the_renderers(balls):
    """The fit's formula and the camera's give the same relative change."""
    recorded = load_presses(balls)
    lamps = comparison.Lamps.unpack(comparison.START)
    unit = TwinUnit.build(comparison.board_of(recorded, 4000), twin=lamps.settings(100))
    found = comparison.scenes(recorded, unit)[:1]
    rendered = comparison.rendered_change(unit, found)[0].reshape(-1, 3)
    pick = np.arange(0, len(rendered), 97)
    modelled = comparison._relative(lamps, found[0], comparison._rest_points(recorded), pick)
    np.testing.assert_allclose(modelled, rendered[pick], atol=0.04)
    assert np.abs(rendered[pick]).max() > 0.15
