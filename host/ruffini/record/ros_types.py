"""Wrench and field as the ROS 2 messages that every viewer knows, in CDR: no ROS is needed to write or to read them.

`geometry_msgs/msg/WrenchStamped` and `sensor_msgs/msg/PointCloud2`: the nodes where they have moved to (x, y, z,
metres) and the force ON the pad at each (fx, fy, fz, newtons). What is not valid is NaN. Layout: OMG CDR,
little endian, each number at a multiple of its size behind the four bytes of the head.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from ruffini.api.sensor import node_places, sensor_info
from ruffini.device.results import Array, Field, Wrench, valid_or_nan
from ruffini.ros.messages import frame_id, pad_name
from ruffini.wire import Frame

HEADER = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
WRENCH_STAMPED = f"""\
std_msgs/Header header
geometry_msgs/Wrench wrench
{HEADER}================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
POINT_CLOUD = f"""\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{HEADER}================================================================================
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count
"""
FIELDS = ("x", "y", "z", "fx", "fy", "fz")
FLOAT32 = 7  # of PointField


class Cdr:
    """Numbers one after the other, aligned."""

    def __init__(self) -> None:
        self._out = bytearray()

    def put(self, kind: str, *values: Any) -> Cdr:
        """Values of a struct type, e.g. "I" or "d"."""
        size = struct.calcsize(kind)
        for value in values:
            self._out += bytes(-len(self._out) % size) + struct.pack("<" + kind, value)
        return self

    def text(self, value: str) -> Cdr:
        """A string."""
        data = value.encode() + b"\0"
        self.put("I", len(data))
        self._out += data
        return self

    def header(self, time_ns: int, frame_id: str) -> Cdr:
        """std_msgs/Header."""
        return self.put("i", time_ns // 1_000_000_000).put("I", time_ns % 1_000_000_000).text(frame_id)

    def octets(self, data: bytes) -> Cdr:
        """uint8[]."""
        self.put("I", len(data))
        self._out += data
        return self

    def bytes(self) -> bytes:
        """With its head."""
        return b"\0\1\0\0" + bytes(self._out)


def wrench_stamped(wrench: Wrench, time_ns: int, frame_id: str) -> bytes:
    """A WrenchStamped; NaN where it is not valid."""
    return Cdr().header(time_ns, frame_id).put("d", *wrench.force, *wrench.torque).bytes()


def point_cloud(field: Field, nodes: Array, time_ns: int, frame_id: str) -> bytes:
    """A PointCloud2 of (n_y, n_x) points; `nodes` (n_y, n_x, 2) metres at rest."""
    n_y, n_x = nodes.shape[:2]
    points = np.zeros((n_y, n_x, 6), "<f4")
    points[..., :2] = nodes
    if field.displacement is not None:
        points[..., :3] += np.nan_to_num(valid_or_nan(field.displacement, field.validity, field.flags))
    points[..., 3:] = field.force
    out = Cdr().header(time_ns, frame_id).put("I", n_y, n_x, len(FIELDS))
    for i, name in enumerate(FIELDS):
        out.text(name).put("I", 4 * i).put("B", FLOAT32).put("I", 1)
    step = 4 * len(FIELDS)
    out.put("B", 0).put("I", step, step * n_x).octets(points.tobytes())
    return out.put("B", int(not np.isnan(points).any())).bytes()


class RosChannels:
    """Writes the ROS messages of a stream beside it: topics /ruffini/ros/<sensor>/wrench and .../field."""

    def __init__(self, writer: Any, hello: Any) -> None:
        self._writer, self._hello = writer, hello
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, int], int] = {}
        self._nodes: dict[int, Array] = {}

    def write(self, name: str, packet: Frame, message: Any, log_time_ns: int, time_ns: int) -> None:
        """One message of the sensor; all but WRENCH and FIELD are passed over. `time_ns`: mid-exposure, UTC."""
        sensor = packet.sensor
        where = frame_id(pad_name(self._hello.device_serial, sensor, len(self._hello.sensors)), packet)
        if name == "WRENCH":
            data = wrench_stamped(Wrench.from_message(message), time_ns, where)
            channel = self._channel("wrench", sensor, "geometry_msgs/msg/WrenchStamped", WRENCH_STAMPED)
        elif name == "FIELD":
            field = Field.from_message(message)
            if sensor not in self._nodes:
                self._nodes[sensor] = node_places(sensor_info(self._hello, sensor, "HELLO"))
            if field.raw_force.shape[:2] != self._nodes[sensor].shape[:2]:
                return  # not the nodes that HELLO told of
            data = point_cloud(field, self._nodes[sensor], time_ns, where)
            channel = self._channel("field", sensor, "sensor_msgs/msg/PointCloud2", POINT_CLOUD)
        else:
            return
        self._writer.add_message(channel, log_time=log_time_ns, data=data, publish_time=log_time_ns)

    def _channel(self, what: str, sensor: int, kind: str, text: str) -> int:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
        key = (what, sensor)
        if key not in self._channels:
            self._channels[key] = self._writer.register_channel(
                topic=f"/ruffini/ros/{sensor}/{what}", message_encoding="cdr", schema_id=self._schemas[kind]
            )
        return self._channels[key]
