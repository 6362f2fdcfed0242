"""Ways of one indenter: where they go, that the pad plays them, and what is refused."""

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.sim.scenario import scenario_of
from ruffini.sim.story import play
from ruffini.sim.trajectories import TRAJECTORIES, TouchSettings, told

MM = 1e-3


def rows(name, seed=1, **keys):
    step = told(name, TouchSettings(**keys), 2, np.random.default_rng(seed))[1]
    return np.array([pose.row() for pose in step.poses])


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_ways_start_gently_and_go_to_their_depth(name):
    way = rows(name, frames=20, depth_um=1000)
    deepest = 4 * MM if name == "limit" else 1 * MM
    assert way[:, 2].max() == pytest.approx(deepest, rel=0.3 if name == "walk" else 1e-9)
    assert way[0, 2] <= deepest / 20 + 1e-12
    assert (way[:, 2] >= 0).all()
    if name != "walk":
        assert way[-1, 2] == 0


def test_ways_do_what_they_are_called():
    assert np.ptp(rows("shear"), axis=0)[:2] == pytest.approx([0.64 * MM, 0.64 * MM])
    assert np.ptp(rows("twist")[:, 3]) == pytest.approx(0.3)
    ball = rows("roll", radius_um=2000)
    np.testing.assert_allclose(ball[:, 0], 2 * MM * ball[:, 5])  # no slip at the tip
    assert np.ptp(rows("roll", indenter="flat")[:, 5]) == pytest.approx(0.24)
    assert (np.diff(rows("cycles")[:, 2]) < 0).sum() == 5 * 12
    assert (rows("walk", seed=1) != rows("walk", seed=2)).any()
    np.testing.assert_array_equal(rows("walk"), rows("walk"))


@pytest.mark.parametrize(("name", "indenter"), [("roll", "flat"), ("walk", "cylinder"), ("twist", "triangle")])
def test_the_pad_plays_them(coarse_unit, name, indenter):
    scenario = scenario_of({"program": name, "touch": {"indenter": indenter, "frames": 2, "depth_um": 500}}, "test")
    loads, states = [], set()
    for moment in play(coarse_unit, scenario.story(coarse_unit.board)):
        loads.append(-moment.wrench()[2])
        states |= set(np.unique(moment.nodal_state()).tolist())
        np.testing.assert_allclose(moment.nodal_force().sum((0, 1)), moment.wrench()[:3], atol=1e-12)
    assert max(loads) > 0.3
    assert loads[0] == loads[-1] == 0
    assert states == {0, 1, 2}


def test_bad_touches_are_refused(coarse_unit):
    with pytest.raises(InputError, match="is none"):
        scenario_of({"program": "demo", "touch": {}}, "test")
    with pytest.raises(InputError, match="choose one of"):
        scenario_of({"program": "press", "touch": {"indenter": "banana"}}, "test").story(coarse_unit.board)
    with pytest.raises(InputError, match="shore_a"):
        scenario_of({"program": "press", "touch": {"shore_a": 100}}, "test")
