"""Messages of the stream in SI units, and what an old device leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from golden import read_vectors
from google.protobuf import descriptor_pb2

from ruffini.device.results import (
    INVALID,
    NOT_MEASURED,
    VALID,
    Contacts,
    Depth,
    Features,
    Field,
    Image,
    Residual,
    Wrench,
)
from ruffini.errors import InputError
from ruffini.wire import Decoder
from ruffini.wire.messages import Schema


def old_schema() -> Schema:
    """The schema of a device that knows nothing of slip and of how sure it is."""
    files = descriptor_pb2.FileDescriptorSet.FromString(Schema.own().bytes)
    for message in files.file[0].message_type:
        young = ("slip", "sigma", "covariance", "softness")
        kept = [f for f in message.field if not any(word in f.name for word in young) and f.number < 10]
        if message.name in ("Contact", "Contacts", "Field", "Wrench"):
            del message.field[:]
            message.field.extend(kept)
    return Schema(files.SerializeToString())


def golden(name: str) -> bytes:
    line = next(fields for fields in read_vectors("frames.txt") if name in fields)
    encoded = max((bytes.fromhex(f) for f in line if set(f) <= set("0123456789abcdef ")), key=len)
    return next(iter(Decoder().feed(encoded))).payload


def test_a_contact_that_begins_to_slip() -> None:
    schema = Schema.own()
    (contact,) = Contacts.from_message(
        schema.decode(schema.type_numbers["CONTACTS"], golden("contact that begins to slip"))
    ).contacts
    assert contact.slip_state == "incipient"
    assert contact.shear_ratio == pytest.approx(0.35)
    assert contact.friction == pytest.approx(0.5)
    assert contact.friction_sigma == pytest.approx(0.1)
    assert contact.slip_share == pytest.approx(0.62)
    assert contact.slip_margin_n == pytest.approx(0.025)


def test_what_is_not_measured_is_none() -> None:
    schema = Schema.own()
    message = schema.new(
        "Contacts", contacts=[{"slip": {"slip_state": 1, "shear_ratio_1e3": 120}}, {"slip": {"shear_ratio_1e3": 120}}]
    )
    sticks, unknown = Contacts.from_message(message).contacts
    assert (sticks.slip_state, sticks.shear_ratio) == ("sticks", pytest.approx(0.12))
    assert (sticks.friction, sticks.friction_sigma, sticks.slip_margin_n) == (None, None, None)
    assert (unknown.slip_state, unknown.shear_ratio, unknown.slip_share) == (None, None, None)


def test_an_old_device_has_no_slip() -> None:
    schema = old_schema()
    message = schema.new("Contacts", contacts=[{"area_um2_k": 2000, "force_z_un": -5}])
    assert Contacts.from_message(message).softness is None
    (contact,) = Contacts.from_message(message).contacts
    assert contact.flow_parts is None
    assert contact.area == pytest.approx(2e-6)
    assert contact.slip_state is None
    dense = {"n_x": 1, "n_y": 1, "n_components": 3, "data": bytes(1)}
    assert Field.from_message(schema.new("Field", force=dense, displacement=dense)).slip is None


def test_slip_of_the_nodes_and_their_margin() -> None:
    force = {"n_x": 1, "n_y": 1, "n_components": 3, "data": b"\x03" + bytes([0o46 | (0o5 << 6 & 0xFF), 1]) + bytes(10)}
    slip = {"n_x": 1, "n_y": 1, "n_components": 1, "data": b"\x02\x02" + bytes(7)}
    parts = {"force_lsb_un": 10, "force": force, "slip": slip, "displacement": force}
    field = Field.from_message(Schema.own().new("Field", validity=[VALID] * 3, **parts))
    assert field.slip is not None
    assert field.slip.tolist() == [[1]]
    assert field.force_steps.tolist() == [[[3, 2, -3]]]  # zigzag 6, 4, 5
    margin = field.slip_margin(0.5)
    assert margin[0, 0] == pytest.approx(1e-5 * (0.5 * 3 - np.hypot(3, 2)))
    for validity in ([], [VALID, INVALID, VALID], [VALID, VALID, INVALID]):
        field = Field.from_message(Schema.own().new("Field", validity=validity, **parts))
        assert np.isnan(field.slip_margin(0.5)).all()


def test_slip_with_a_flag_of_a_later_sensor_is_not_told() -> None:
    message = Schema.own().new("Contacts", stamp={"flags": 1 << 30}, contacts=[
        {"validity": VALID,
         "slip": {"slip_state": 1, "shear_ratio_1e3": 120, "friction_1e3": 500, "slip_margin_un": 25_000}},
    ])  # fmt: skip
    (contact,) = Contacts.from_message(message).contacts
    assert (contact.slip_state, contact.shear_ratio, contact.slip_margin_n) == (None, None, None)


def test_how_sure_the_wrench_is() -> None:
    schema = Schema.own()
    wrench = Wrench.from_message(schema.decode(schema.type_numbers["WRENCH"], golden("wrench and how sure it is")))
    assert wrench.covariance_validity == VALID
    assert wrench.covariance is not None
    np.testing.assert_allclose(wrench.covariance, wrench.covariance.T)
    in_un = wrench.covariance / np.outer([1e-6] * 3 + [1e-9] * 3, [1e-6] * 3 + [1e-9] * 3)
    # A force of sigma (2, 2, 7) uN at y = -2 mm: tx = y fz, tz = -y fx.
    np.testing.assert_allclose(np.diag(in_un), [4, 4, 49, 64 + 4 * 49, 64, 9 + 4 * 4])
    assert in_un[2, 3] == pytest.approx(-2 * 49)
    assert in_un[0, 5] == pytest.approx(2 * 4)
    assert np.linalg.eigvalsh(in_un).min() > 0
    assert wrench.sigma is not None
    np.testing.assert_allclose(wrench.sigma, [2e-6, 2e-6, 7e-6, 260**0.5 * 1e-9, 8e-9, 5e-9])


def test_how_sure_the_field_is() -> None:
    schema = Schema.own()
    field = Field.from_message(schema.decode(schema.type_numbers["FIELD"], golden("field and how sure it is")))
    assert field.sigma_validity == VALID
    assert field.sigma is not None
    np.testing.assert_allclose(field.raw_force[0, 0], [200e-6, -100e-6, -3000e-6])
    np.testing.assert_allclose(field.sigma, [[[70e-6, 70e-6, 250e-6], [10e-6, 10e-6, 90e-6]]])


def test_what_the_forces_do_not_explain() -> None:
    schema = Schema.own()
    message = schema.decode(schema.type_numbers["RESIDUAL"], golden("what the forces do not explain"))
    residual = Residual.from_message(message)
    assert residual.validity == VALID
    assert residual.residual.tolist() == [[[-1, 0.5, 0], [8, -2, 0.25]]]
    np.testing.assert_allclose(residual.size, [[(1.25 / 3) ** 0.5, (68.0625 / 3) ** 0.5]])
    message.validity = 3
    assert np.isnan(Residual.from_message(message).size).all()
    assert Residual.from_message(message).raw_residual[0, 1, 0] == 8
    none = Residual.from_message(schema.new("Residual", validity=VALID))
    assert (none.validity, none.raw_residual.shape, none.residual.size) == (NOT_MEASURED, (0, 0, 3), 0)
    message.residual.n_components, message.residual.n_x = 1, 6
    with pytest.raises(InputError, match="1 components"):
        Residual.from_message(message)


def test_features_are_the_boards_integers() -> None:
    schema = Schema.own()
    message = schema.decode(schema.type_numbers["FEATURES"], golden("features of a wrench"))
    features = Features.from_message(message)
    assert (features.capture_s, features.frame, features.value.tolist()) == (1e-3, 7, [-1, 70_000, 0])
    message.value.n_x, message.value.n_y = 1, 3
    with pytest.raises(InputError, match="FEATURES that is no row"):
        Features.from_message(message)


@pytest.mark.parametrize("schema", [Schema.own(), old_schema()], ids=["ours", "old"])
def test_no_error_model_is_no_zero(schema: Schema) -> None:
    """Absent, from a device that states none or knows nothing of it, is None and not measured."""
    dense = {"n_x": 1, "n_y": 1, "n_components": 3, "data": bytes(1)}
    field = Field.from_message(schema.new("Field", force=dense, displacement=dense))
    wrench = Wrench.from_message(schema.new("Wrench", force_z_un=-5, validity=[1] * 6))
    assert (field.sigma, field.sigma_validity) == (None, NOT_MEASURED)
    assert (wrench.covariance, wrench.sigma, wrench.covariance_validity) == (None, None, NOT_MEASURED)


def test_numbers_without_a_validity_are_not_believed() -> None:
    wrench = Wrench.from_message(Schema.own().new("Wrench", covariance=[1] * 21))
    assert wrench.covariance is None
    short = Wrench.from_message(Schema.own().new("Wrench", covariance=[1] * 20, covariance_validity=VALID))
    assert (short.covariance, short.covariance_validity) == (None, NOT_MEASURED)


def test_an_old_reader_passes_over_how_sure_it_is() -> None:
    schema = old_schema()
    message = schema.decode(schema.type_numbers["WRENCH"], golden("wrench and how sure it is"))
    assert Wrench.from_message(message).values[2] == pytest.approx(-1e-3)
    message = schema.decode(schema.type_numbers["FIELD"], golden("field and how sure it is"))
    assert Field.from_message(message).force_steps[0, 0].tolist() == [20, -10, -300]


def test_parts_of_the_flow() -> None:
    schema = Schema.own()
    parts = {"curl_free_nm": 41_500, "divergence_free_nm": 120_000, "twist_urad": -52_300}
    (contact,) = Contacts.from_message(schema.new("Contacts", contacts=[{"helmholtz": parts}])).contacts
    assert contact.flow_parts is not None
    assert contact.flow_parts.curl_free == pytest.approx(41.5e-6)
    assert contact.flow_parts.divergence_free == pytest.approx(120e-6)
    assert contact.flow_parts.twist == pytest.approx(-0.0523)


def test_parts_that_do_not_fit_each_other_are_an_error_with_a_remedy() -> None:
    schema = Schema.own()
    four = {"n_x": 2, "n_y": 2, "data": bytes(1)}
    nodes = {**four, "n_components": 3}
    hostile = {
        Wrench: schema.new("Wrench", validity=[1] * 7),
        Image: schema.new("Image", width_px=2, height_px=2, data=bytes(11)),
        Depth: schema.new("Depth", depth={**four, "n_components": 2}),
    }
    fields = [
        {"force": {**four, "n_components": 2}},
        {"force": nodes, "displacement": {**nodes, "n_x": 1}},
        {"force": nodes, "sigma": {**nodes, "n_components": 1}},
        {"force": nodes, "slip": {**nodes, "n_components": 3}},
    ]
    for result, message in [*hostile.items(), *((Field, schema.new("Field", **f)) for f in fields)]:
        with pytest.raises(InputError, match="is inconsistent: update the host tools"):
            result.from_message(message)
    assert Field.from_message(schema.new("Field", force=nodes)).force.shape == (2, 2, 3)


def test_units_and_validity_of_every_part_of_a_wrench() -> None:
    """Expected values are the units of proto/README.md, by hand: uN, and uN um for torque."""
    validity = [VALID, VALID, NOT_MEASURED, VALID, INVALID, VALID]
    wrench = Wrench.from_message(
        Schema.own().new("Wrench", force_x_un=2_000_000, force_z_un=7, torque_x_un_um=3_000_000_000, validity=validity)
    )
    np.testing.assert_allclose(wrench.force, [2.0, 0.0, np.nan])
    np.testing.assert_allclose(wrench.torque, [3e-3, np.nan, 0.0])
    assert np.isnan(wrench.values[2])


def test_a_contact_lies_where_its_x_and_y_say() -> None:
    message = Schema.own().new("Contacts", contacts=[{"center_x_um": 1_500, "center_y_um": -250}])
    assert Contacts.from_message(message).contacts[0].center == pytest.approx((1.5e-3, -0.25e-3))


def test_an_image_has_its_rows_first() -> None:
    message = Schema.own().new("Image", width_px=3, height_px=2, data=bytes(range(18)))
    pixels = Image.from_message(message).pixels
    assert pixels.shape == (2, 3, 3)
    assert pixels[1, 0].tolist() == [9, 10, 11]


def test_lengths_are_in_metres() -> None:
    """A value of 1 (zigzag 2) in steps of 125 nm is 1.25e-7 m."""
    ones = {"n_x": 1, "n_y": 1, "n_components": 3, "data": b"\x02\x2a" + bytes(7)}
    one = {"n_x": 1, "n_y": 1, "n_components": 1, "data": b"\x02\x02" + bytes(7)}
    field = Field.from_message(Schema.own().new("Field", force=ones, displacement=ones, displacement_lsb_nm=125))
    assert field.displacement is not None
    np.testing.assert_allclose(field.displacement, np.full((1, 1, 3), 1.25e-7))
    depth = Depth.from_message(Schema.own().new("Depth", depth=one, depth_lsb_nm=125, validity=VALID))
    np.testing.assert_allclose(depth.depth, [[1.25e-7]])


def test_what_pulls_on_the_pad_has_no_slip_margin() -> None:
    pulled = {"n_x": 1, "n_y": 1, "n_components": 3, "data": b"\x02\x20" + bytes(7)}  # 0, 0, +1
    field = Field.from_message(Schema.own().new("Field", force_lsb_un=10, force=pulled, validity=[VALID] * 3))
    assert field.force_steps.tolist() == [[[0, 0, 1]]]
    assert field.slip_margin(0.5).tolist() == [[0.0]]


def test_a_squeeze_has_a_modulus_and_an_interval() -> None:
    schema = Schema.own()
    sent = {"validity": 1, "squeeze": 3, "n_frames": 7, "modulus_pa": 57_000, "low_pa": 49_000, "high_pa": 66_000,
            "log_share_q16": -131_072, "log_sigma_q16": 13_107}  # fmt: skip
    softness = Contacts.from_message(schema.new("Contacts", softness=sent)).softness
    assert softness is not None
    assert (softness.squeeze, softness.n_frames, softness.validity) == (3, 7, 1)
    assert (softness.modulus_pa, softness.low_pa, softness.high_pa) == (57e3, 49e3, 66e3)
    assert (softness.log_share, softness.log_sigma) == (-2.0, pytest.approx(0.2, abs=1e-4))
    rigid = Contacts.from_message(schema.new("Contacts", softness={**sent, "modulus_pa": 0, "high_pa": 0})).softness
    assert rigid is not None
    assert (rigid.modulus_pa, rigid.low_pa, rigid.high_pa) == (np.inf, 49e3, np.inf)
    wrong = Contacts.from_message(schema.new("Contacts", softness={**sent, "validity": 3})).softness
    assert wrong is not None
    assert np.isnan([wrong.modulus_pa, wrong.low_pa, wrong.high_pa, wrong.log_share, wrong.log_sigma]).all()
    assert Contacts.from_message(schema.new("Contacts")).softness is None
