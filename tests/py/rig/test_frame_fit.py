"""Where the reference stands is found from the log, with an uncertainty that holds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ruffini.errors import InputError
from ruffini.rig.frame_fit import fit_frame

SIGMA = np.array([0.02, 0.02, 0.02, 2e-4, 2e-4, 2e-4])
ARM = np.array([0.004, -0.002, 0.03])
HANGING = np.array([0.1, -0.2, -1.5, 0.01, 0.02, 0.0])


def log(seed: int, turn_deg, *, n: int = 30, has_shear: bool = True, reach_m: float = 0.006):
    """Touches seen by a reference that stands askew, on an arm, with something hanging on it."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_euler("xyz", turn_deg, degrees=True)
    place = np.column_stack([rng.uniform(-reach_m, reach_m, (n, 2)), rng.uniform(-1e-3, 0, n)])
    force = np.column_stack([has_shear * rng.uniform(-0.6, 0.6, (n, 2)), rng.uniform(-3, -1, n)])
    f = rotation.apply(force)
    t = np.cross(rotation.apply(place) + ARM, f)
    reading = np.hstack([f, t]) + HANGING + 0.2 * SIGMA * rng.normal(size=(n, 6))
    rest = HANGING + 0.2 * SIGMA * rng.normal(size=(50, 6))
    seen = force * [0.8, 0.8, 1.2] + 0.02 * rng.normal(size=(n, 3))  # a sensor whose gains are not right yet
    moment = np.cross(place, force)
    return rest, reading, place, seen, rotation.as_matrix(), np.hstack([force, moment])


@pytest.mark.parametrize("turn_deg", [(0, 0, 0), (2, -3, 10), (0, 0, 90), (180, 0, 30)])
def test_turn_arm_and_hanging_weight(turn_deg):
    rest, reading, place, seen, rotation, truth = log(1, turn_deg)
    fit = fit_frame(rest, reading, place, seen, SIGMA)
    between = Rotation.from_matrix(fit.rotation @ rotation.T).magnitude()
    assert np.rad2deg(between) < 1.0
    assert fit.arm_m == pytest.approx(ARM, abs=5e-4)
    assert fit.hanging == pytest.approx(HANGING, abs=0.01)
    assert fit.to_pad(reading)[:, :3] == pytest.approx(truth[:, :3], abs=0.06)
    assert fit.to_pad(reading)[:, 3:] == pytest.approx(truth[:, 3:], abs=1.5e-3)


def test_stated_uncertainty_holds():
    pulls = []
    for seed in range(20):
        rest, reading, place, seen, *_ = log(seed, (1, 2, 5))
        fit = fit_frame(rest, reading, place, seen, SIGMA)
        pulls.append((fit.arm_m - ARM) / fit.arm_sigma_m)
    assert np.sqrt((np.array(pulls) ** 2).mean()) < 1.5


@pytest.mark.parametrize("about", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_uncertainty_is_that_of_a_small_turn_however_far_off_the_fit_began(about, monkeypatch: pytest.MonkeyPatch):
    rest, reading, place, seen, *_ = log(1, (1, 2, 5))
    near = fit_frame(rest, reading, place, seen, SIGMA)
    far = [Rotation.from_rotvec(3.0 * np.array(about)) * Rotation.from_matrix(near.rotation)]
    monkeypatch.setattr("ruffini.rig.frame_fit._starts", lambda *_: far)
    fit = fit_frame(rest, reading, place, seen, SIGMA)
    assert fit.rotation == pytest.approx(near.rotation, abs=1e-4)
    assert fit.turn_sigma_rad == pytest.approx(near.turn_sigma_rad, rel=1e-2)


def test_touches_that_leave_it_open_are_refused():
    rest, reading, place, seen, *_ = log(1, (0, 0, 5), has_shear=False)
    seen[:, :2] = 0
    with pytest.raises(InputError, match="add touches with shear"):
        fit_frame(rest, reading, place, seen, SIGMA)
    rest, reading, place, seen, *_ = log(1, (0, 0, 5))
    with pytest.raises(InputError, match="4 touches and 50"):
        fit_frame(rest, reading[:4], place[:4], seen[:4], SIGMA)
    reading[:, 0] = np.nan
    with pytest.raises(InputError, match="no fx"):
        fit_frame(rest, reading, place, seen, SIGMA)
