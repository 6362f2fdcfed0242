"""Messages to frames: whole as soon as all that is due has come, and nothing invalid that looks like a number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ruffini.api import SensorFrame
from ruffini.api.frame import Assembler
from ruffini.device.line_gap import LineGap
from ruffini.device.results import KNOWN_FLAGS
from ruffini.wire import Frame, Schema

SCHEMA = Schema.own()
WRENCH = {"force_x_un": 1_000_000, "force_z_un": -2_000_000, "torque_x_un_um": 5_000_000_000}


class Line:
    """Feeds an assembler; `put` says which frames came out."""

    def __init__(self, **every: int) -> None:
        self.assembler = Assembler(SCHEMA, "0001", every)
        self.out: list[SensorFrame] = []

    def put(self, name: str, number: int, sensor: int = 0, flags: int = 0, **fields: Any) -> list[int]:
        stamp = {"capture_us": 1000 * number, "frame": number, "flags": flags}
        message = SCHEMA.new(name.title(), stamp=stamp, **fields)
        packet = Frame(SCHEMA.type_numbers[name], sensor, 0, 2, b"", 7 + number, 3)
        made = list(self.assembler.put(packet, message))
        self.out += made
        return [frame.number for frame in made]


def settled(**every: int) -> Line:
    """After three frames of WRENCH and FIELD."""
    line = Line(**every)
    for number in (0, 1, 2):
        assert line.put("WRENCH", number) == []
        assert line.put("FIELD", number) == []
    assert line.put("WRENCH", 3) == [0, 1, 2], "three frames seen to their end: it is known what comes"
    assert line.put("FIELD", 3) == [3]
    return line


def test_a_frame_comes_out_with_its_last_message() -> None:
    line = settled()
    assert line.put("FIELD", 4) == []
    assert line.put("WRENCH", 4) == [4]
    assert all(set(frame.messages) == {"WRENCH", "FIELD"} for frame in line.out)
    assert line.assembler.n_late == 0


def test_a_message_that_was_lost_holds_a_frame_until_the_next() -> None:
    line = settled()
    assert line.put("WRENCH", 4) == []
    assert line.put("WRENCH", 6) == [4]
    assert line.out[-1].field is None
    assert not line.out[-1].is_whole
    assert line.put("FIELD", 6) == [6]
    assert line.out[-1].is_whole


def test_the_first_frame_is_not_taken_for_whole_before_it_is_known_what_comes() -> None:
    line = Line()
    line.put("FIELD", 1)  # subscribed in the middle of a frame
    for number in (2, 3, 4, 5):
        line.put("WRENCH", number)
        line.put("FIELD", number)
    assert [(f.number, f.is_whole) for f in line.out] == [(1, False), (2, True), (3, True), (4, True), (5, True)]


def test_in_a_recording_a_message_is_due_as_often_as_it_came() -> None:
    assembler, out = Assembler(SCHEMA, "0001", None), []
    line = Line()
    line.assembler = assembler
    for number in range(20):
        line.put("WRENCH", number)
        if number != 7:
            line.put("FIELD", number)
        if number % 5 == 0 and number != 10:
            line.put("IMAGE", number)
    out = line.out + list(assembler.flush())
    assert [f.number for f in out] == list(range(20))
    assert [f.number for f in out if not f.is_whole] == [7, 10], "what follows a loss lacks nothing"


def test_what_comes_behind_its_frame_is_counted_and_waited_for_from_then_on() -> None:
    line = settled()
    for number in (4, 5):
        line.put("WRENCH", number)
        assert line.put("FIELD", number) == [number]
        assert line.put("CONTACTS", number) == []
    assert line.assembler.n_late == 2
    line.put("WRENCH", 6)
    assert line.put("FIELD", 6) == []
    assert line.put("CONTACTS", 6) == [6]


def test_a_frame_is_late_once_however_many_of_its_messages_are() -> None:
    line = settled()
    line.put("WRENCH", 4)
    assert line.put("FIELD", 4) == [4]
    for name in ("CONTACTS", "DEPTH", "DEPTH"):
        assert line.put(name, 4) == []
    assert line.assembler.n_late == 1
    line.put("WRENCH", 6)
    for name in ("MARKERS", "MARKERS"):
        assert line.put(name, 5) == []
    assert line.assembler.n_late == 2, "another frame"
    line.put("CONTACTS", 4)
    assert line.assembler.n_late == 2, "the first again"


def test_an_image_of_every_third_frame_delays_no_other() -> None:
    line = Line(IMAGE=3)
    for number in range(1, 13):
        line.put("WRENCH", number)
        line.put("FIELD", number)
        if number % 3 == 0:
            line.put("IMAGE", number)
    assert [f.number for f in line.out] == list(range(1, 13))
    assert [f.number for f in line.out if f.image is not None] == [3, 6, 9, 12]


def test_a_frame_that_the_camera_missed_costs_one_frame_at_most() -> None:
    """The device counts the frames that it has processed: its pictures come one number later from then on."""
    line = Line(IMAGE=4)
    for number in [n for n in range(40) if n != 18]:
        line.put("WRENCH", number)
        if (number - (number > 18)) % 4 == 0:
            line.put("IMAGE", number)
    seen = line.out + list(line.assembler.flush())
    assert [f.number for f in seen if f.image is not None] == [0, 4, 8, 12, 16, 21, 25, 29, 33, 37]
    assert [f.number for f in seen if not f.is_whole] == [20]


def test_two_sensors_on_one_line_do_not_mix() -> None:
    line = Line()
    for number in range(1, 6):
        for sensor in (0, 1):
            line.put("WRENCH", number, sensor)
            line.put("FIELD", number + 100 * sensor, sensor)
    assert {f.number for f in line.out if f.sensor == 0} == {1, 2, 3, 4, 5}


def test_a_sensor_that_counts_anew_is_followed() -> None:
    line = settled()
    for number in (5000, 5001):
        line.put("WRENCH", number)
        line.put("FIELD", number)
    line.assembler.note_gap(LineGap(0.5, None))
    for number in range(4):
        line.put("WRENCH", number)
        line.put("FIELD", number)
    assert [f.number for f in line.out[-6:]] == [5000, 5001, 0, 1, 2, 3]
    assert [f.gap for f in line.out[-4:]] == [LineGap(0.5, None), None, None, None]
    assert all(set(f.messages) == {"WRENCH", "FIELD"} for f in line.out)


def test_a_repeated_result_is_a_frame_of_its_own_without_a_number() -> None:
    line = settled()
    line.put("WRENCH", 4, validity=[1] * 6, **WRENCH)
    assert line.put("WRENCH", 4, sensor=255, flags=256, validity=[3] * 6) == [4, 4], "behind the one that it repeats"
    first, stale = line.out[-2:]
    assert not first.is_stale
    assert not first.is_whole
    assert stale.is_stale
    assert not stale.is_valid
    assert stale.wrench is not None
    assert np.isnan(stale.wrench.force).all()
    assert line.put("WRENCH", 4, sensor=255, flags=256, validity=[3] * 6) == [4]
    assert line.put("WRENCH", 5) == []
    assert line.put("FIELD", 5) == [5], "and then frames come again"


def test_a_learned_result_is_of_its_own_frame() -> None:
    line = settled()
    line.put("LEARNED", 2, validity=1, quantities=[{"name": "force_un", "value": 5}])
    line.put("WRENCH", 4)
    line.put("FIELD", 4)
    assert line.out[-2].learned is None
    assert line.out[-1].learned is not None
    assert (line.out[-1].number, line.out[-1].learned.frame) == (4, 2)


def test_the_last_frame_of_a_recording_is_not_lost() -> None:
    line = Line()
    line.put("WRENCH", 1)
    assert [f.number for f in line.assembler.flush()] == [1]


@pytest.mark.parametrize(
    ("validity", "flags", "is_number"),
    [(1, 0, True), (0, 0, False), (2, 4, False), (3, 8, False), (7, 0, False), (1, 512, True), (1, 1 << 30, False)],
    ids=["valid", "not measured", "uncalibrated", "invalid", "unknown validity", "known flag", "unknown flag"],
)
def test_only_valid_numbers_are_numbers(validity: int, flags: int, is_number: bool) -> None:
    line = Line()
    dense = {"n_x": 1, "n_y": 1, "n_components": 3, "data": b"\x02\x3f" + bytes(7)}
    line.put("WRENCH", 1, flags=flags, validity=[validity] * 6, **WRENCH)
    line.put("FIELD", 1, flags=flags, force_lsb_un=10, force=dense, validity=[validity] * 3)
    line.put("DEPTH", 1, flags=flags, depth_lsb_nm=10, depth={**dense, "n_components": 1}, validity=validity)
    contact: dict[str, Any] = {"force_z_un": -5, "validity": validity}
    line.put("CONTACTS", 1, flags=flags,
             contacts=[contact, {**contact, "force_validity": [0, 0, 1]}])  # fmt: skip
    (frame,) = line.assembler.flush()
    assert frame.wrench is not None
    assert frame.field is not None
    assert frame.depth is not None
    assert frame.contacts is not None
    plain, own = frame.contacts.contacts
    for values in (frame.wrench.force, frame.wrench.torque, frame.field.force, frame.depth.depth, plain.force):
        assert np.isfinite(values).all() == np.isfinite(values).any() == is_number
    assert np.isfinite(own.force).tolist() == [False, False, flags != 1 << 30]
    if is_number:
        np.testing.assert_allclose(frame.wrench.force, [1, 0, -2])
        np.testing.assert_allclose(frame.wrench.torque, [5e-3, 0, 0])
        np.testing.assert_allclose(frame.field.force, [[[-2e-5] * 3]])
    np.testing.assert_allclose(frame.field.raw_force, [[[-2e-5] * 3]])  # what was sent is still there


def test_known_flags_are_those_of_the_schema() -> None:
    assert SCHEMA.enum_names("FlagBit", ~KNOWN_FLAGS & 0xFFFFFFFF) == []
    assert len(SCHEMA.enum_names("FlagBit", KNOWN_FLAGS)) == KNOWN_FLAGS.bit_count()


def test_pixels_are_a_view() -> None:
    line = Line()
    line.put("IMAGE", 1, width_px=2, height_px=1, data=bytes(range(6)))
    (frame,) = line.assembler.flush()
    assert frame.image is not None
    assert not frame.image.pixels.flags.owndata
    assert frame.image.pixels.tolist() == [[[0, 1, 2], [3, 4, 5]]]
