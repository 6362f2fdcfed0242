"""A touch on a gel without markers: which features of its picture are kept, and the press that they show."""

from __future__ import annotations

import numpy as np

from ruffini.rig.log_file import ACTIVITY, MOTION
from ruffini.rig.program import ScalePress
from ruffini.rig.reference import Reading
from ruffini.rig.session import sent_image_bytes
from ruffini.rig.stream_watch import FeatureSample, ImageSample, StreamSample, Window
from ruffini.rig.touch import record_of

TOUCHED_S, HELD_S, LIFTED_S, END_S, PERIOD_S = 2.0, 3.0, 5.0, 6.0, 0.02
NOTHING = np.full(6, np.nan)


def window(pressed: np.ndarray) -> Window:
    time_s = np.arange(len(pressed)) * PERIOD_S
    frames = [StreamSample(10 + t, t, i, 0, NOTHING, (0,) * 6) for i, t in enumerate(time_s)]
    features = [FeatureSample(t, np.array([0, 65536 * p, -65536 * p], np.int32))
                for t, p in zip(time_s, pressed, strict=True)]  # fmt: skip
    return Window(frames, [], [], [], [], features)


def test_what_is_kept_is_mostly_of_the_press_and_shows_its_course() -> None:
    time_s = np.arange(0, END_S, PERIOD_S)
    pressed = np.interp(time_s, [TOUCHED_S, HELD_S, LIFTED_S, LIFTED_S + 0.1], [0, 0.3, 0.3, 0])
    facts = {"touched_host_s": 10 + TOUCHED_S, "held_host_s": 10 + HELD_S, "lifted_host_s": 10 + LIFTED_S}
    readings = [Reading(10 + t, NOTHING) for t in time_s]
    arrays = record_of(window(pressed), readings, [], facts).arrays
    kept_s, kept = arrays["feature_s"], arrays["feature"]
    assert kept.dtype == np.int32
    assert kept.shape == (50, 3)
    assert (kept_s < TOUCHED_S).sum() == 10
    assert ((kept_s > TOUCHED_S) & (kept_s < HELD_S)).sum() >= 8  # the forces on the way down
    assert np.abs(kept[:, 1] / 65536 - np.interp(kept_s, time_s, pressed)).max() < 1e-4
    np.testing.assert_allclose(arrays[ACTIVITY], 2 / 3 * pressed, atol=1e-4)
    assert np.abs(np.corrcoef(arrays[MOTION][:, 0], pressed)[0, 1]) > 0.999


def test_a_press_on_a_scale_that_fades_while_it_is_held_is_seen_without_markers() -> None:
    time_s = np.arange(0, END_S, PERIOD_S)
    press = ScalePress(0.0, 0.0, 100.0)
    facts = {"touched_host_s": 10 + TOUCHED_S, "held_host_s": 10 + HELD_S, "lifted_host_s": 10 + LIFTED_S}
    readings = [Reading(10 + t, NOTHING) for t in time_s]
    for fades, said in ((0.0, []), (0.1, ["the press changed by 39 % while it was held"])):
        pressed = np.interp(time_s, [TOUCHED_S, HELD_S, LIFTED_S, LIFTED_S + 0.1], [0, 0.3, 0.3 - fades, 0])
        assert press.faults(record_of(window(pressed), readings, [], facts)) == said


def test_pictures_of_the_way_down_are_kept_of_a_sensor_that_sends_nothing_else_of_it() -> None:
    time_s = np.arange(0, END_S, PERIOD_S)
    facts = {"touched_host_s": 10 + TOUCHED_S, "held_host_s": 10 + HELD_S, "lifted_host_s": 10 + LIFTED_S}
    readings = [Reading(10 + t, NOTHING) for t in time_s]
    images = [ImageSample(t, np.zeros((2, 2, 3), np.uint8), 2) for t in time_s]
    with_features = window(0 * time_s)._replace(images=images)
    for sent, n_of_way in ((with_features._replace(features=[]), 8), (with_features, 0)):
        kept_s = record_of(sent, readings, [], facts).arrays["image_s"]
        assert (kept_s <= TOUCHED_S).sum() == 1
        assert ((kept_s > TOUCHED_S) & (kept_s <= HELD_S)).sum() == n_of_way
        assert ((kept_s > HELD_S) & (kept_s < LIFTED_S)).sum() == 3
        assert (np.diff(kept_s) > 0).all()


def test_a_picture_that_is_too_large_for_a_message_is_sent_smaller() -> None:
    assert sent_image_bytes(640, 480) == 3 * 640 * 480
    assert sent_image_bytes(1280, 720) == 3 * 640 * 360
