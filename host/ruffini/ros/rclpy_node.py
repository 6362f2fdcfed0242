"""The same topics by an ordinary rclpy node, where ROS 2 is installed and ruffini_msgs was built in a workspace."""

from __future__ import annotations

import array
import importlib
from typing import Any

from ruffini.errors import InputError
from ruffini.ros.messages import Message, Topic

TO_BYTES = {("diagnostic_msgs/msg/DiagnosticStatus", "level")}  # ROS type byte: bytes of length one in Python


def message_class(type_: str) -> Any:
    """rclpy's class of a type, e.g. geometry_msgs/msg/Wrench."""
    package, kind, name = type_.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except ImportError as error:
        hint = "build ruffini_msgs (`ruffini ros2 messages FOLDER`)" if package == "ruffini_msgs" else "source ROS 2"
        raise InputError(f"rclpy does not know {type_}: {hint}, then source the workspace's setup file") from error


def made(value: Any) -> Any:
    """A Message as rclpy's object."""
    if isinstance(value, Message):
        out = message_class(value.type)()
        for name, part in value.fields.items():
            is_byte = (value.type, name) in TO_BYTES
            setattr(out, name, bytes([part]) if is_byte else made(part))
        return out
    if isinstance(value, bytes):
        return array.array("B", value)  # of anything else rclpy looks at each element
    return [made(part) for part in value] if isinstance(value, list) else value


class RclpyNode:
    """A node that publishes; use as a context manager.

    Raises
    ------
    InputError
        There is no rclpy: ROS 2 is not installed or its setup file was not sourced.
    """

    def __init__(self, name: str) -> None:
        try:
            self._rclpy: Any = importlib.import_module("rclpy")
            self._qos: Any = importlib.import_module("rclpy.qos")
        except ImportError as error:
            raise InputError("no rclpy here: source ROS 2's setup file, or use --through zenoh") from error
        self._rclpy.init()
        self._node, self._name = self._rclpy.create_node(name), name
        self._publishers: dict[str, Any] = {}

    def __enter__(self) -> RclpyNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def n_namesakes(self) -> int:
        """Other nodes of this name in the graph."""
        return max(list(self._node.get_node_names()).count(self._name) - 1, 0)

    def advertise(self, name: str, topic: Topic) -> None:
        """Be seen as a publisher of the topic `name`."""
        kind = self._qos.ReliabilityPolicy
        profile = self._qos.QoSProfile(
            depth=topic.depth, reliability=kind.RELIABLE if topic.is_reliable else kind.BEST_EFFORT
        )
        self._publishers[name] = self._node.create_publisher(message_class(topic.type), name, profile)

    def publish(self, name: str, message: Message) -> None:
        """Send on a topic that was advertised."""
        self._publishers[name].publish(made(message))
