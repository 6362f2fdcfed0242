"""The rclpy node on a FAKE rclpy: ROS 2 itself is not here.

The fake's message classes are made of rosbags' type definitions: they have the fields of the real ones and take nothing
else. What it cannot show is that the real rclpy takes these values, and that nodes hear each other.
"""

from __future__ import annotations

import array
import sys
import types as python_types
from typing import Any

import pytest
from made_frames import NODES, frame

from ruffini.errors import InputError
from ruffini.ros.cdr import Types
from ruffini.ros.messages import DIAGNOSTICS, TOPICS, diagnostics, messages_of
from ruffini.ros.rclpy_node import RclpyNode

published: list[tuple[str, Any]] = []
profiles: dict[str, Any] = {}
others: list[str] = []  # names of all nodes that the fake's graph has


def fake_message(name: str, fields: list[str]) -> type:
    return type(name.split("/")[-1], (), {"__slots__": fields})


class FakePublisher:
    def __init__(self, name: str, kind: type) -> None:
        self.name, self.kind = name, kind

    def publish(self, message: Any) -> None:
        assert type(message) is self.kind
        published.append((self.name, message))


class FakeNode:
    def create_publisher(self, kind: type, name: str, profile: Any) -> FakePublisher:
        profiles[name] = profile
        return FakePublisher(name, kind)

    def get_node_names(self) -> list[str]:
        return others

    def destroy_node(self) -> None:
        published.append(("destroyed", None))


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fake ROS 2 in sys.modules."""
    published.clear()
    modules: dict[str, python_types.ModuleType] = {}
    for name, (_, fields) in Types().store.fielddefs.items():
        package, kind, short = name.split("/")
        module = modules.setdefault(f"{package}.{kind}", python_types.ModuleType(f"{package}.{kind}"))
        setattr(module, short, fake_message(name, [f for f, _ in fields]))
        modules.setdefault(package, python_types.ModuleType(package))
    rclpy, qos = python_types.ModuleType("rclpy"), python_types.ModuleType("rclpy.qos")
    rclpy.init = lambda: None  # type: ignore[attr-defined]
    rclpy.create_node = lambda _: FakeNode()  # type: ignore[attr-defined]
    rclpy.try_shutdown = lambda: None  # type: ignore[attr-defined]
    qos.ReliabilityPolicy = python_types.SimpleNamespace(RELIABLE="reliable", BEST_EFFORT="best effort")  # type: ignore[attr-defined]
    qos.QoSProfile = lambda **settings: settings  # type: ignore[attr-defined]
    for name, module in {**modules, "rclpy": rclpy, "rclpy.qos": qos}.items():
        monkeypatch.setitem(sys.modules, name, module)


def test_all_messages_have_the_fields_of_their_types(ros: None) -> None:
    with RclpyNode("ruffini_1") as node:
        for topic in (*TOPICS, DIAGNOSTICS):
            node.advertise(topic.name, topic)
        for name, message in messages_of(frame(), "ruffini_1", NODES, 1_500_000_000, 0.0):
            node.publish(name, message)
        node.publish(DIAGNOSTICS.name, diagnostics(0, "1", 1, ["late"], {"a": "b"}))
    assert [name for name, _ in published] == [*(t.name for t in TOPICS), "/diagnostics", "destroyed"]
    got = dict(published)
    assert got["wrench"].header.stamp.sec == 1
    assert got["wrench"].wrench.force.z == -3e-3
    assert isinstance(got["field"].data, array.array)
    assert got["field"].fields[3].name == "fx"
    assert got["contacts"].contacts[0].slip_state == 2
    assert got["/diagnostics"].status[0].level == b"\1"
    assert profiles["wrench"] == {"depth": 10, "reliability": "best effort"}
    assert profiles["depth"] == {"depth": 10, "reliability": "reliable"}


def test_another_node_of_its_name_is_seen(ros: None) -> None:
    with RclpyNode("ruffini_1") as node:
        for names, n in (([], 0), (["ruffini_1", "ruffini_2"], 0), (["ruffini_1", "rviz", "ruffini_1"], 1)):
            others[:] = names
            assert node.n_namesakes() == n


def test_without_ros_it_says_what_to_do() -> None:
    with pytest.raises(InputError, match="source ROS 2's setup file, or use --through zenoh"):
        RclpyNode("x")
