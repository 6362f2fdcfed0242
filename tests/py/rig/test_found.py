"""What a whole log tells: clocks and the place of the reference, from touches made up here with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ruffini.errors import InputError
from ruffini.rig.found import estimate, on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, LogWriter, TouchRecord, read_log

SIGMA = [0.005] * 3 + [5e-5] * 3
TURN = Rotation.from_euler("xyz", [2, -3, 12], degrees=True)
ARM = np.array([0.003, -0.001, 0.025])
OFFSET_S, DRIFT = 4321.0173, 200e-6  # the host's clock against the sensor's
N = 14


def touches(seed: int = 1, *, is_blind: bool = False) -> list[TouchRecord]:
    """Presses with shear, seen by a sensor whose gains are a fifth off and by a reference that stands askew."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(N):
        place = np.array([*rng.uniform(-5e-3, 5e-3, 2), -4e-4])
        peak = np.array([*rng.uniform(-0.5, 0.5, 2), -rng.uniform(0.8, 2.0)])
        true_s = 3.0 * i + np.arange(0.3, 2.9, 0.01)  # sensor time
        ramp = np.clip(np.minimum(true_s - 3.0 * i - 0.8, 3.0 * i + 2.2 - true_s) / 0.3, 0, 1)
        force = ramp[:, None] * peak
        host_s = true_s + OFFSET_S + DRIFT * (true_s - 21)
        torque = np.cross(TURN.apply(place) + ARM, TURN.apply(force))
        wrench = np.hstack([TURN.apply(force), torque]) + 0.2 * np.array(SIGMA) * rng.normal(size=(len(true_s), 6))
        seen = np.hstack([force * [0.8, 0.8, 1.2], np.cross(place, force)]) + 0.005 * rng.normal(size=(len(true_s), 6))
        facts = {"held_host_s": host_s[90], "lifted_host_s": host_s[150], "session": "a", "peak": peak.tolist()}
        arrays = {
            "stream_s": true_s[::2], "stream_host_s": host_s[::2] + 0.030 + rng.uniform(0, 0.01, len(true_s[::2])),
            "stream_frame": np.arange(len(true_s[::2])), "stream_flags": np.zeros(len(true_s[::2]), int),
            "stream_wrench": (np.nan if is_blind else 1) * seen[::2],
            "stream_validity": np.ones((len(true_s[::2]), 6), int),
            "reference_s": host_s, "reference_wrench": wrench, "stage_s": host_s[90:91], "stage_place": place[None],
        }  # fmt: skip
        out.append(TouchRecord(facts, arrays))
    return out


def test_clock_and_place_of_the_reference_are_found_and_used():
    log = Log({}, touches(), estimate(touches(), {"sigma": SIGMA}))
    (clock,) = log.found["clocks"]
    touch = log.touches[3]
    true_host_s = touch.arrays["reference_s"][::2]
    assert abs(on_reference_clock(log, touch) - true_host_s).max() < 2e-3
    assert clock["drift"] == pytest.approx(DRIFT, abs=50e-6)
    frame = log.found["frame"]
    off = Rotation.from_matrix(np.array(frame["rotation"])) * TURN.inv()
    assert np.rad2deg(off.magnitude()) < 1.0
    assert frame["arm_m"] == pytest.approx(ARM, abs=5e-4)
    straight = reference_in_pad(log, touch)
    place, force = touch.arrays["stage_place"][-1], straight[90, :3]
    assert force == pytest.approx(touch.facts["peak"], abs=0.05)
    assert straight[90, 3:] == pytest.approx(np.cross(place, force), abs=5e-4)


def test_a_stream_without_force_says_why_not_and_changes_nothing():
    blind = touches(is_blind=True)
    log = Log({}, blind, estimate(blind, {"sigma": SIGMA}))
    assert "measures neither forces nor markers" in log.found["clocks"][0]["why_not"]
    assert "direction is not known" in log.found["frame"]["why_not"]
    assert reference_in_pad(log, blind[0]) is blind[0].arrays["reference_wrench"]
    assert on_reference_clock(log, blind[0]) is blind[0].arrays["stream_host_s"]


