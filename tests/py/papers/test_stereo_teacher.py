"""How the experiment judges a learned network: a made-up network whose errors are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from papers.stereo_fingertip import teacher as stereo_teacher

from ruffini.boards import find_board
from ruffini.train.stereo_predict import Told

OFF = np.array([0.01, 0.02, 0.3, 0.4, 0.5, 0.6])  # N, mm, mm, mm, degrees, degrees


@dataclass
class Run:
    """Its pictures hold their own number."""

    set_name: str
    first: int

    def picture(self, frame: int) -> np.ndarray:
        return np.array([self.first + frame])


class Network:
    """Off by OFF, to either side by turns; every fourth frame is not as it was taught."""

    metadata = {"ruffini.plan": "eighth", "ruffini.mode": "1"}  # noqa: RUF012

    def __init__(self, truth: np.ndarray) -> None:
        self._truth = truth

    def __call__(self, picture: np.ndarray) -> Told:
        i = int(picture[0])
        wire = (self._truth[i, :6] + (1 if i % 2 else -1) * OFF) / stereo_teacher.UNITS
        return Told(wire, i % 4 != 0)


def truths(n: int) -> np.ndarray:
    """Forces from 0 to 1.2 N; the first frame touches nothing."""
    rows = np.column_stack([np.linspace(0, 1.2, n), *6 * [np.linspace(-1, 1, n)]])
    rows[0] = np.nan
    return rows


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> dict:
    sets = ("any", "test_force", "test_x", "test_y", "test_angle")
    truth = np.concatenate([truths(13) for _ in sets])
    monkeypatch.setattr(stereo_teacher, "StereoNetwork", lambda path, board: Network(truth))
    runs = [(Run(name, 13 * i), truths(13)) for i, name in enumerate(sets)]
    return stereo_teacher.judge(find_board("stereo-fingertip"), "any.onnx", runs, 0.05, 1.05)


def test_errors_are_means_over_frames_of_the_papers_forces(judged: dict) -> None:
    one = judged["sets"]["any"]
    assert one["n_frames"] == 10  # 0.1 to 1.0 N
    assert [one[name] for name in stereo_teacher.NAMES] == pytest.approx(OFF)
    assert judged["valid_percent"] == pytest.approx(100 * (1 - 12 / 50))
    tests = judged["paper_tests"]
    assert [tests[k] for k in ("force_n", "z_mm", "x_mm", "y_mm", "angle_deg")] == pytest.approx(OFF[:5])
    assert tests["full_scale_percent"] == pytest.approx(100 * 0.01 / 1.0)


def test_the_text_says_which_network_and_its_time(judged: dict) -> None:
    said = "\n".join(stereo_teacher.text(judged))
    for part in (
        "eighth, mode 1",
        "ms a frame",
        "76 % as it was taught",
        "test_x",
        "0.300",
        "full_scale_percent 1.000",
    ):
        assert part in said, part
