"""How the benches of tray and skin judge: what is fitted, what is lost, what a loop and five trials give."""

from types import SimpleNamespace

import numpy as np
import pytest
from papers.eltac import bench as glowing_skin
from papers.ftouch import bench as spring_tray

RNG = np.random.default_rng(5)
K = RNG.normal(size=(6, 9))


class Loads:
    """A recording whose pictures are three targets as numbers; some of its frames show none."""

    def __init__(self, part, n, lost=(), scale=1.0, off=0.0):
        self.part, self.touched, self._lost = part, np.arange(2, n + 2), lost
        self._nine = np.vstack([np.zeros((2, 9)), scale * RNG.normal(size=(n, 9))])
        self.rig = {"force": self._nine @ K.T + off}

    def picture(self, frame):
        return SimpleNamespace(rows=self._nine[frame].reshape(3, 3), is_lost=frame in self._lost)


@pytest.fixture(autouse=True)
def numbers_for_pictures(monkeypatch):
    def targets(picture):
        if picture.is_lost:
            raise ValueError("4 dark blobs instead of three targets")
        return picture.rows

    monkeypatch.setattr(spring_tray, "targets", targets)


def test_k_of_the_papers_loads_is_judged_on_them_and_k_of_the_whole_range_on_the_gel():
    runs = [Loads("fit", 60), Loads("show", 60), Loads("judge", 40, lost=(5, 6, 7, 8), off=0.1)]
    figures = spring_tray.judge(None, runs)
    assert figures["connector, Fx"] == pytest.approx(0, abs=1e-9)
    assert figures["connector, R2 of Tz"] == pytest.approx(1)
    assert figures["gel, Fz"] == pytest.approx(0.1)
    assert figures["gel, Ty"] == pytest.approx(100)  # N mm
    assert figures["gel, frames without three targets"] == pytest.approx(10)


def test_without_gel_nothing_is_said_of_it():
    assert not any(name.startswith("gel") for name in spring_tray.judge(None, [Loads("fit", 30)]))


def test_a_loop_loses_the_area_between_its_ways():
    angle = np.zeros(1)
    depth = np.concatenate([np.linspace(0.1, 1, 10), np.linspace(0.9, 0, 10)])
    force = np.concatenate([depth[:10], 0.5 * depth[10:]])
    pose = np.column_stack([np.zeros(20), np.zeros(20), depth])
    loop = SimpleNamespace(
        truth={"pose": pose}, rig={"force": np.column_stack([-force, 0 * force])}, touched=np.arange(20), angle=angle
    )
    # Up: a triangle of 1/2. Down: half the force but for the step at the turn, 1/2 (1 + 0.45) 0.1 and the rest.
    back = 0.05 * 1.45 + 0.5 * 0.5 * 0.9**2
    assert glowing_skin._loss(loop) == pytest.approx(100 * (1 - back / 0.5))


def test_brightness_at_a_force_is_of_the_way_in():
    pairs = np.array([[10.0, 1.0], [20.0, 3.0], [30.0, 7.0], [29.0, 6.0]])
    assert glowing_skin._brightness_at(pairs, 5.0) == pytest.approx(25.0)
