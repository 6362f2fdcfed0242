"""Keys, tokens and attachments as rmw_zenoh's nodes read them."""

from __future__ import annotations

import pytest
import zenoh
import zenoh.ext
from test_ros_messages import KNOWN_HASHES

from ruffini.errors import InputError
from ruffini.ros.messages import DIAGNOSTICS, TOPICS
from ruffini.ros.rmw_zenoh import (
    attachment,
    configuration,
    namesakes_key,
    node_token,
    publisher_token,
    qos_key,
    topic_key,
)

HASH = KNOWN_HASHES["geometry_msgs/msg/WrenchStamped"]


def test_keys_have_the_parts_that_rmw_zenoh_names() -> None:
    key = topic_key(3, "/ruffini_1/wrench", "geometry_msgs/msg/WrenchStamped", HASH)
    assert key == f"3/ruffini_1/wrench/geometry_msgs::msg::dds_::WrenchStamped_/{HASH}"
    assert node_token(3, "a1b2", "ruffini_1") == "@ros2_lv/3/a1b2/0/0/NN/%/%/ruffini_1"
    assert publisher_token(3, "a1b2", 7, "ruffini_1", "/ruffini_1/wrench", TOPICS[0], HASH) == (
        "@ros2_lv/3/a1b2/0/7/MP/%/%/ruffini_1/%ruffini_1%wrench/"
        f"geometry_msgs::msg::dds_::WrenchStamped_/{HASH}/2::,10:,:,:,,"
    )


def test_another_node_of_its_name_is_seen_whoever_made_it() -> None:
    wanted = zenoh.KeyExpr(namesakes_key(3, "ruffini_1"))
    assert wanted.includes(zenoh.KeyExpr(node_token(3, "ffff", "ruffini_1")))
    assert wanted.includes(zenoh.KeyExpr("@ros2_lv/3/a1b2/4/4/NN/%/%/ruffini_1"))  # a node of a process with several
    for other in (node_token(4, "ffff", "ruffini_1"), node_token(3, "ffff", "ruffini_12")):
        assert not wanted.includes(zenoh.KeyExpr(other))


def test_quality_of_service_is_best_effort_but_for_images_and_health() -> None:
    assert {t.name: qos_key(t) for t in (*TOPICS, DIAGNOSTICS)} == {
        "wrench": "2::,10:,:,:,,", "measurement": "2::,10:,:,:,,", "field": "2::,10:,:,:,,",
        "depth": "::,10:,:,:,,", "contacts": "2::,10:,:,:,,",
        "softness": "2::,10:,:,:,,", "learned": "2::,10:,:,:,,",
        "residual": "::,10:,:,:,,", "/diagnostics": "::,10:,:,:,,",
    }  # fmt: skip


def test_an_attachment_is_what_zenohs_own_serialisation_makes() -> None:
    gid = bytes(range(16))
    parts = (zenoh.ext.Int64(5), zenoh.ext.Int64(-6), gid)
    theirs = b"".join(bytes(zenoh.ext.z_serialize(part)) for part in parts)
    assert attachment(5, -6, gid) == theirs
    assert len(theirs) == 33


def test_a_wrong_configuration_file_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", "/nowhere/zenoh.json5")
    with pytest.raises(InputError, match=r"ZENOH_SESSION_CONFIG_URI=/nowhere/zenoh\.json5"):
        configuration([], [])