def test_markers_tell_the_clock_where_no_force_is_measured():
    blind = touches(is_blind=True)
    for touch, sees in zip(blind, touches(), strict=True):
        touch.arrays["stream_activity"] = 3.0 * np.linalg.norm(sees.arrays["stream_wrench"][:, :3], axis=1)
    log = Log({}, blind, estimate(blind, {"sigma": SIGMA}))
    true_host_s = blind[3].arrays["reference_s"][::2]
    assert abs(on_reference_clock(log, blind[3]) - true_host_s).max() < 4e-3


def test_signals_whose_gains_change_from_touch_to_touch_tell_the_clock():
    """Ways in which markers move, with a gain of its own in each touch, and behind the load as rubber is."""
    blind, rng = touches(is_blind=True), np.random.default_rng(8)
    for touch, sees in zip(blind, touches(), strict=True):
        force = sees.arrays["stream_wrench"][:, :3]
        slow = np.zeros_like(force)
        for k in range(1, len(force)):  # a third of it creeps, 0.3 s long, at 50 Hz
            slow[k] = slow[k - 1] + (1 - np.exp(-0.02 / 0.3)) * ((force[k] + force[k - 1]) / 2 - slow[k - 1])
        moved = (force + 0.3 * slow) @ rng.uniform(-1, 1, (3, 3))
        touch.arrays["stream_motion"] = moved
        touch.arrays["stream_activity"] = np.linalg.norm(moved, axis=1)
    log = Log({}, blind, estimate(blind, {"sigma": SIGMA}))
    true_host_s = blind[3].arrays["reference_s"][::2]
    assert abs(on_reference_clock(log, blind[3]) - true_host_s).max() < 2e-3
    assert log.found["clocks"][0]["sigma_s"] < 2e-3
    for touch in blind:
        touch.arrays["stream_motion"] = rng.normal(size=touch.arrays["stream_motion"].shape)
        touch.arrays["stream_activity"] = rng.uniform(size=len(touch.arrays["stream_activity"]))
    assert "does not show what the stream shows" in estimate(blind, {"sigma": SIGMA})["clocks"][0]["why_not"]


def test_no_stage_no_frame():
    by_hand = touches()
    for touch in by_hand:
        touch.arrays.update(stage_s=np.zeros(0), stage_place=np.zeros((0, 3)))
    assert "no stage pressed" in estimate(by_hand, {"sigma": SIGMA})["frame"]["why_not"]


def test_found_and_optional_arrays_are_kept(tmp_path):
    path, (touch, *_) = tmp_path / "log.h5", touches()
    extra = {
        "rest_field_s": np.zeros(2), "rest_field_displacement": np.zeros((2, 3, 4, 3), np.float32),
        "marker_s": np.arange(3.0), "marker_displacement": np.ones((3, 5, 2)), "marker_place": np.zeros((5, 2)),
        "image_s": np.zeros(1), "image": np.full((1, 6, 8, 3), 7, np.uint8),
    }  # fmt: skip
    writer = LogWriter(path, {"marker_unit": "m"})
    writer.write(0, TouchRecord(touch.facts, {**touch.arrays, **extra}))
    writer.side_file("note.txt").write_text("x")
    writer.finish({"clocks": []})
    log = read_log(path)
    assert log.found == {"clocks": []}
    assert (log.touches[0].arrays["image"] == 7).all()
    assert log.touches[0].arrays["marker_displacement"].shape == (3, 5, 2)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"field_s": np.zeros(1)}, "field_s and field_displacement belong together"),
        ({"image_s": np.zeros(2), "image": np.zeros((1, 4, 4, 3))}, "image is"),
        ({"marker_s": np.zeros(1), "marker_displacement": np.zeros((1, 4))}, "marker_displacement is"),
        ({"marker_place": np.zeros((3, 2))}, "marker_place is"),
        ({"stream_activity": np.zeros(3)}, "stream_activity is"),
        ({"stream_motion": np.zeros((3, 2))}, "stream_motion is"),
    ],
)
def test_optional_arrays_that_are_wrong(tmp_path, wrong, sentence):
    writer, (touch, *_) = LogWriter(tmp_path / "log.h5", {}), touches()
    writer.write(0, TouchRecord(touch.facts, {**touch.arrays, **wrong}))
    writer.finish()
    with pytest.raises(InputError, match=sentence):
        read_log(tmp_path / "log.h5")
