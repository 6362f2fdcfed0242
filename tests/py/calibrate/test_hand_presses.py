"""Presses by hand in a fit: they teach colours, and the report names the worst and sees them as the fit did."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.calibrate.log.touches import file_sha256
from ruffini.estimators.operator.report import _worst
from ruffini.estimators.operator.stage import _saw_pictures
from ruffini.estimators.photometric.stage import _write_presses
from ruffini.rig.log_file import Log, TouchRecord
from ruffini.rig.program import ScalePress
from ruffini.view.scale_calibration import _by_force

BALL = {"tip": {"shape": "sphere", "radius_m": 0.003}}


@pytest.mark.parametrize(("kind", "n"), [("press", 1), ("scale", 1), ("hand", 1), ("condition", 0), ("weight", 0)])
def test_straight_presses_with_a_ball_teach_colours(kind: str, n: int, tmp_path: Path) -> None:
    pictures = np.zeros((3, 8, 8, 3), np.uint8)
    touch = TouchRecord({"kind": kind}, {"image": pictures, "image_s": np.arange(3.0)})
    assert _write_presses(Log(BALL, [touch]), tmp_path, 0) == n
    assert _write_presses(Log({"tip": None}, [touch]), tmp_path, 0) == 0


def test_the_worst_presses_are_named_first() -> None:
    facts = [{"told": f"press {i}", "x_m": 0.001 * i, "y_m": 0.0, "grams": 100.0} for i in range(5)]
    wrench = np.zeros((5, 6))
    wrench[:, 2] = -1.0
    log: Any = SimpleNamespace(touch=np.arange(5), wrench=wrench, touch_facts=facts, n_touches=5)
    said = wrench.copy()
    said[[1, 3, 4], 2] += [0.1, -0.3, 0.2]
    now: Any = SimpleNamespace(wrench=said)
    worst = _worst(log, now)
    assert [row["told"] for row in worst] == ["press 3", "press 4", "press 1"]
    assert worst[0] == {"told": "press 3", "x_m": 0.003, "y_m": 0.0, "grams": 100.0, "error_n": pytest.approx(0.3)}
    log.touch_facts = [{"told": "by a scale on a port", "kind": "hand", **press._asdict()}
                       for press in (_by_force(ScalePress(0.001 * i, 0.0, 70.3)) for i in range(5))]  # fmt: skip
    assert [(row["x_m"], row["grams"]) for row in _worst(log, now)] == [(0.003, 70.3), (0.004, 70.3), (0.001, 70.3)]
    log.touch_facts = [{"told": "by a stage"}] * 5
    assert _worst(log, now) == []
    log.touch_facts = facts[:4]  # nobody knows which one is missing
    assert _worst(log, now) == []


def test_a_report_sees_a_log_in_its_pictures_as_the_fit_of_its_colours_did(tmp_path: Path) -> None:
    fitted, other = tmp_path / "fitted.h5", tmp_path / "other.h5"
    fitted.write_bytes(b"1")
    other.write_bytes(b"2")

    def file(said: dict[str, Any]) -> container.CalibrationFile:
        metadata = {**container.base_metadata(find_board("gelslim")), "residuals": json.dumps(said)}
        return container.pack({}, metadata)

    logs = {"fitted.h5": file_sha256(fitted)}
    assert _saw_pictures(file({"from_pictures": True, "logs": logs}), [fitted])
    assert not _saw_pictures(file({"from_pictures": True, "logs": logs}), [fitted, other])
    assert not _saw_pictures(file({"from_pictures": False, "logs": logs}), [fitted])
    assert not _saw_pictures(file({"from_pictures": True, "logs": [1]}), [fitted])
    assert not _saw_pictures(file({}), [fitted])
