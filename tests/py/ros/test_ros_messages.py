"""Frames as ROS 2 messages: type hashes and bytes as ROS has them, and no number without its validity."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from made_frames import FORCE, NODES, frame

from ruffini.record.ros_types import point_cloud, wrench_stamped
from ruffini.ros.cdr import SOURCES, Types
from ruffini.ros.messages import ERROR, TOPICS, Message, diagnostics, frame_id, messages_of, pad_name, ros_name

# As ROS 2 itself says: `ros2 topic info -v` of several publishers on Jazzy, rcl's own test for PointCloud2.
KNOWN_HASHES = {
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Header": "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    "geometry_msgs/msg/WrenchStamped": "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope="module")
def types() -> Types:
    return Types()


def parts(**changes: object) -> dict[str, Message]:
    return dict(messages_of(frame(**changes), "ruffini_1", NODES, STAMP_NS, 2e-5))  # type: ignore[arg-type]


def test_hashes_of_standard_types_are_those_of_ros(types: Types) -> None:
    assert {name: types.hash(name) for name in KNOWN_HASHES} == KNOWN_HASHES
    assert all(types.hash(topic.type).startswith("RIHS01_") for topic in TOPICS)


def test_a_wrench_is_the_bytes_that_cdr_wants(types: Types) -> None:
    name = b"simulated_ruffini_1_pad\0"
    want = b"\0\1\0\0" + struct.pack("<iII", 1_700_000_000, 123_456_789, len(name)) + name
    want += b"\0" * (-(len(want) - 4) % 8)  # float64 stand on eights, counted behind the first four bytes
    want += struct.pack("<6d", *(n * 1e-6 for n in (1000, -2000, -3000)), *(n * 1e-12 for n in (4e6, 5e6, 6e6)))
    assert types.encode(parts()["wrench"]) == want


def test_every_message_comes_back_as_it_went(types: Types) -> None:
    got = {name: types.decode(types.encode(m), m.type) for name, m in parts().items()}
    assert set(got) == {topic.name for topic in TOPICS}
    m = got["measurement"]
    assert (m.frame, m.capture_us, m.is_simulated, m.is_replay, m.stamp_error) == (420, 7_000_000, True, False, 2e-5)
    assert list(m.validity) == [1] * 6
    covariance = m.covariance.reshape(6, 6)
    assert covariance[2, 3] == covariance[3, 2] == pytest.approx(-98e-15)
    cloud = got["field"]
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "fx", "fy", "fz", "ux", "uy", "uz", "slip"]
    points = cloud.data.view("<f4").reshape(cloud.height, cloud.width, -1)
    rest = np.concatenate([NODES, np.zeros((2, 3, 1))], axis=2)
    np.testing.assert_allclose(points[..., :3], rest + FORCE * 1e-7, atol=1e-9)  # where they have moved to
    np.testing.assert_allclose(points[..., 3:6], FORCE * 1e-5, atol=1e-9)
    np.testing.assert_allclose(points[..., 6:9], FORCE * 1e-7, atol=1e-12)
    assert (points[..., 9] == 2).all()
    assert (cloud.point_step, cloud.row_step, cloud.is_dense) == (40, 120, True)
    depth = got["depth"]
    assert (depth.encoding, depth.height, depth.width, depth.step) == ("32FC1", 3, 4, 16)
    np.testing.assert_allclose(depth.data.view("<f4"), -np.arange(12) * 1e-6, atol=1e-12)
    (contact,) = got["contacts"].contacts
    assert got["contacts"].n_found == 9
    assert (contact.id, contact.slip_state) == (3, contact.INCIPIENT)
    assert contact.force.z == pytest.approx(-3e-3)
    assert contact.area == pytest.approx(5e-6)
    assert contact.shear_ratio == pytest.approx(0.35)
    assert math.isnan(contact.friction)


@pytest.mark.parametrize("validity", [(1,) * 6, (1, 1, 3, 1, 0, 2)])
def test_recordings_have_the_same_messages(types: Types, validity: tuple[int, ...]) -> None:
    """Those are written without rosbags: byte for byte the same wrench, the same points and forces."""
    one = frame(validity=validity)
    assert one.wrench is not None
    assert one.field is not None
    where, sent = frame_id("ruffini_1", one), parts(validity=validity)
    assert wrench_stamped(one.wrench, STAMP_NS, where) == types.encode(sent["wrench"])
    kind = "sensor_msgs/msg/PointCloud2"
    theirs = types.decode(point_cloud(one.field, NODES, STAMP_NS, where), kind)
    ours = types.decode(types.encode(sent["field"]), kind)
    assert (theirs.header, theirs.height, theirs.width, theirs.is_dense) == (ours.header, 2, 3, validity[2] == 1)
    assert [f.name for f in theirs.fields] == [f.name for f in ours.fields][:6]
    points = [m.data.view("<f4").reshape(2, 3, -1)[..., :6] for m in (theirs, ours)]
    np.testing.assert_allclose(*points, rtol=1e-6)


def test_what_is_not_valid_is_nan_everywhere_and_says_why(types: Types) -> None:
    got = {
        name: types.decode(types.encode(m), m.type)
        for name, m in parts(validity=(1, 1, 3, 1, 0, 2), flags=1024).items()
    }
    force, torque = got["wrench"].wrench.force, got["wrench"].wrench.torque
    assert force.x == 1e-3
    assert all(math.isnan(v) for v in (force.z, torque.y, torque.z))
    assert list(got["measurement"].validity) == [1, 1, 3, 1, 0, 2]
    assert got["measurement"].flag_names == ["FLAG_LIGHT"]
    assert not got["field"].is_dense
    points = got["field"].data.view("<f4").reshape(2, 3, -1)
    assert np.isnan(points[..., [5, 8]]).all()  # fz, uz
    assert np.isfinite(points[..., [0, 1, 2, 3, 4, 6, 7]]).all()
    assert (points[..., 2] == 0).all()  # how far along z is not known: drawn at rest
    assert np.isnan(got["depth"].data.view("<f4")).all()
    assert math.isnan(got["contacts"].contacts[0].force.z)
    assert math.isnan(got["contacts"].contacts[0].peak_depth)


def test_the_frame_says_that_it_is_simulated() -> None:
    assert frame_id("ruffini_1", frame()) == "simulated_ruffini_1_pad"
    assert frame_id("ruffini_1", frame(is_simulated=False)) == "ruffini_1_pad"


def test_names_are_what_ros_allows() -> None:
    assert ros_name("00-1 b") == "ruffini_00_1_b"
    assert ros_name("") == "ruffini_sensor"
    assert pad_name("7", 1, 2) == "ruffini_7_1"
    assert pad_name("7", 0, 1) == "ruffini_7"


def test_diagnostics_come_back(types: Types) -> None:
    m = diagnostics(STAMP_NS, "00-1", ERROR, ["too warm", "late"], {"frame rate": "60.0 Hz"})
    (status,) = types.decode(types.encode(m), m.type).status
    assert (status.level, status.message, status.hardware_id) == (ERROR, "too warm; late", "00-1")
    assert [(v.key, v.value) for v in status.values] == [("frame rate", "60.0 Hz")]


def test_the_ros_package_names_each_of_its_messages() -> None:
    cmake = (SOURCES / "CMakeLists.txt").read_text()
    names = sorted(path.name for path in SOURCES.glob("msg/*.msg"))
    stems = ["Contact", "ContactArray", "ContactModel", "FlowParts", "Learned", "Measurement", "SkinTouch",
             "Softness", "ToolTouch"]  # fmt: skip
    assert names == [f"{stem}.msg" for stem in stems]
    assert all(f'"msg/{name}"' in cmake for name in names)
