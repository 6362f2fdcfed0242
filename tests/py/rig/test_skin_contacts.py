"""A skin measures what is out of it, contact by contact: from the message into the log, its clock and its checks."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ruffini.calibrate.container import CalibrationFile
from ruffini.device import Contacts
from ruffini.errors import InputError
from ruffini.rig.check import allowed_n, check_weight
from ruffini.rig.found import estimate, on_reference_clock
from ruffini.rig.log_file import Log, TouchRecord, read_log, write_log
from ruffini.rig.reference import Reading, pressing
from ruffini.rig.stage import Place
from ruffini.rig.stream_watch import ContactSample, StreamSample, Window, _contacts
from ruffini.rig.touch import faults_of, record_of
from ruffini.wire import Schema

CLOCK_S, PEAK_S, OFF_M, GAIN = 700.0, 0.6, np.array([0.002, -0.001]), 0.8
REFERENCE = {"sigma": [0, 0, 0.005, 0, 0, 0]}
ONLY_Z = (0, 0, 1, 0, 0, 0)


def touch(number: int, *, is_seen: bool = True) -> TouchRecord:
    """A press of 1 to 3 N for a second; a second, fainter contact elsewhere, as a skin may show."""
    rng = np.random.default_rng(number)
    place, peak_n = rng.uniform(-0.03, 0.03, 2), rng.uniform(1, 3)
    true_s = 4.0 * number + np.arange(0, 3, 1 / 30)
    load_n = peak_n * np.clip(np.minimum(true_s - true_s[0] - 0.5, true_s[0] + 2.3 - true_s) / PEAK_S, 0, 1)
    said_n = GAIN * load_n * is_seen
    frames = [StreamSample(t + CLOCK_S + 0.02, t, i, 0, np.array([np.nan, np.nan, -1.05 * f, *[np.nan] * 3]), ONLY_Z)
              for i, (t, f) in enumerate(zip(true_s, said_n, strict=True))]  # fmt: skip
    contacts = [ContactSample(t, n, place + off, -f, np.array([0.1, np.nan]))
                for t, load in zip(true_s, said_n, strict=True) if load > 0
                for n, off, f in ((7, np.array([0.02, 0.02]), 0.05 * load), (3, OFF_M, load))]  # fmt: skip
    readings = [Reading(t + CLOCK_S, pressing(-f)) for t, f in zip(true_s, load_n, strict=True)]
    held = true_s[0] + 0.5 + PEAK_S + CLOCK_S
    facts = {"touched_host_s": held - PEAK_S, "held_host_s": held, "lifted_host_s": held + 0.6, "session": "a"}
    return record_of(Window(frames, [], [], [], contacts, []), readings, [(held, Place(*place, -1e-3))], facts)


def test_contacts_of_the_wire_are_in_si_units_and_what_is_not_said_is_not_zero():
    first = {"id": 4, "center_x_um": 1500, "center_y_um": -250, "force_z_un": -2_500_000, "validity": 1,
             "force_validity": [0, 0, 1],
             "skin": {"place_um": [0] * 3, "normal_force_un": [0] * 3, "force_sigma_un": 90_000,
                      "center_sigma_um": 1200}}  # fmt: skip
    blind = {"id": 5, "center_x_um": 10, "force_validity": [0, 0, 0], "validity": 1}
    message = Schema.own().new("Contacts", stamp={"capture_us": 3_000_000}, contacts=[first, blind])
    one, other = _contacts(0.0, Contacts.from_message(message))
    assert (one.stream_s, one.number, one.force_n) == (3.0, 4, pytest.approx(-2.5))
    assert one.place == pytest.approx([1.5e-3, -0.25e-3])
    assert one.sigma == pytest.approx([0.09, 1.2e-3])
    assert np.isnan([other.force_n, *other.sigma]).all()


def test_contacts_are_kept_and_tell_clock_place_and_gain(tmp_path):
    touches = [touch(i) for i in range(10)]
    found = estimate(touches, REFERENCE)
    write_log(tmp_path / "log.h5", Log({}, touches, found))
    log = read_log(tmp_path / "log.h5")
    one = log.touches[2]
    assert abs(on_reference_clock(log, one) - one.arrays["reference_s"]).max() < 3e-3
    assert {"contact_number", "contact_sigma"} <= one.arrays.keys()
    told = log.found["contacts"]
    assert (told["touches"], told["unseen"]) == (10, 0)
    assert told["offset_m"] == pytest.approx(OFF_M, abs=1e-9)
    assert told["gain"] == pytest.approx(GAIN, abs=0.01)


def test_contacts_that_nobody_saw_are_counted():
    some = estimate([touch(0), touch(1, is_seen=False)], REFERENCE)["contacts"]
    assert (some["touches"], some["unseen"]) == (1, 1)
    by_hand = touch(0)
    by_hand.arrays.update(stage_s=np.zeros(0), stage_place=np.zeros((0, 3)))
    assert "no contact was seen while a stage" in estimate([by_hand], REFERENCE)["contacts"]["why_not"]
    assert "contacts" not in estimate([touch(0, is_seen=False)], REFERENCE)


def test_half_of_the_contacts_arrays_is_no_log(tmp_path):
    one = touch(0)
    del one.arrays["contact_force"]
    write_log(tmp_path / "log.h5", Log({}, [one]))
    with pytest.raises(InputError, match="lacks contact_force"):
        read_log(tmp_path / "log.h5")
    one = touch(0)
    one.arrays["contact_place"] = one.arrays["contact_place"][1:]
    write_log(tmp_path / "short.h5", Log({}, [one]))
    with pytest.raises(InputError, match="contact_place is"):
        read_log(tmp_path / "short.h5")


def test_a_skin_that_does_not_see_its_touch_spoils_it():
    good, blind = touch(0), touch(0, is_seen=False)
    assert faults_of(good.arrays, good.facts, {}) == []
    (fault,) = faults_of(blind.arrays, blind.facts, {})
    assert fault.startswith("the sensor saw 0.000 N of")


def test_a_weight_on_a_skin_is_checked_by_what_it_measures():
    frame = type("Frame", (), {"wrench": np.array([np.nan, np.nan, -0.97, *[np.nan] * 3])})
    stream = type("Stream", (), {"since": staticmethod(lambda _: type("W", (), {"frames": [frame] * 4}))})
    person = type("Person", (), {"confirm": staticmethod(lambda _: None)})
    bench = type("Bench", (), {"person": person, "weight": None, "stream": stream,
                               "hold": staticmethod(lambda begun: begun + 0.1)})()  # fmt: skip
    assert check_weight(bench, 100, None).ok


def test_what_a_skins_weight_may_be_off_is_what_its_presses_were_off():
    report = {"stages": {"skin": {"force_rms_percent": 4.0, "light_force_rms_n": 0.05}}}
    file = CalibrationFile({}, {"residuals": json.dumps(report)})
    assert allowed_n(file, 0.98) == pytest.approx(0.15)
    assert allowed_n(file, 5.0) == pytest.approx(0.6)
    kept = CalibrationFile({}, {"residuals": json.dumps({"stages": {"skin": {"state": "kept"}}})})
    assert allowed_n(kept, 1.0) == allowed_n(None, 1.0)
