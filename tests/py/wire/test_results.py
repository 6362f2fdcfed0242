"""Messages of the stream in SI units, and what an old device leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from golden import read_vectors
from google.protobuf import descriptor_pb2

from ruffini.device.results import Contacts, Field
from ruffini.wire import Decoder
from ruffini.wire.messages import Schema


def old_schema() -> Schema:
    """The schema of a device that knows nothing of slip."""
    files = descriptor_pb2.FileDescriptorSet.FromString(Schema.own().bytes)
    for message in files.file[0].message_type:
        kept = [f for f in message.field if "slip" not in f.name and f.number < 10]
        if message.name in ("Contact", "Field"):
            del message.field[:]
            message.field.extend(kept)
    return Schema(files.SerializeToString())


def golden_contacts() -> bytes:
    line = next(fields for fields in read_vectors("frames.txt") if "contact that begins to slip" in fields)
    encoded = max((bytes.fromhex(f) for f in line if set(f) <= set("0123456789abcdef ")), key=len)
    return next(iter(Decoder().feed(encoded))).payload


def test_a_contact_that_begins_to_slip() -> None:
    schema = Schema.own()
    (contact,) = Contacts.from_message(schema.decode(schema.type_numbers["CONTACTS"], golden_contacts())).contacts
    assert contact.slip_state == "incipient"
    assert contact.shear_ratio == pytest.approx(0.35)
    assert contact.friction == pytest.approx(0.5)
    assert contact.friction_sigma == pytest.approx(0.1)
    assert contact.slip_share == pytest.approx(0.62)
    assert contact.slip_margin_n == pytest.approx(0.025)


def test_what_is_not_measured_is_none() -> None:
    schema = Schema.own()
    message = schema.new("Contacts", contacts=[{"slip_state": 1, "shear_ratio_1e3": 120}, {"shear_ratio_1e3": 120}])
    sticks, unknown = Contacts.from_message(message).contacts
    assert (sticks.slip_state, sticks.shear_ratio) == ("sticks", pytest.approx(0.12))
    assert (sticks.friction, sticks.friction_sigma, sticks.slip_margin_n) == (None, None, None)
    assert (unknown.slip_state, unknown.shear_ratio, unknown.slip_share) == (None, None, None)


def test_an_old_device_has_no_slip() -> None:
    schema = old_schema()
    message = schema.new("Contacts", contacts=[{"area_um2_k": 2000, "force_z_un": -5}])
    (contact,) = Contacts.from_message(message).contacts
    assert contact.area == pytest.approx(2e-6)
    assert contact.slip_state is None
    dense = {"n_x": 1, "n_y": 1, "n_components": 3, "data": bytes(1)}
    assert Field.from_message(schema.new("Field", force=dense, displacement=dense)).slip is None


def test_slip_of_the_nodes_and_their_margin() -> None:
    force = {"n_x": 1, "n_y": 1, "n_components": 3, "data": b"\x03" + bytes([0o46 | (0o5 << 6 & 0xFF), 1]) + bytes(10)}
    slip = {"n_x": 1, "n_y": 1, "n_components": 1, "data": b"\x02\x02" + bytes(7)}
    message = Schema.own().new("Field", force_lsb_un=10, force=force, slip=slip, displacement=force)
    field = Field.from_message(message)
    assert field.slip is not None
    assert field.slip.tolist() == [[1]]
    assert field.force_steps.tolist() == [[[3, 2, -3]]]  # zigzag 6, 4, 5
    margin = field.slip_margin(0.5)
    assert margin[0, 0] == pytest.approx(1e-5 * (0.5 * 3 - np.hypot(3, 2)))
