"""A frame as ROS 2 messages for either serialiser: rosbags' types (`cdr`) or rclpy (`rclpy_node`).

SI units. Frame of all: origin at the centre of the undeformed pad's surface, x right and y down in the camera's image,
z out of the pad; forces act ON the pad. A number that is not VALID is NaN, never zero. What rests on a simulated camera
has a frame_id that begins with `simulated_`, what rests on a recording `replay_`: no transform leads there unless
somebody made one on purpose.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.api.frame import SensorFrame
from ruffini.device.results import (
    VALID,
    Contact,
    ContactModel,
    Field,
    Learned,
    SkinTouch,
    Softness,
    ToolTouch,
    valid_or_nan,
)
from ruffini.wire import Frame

Array = npt.NDArray[np.float64]
NAN = math.nan
OK, WARN, ERROR, STALE = range(4)  # levels of a DiagnosticStatus
FLOAT32, N_COVARIANCE = 7, 36  # sensor_msgs/PointField.FLOAT32
BAD_HEALTH = ("HEALTH_CAMERA_STALLED", "HEALTH_SAFE_MODE", "HEALTH_UNCALIBRATED")
KINDS = {None: 0, "planar": 1, "hertzian": 2}
SLIP_STATES = {None: 0, "sticks": 1, "incipient": 2, "slides": 3}


class Message(NamedTuple):
    """A message of any ROS type.

    Fields hold numbers, texts, Messages, lists, numpy arrays for arrays of a fixed size, bytes for uint8 without one.
    """

    type: str
    fields: dict[str, Any]


@dataclass(frozen=True)
class Topic:
    """One topic below the sensor's name. `is_reliable`: else best effort, the newest matter."""

    name: str
    type: str
    is_reliable: bool = False
    depth: int = 10


# Best effort for what comes with every picture; images reliable, because RViz of Humble takes no others.
TOPICS = (
    Topic("wrench", "geometry_msgs/msg/WrenchStamped"),
    Topic("measurement", "ruffini_msgs/msg/Measurement"),
    Topic("field", "sensor_msgs/msg/PointCloud2"),
    Topic("depth", "sensor_msgs/msg/Image", is_reliable=True),
    Topic("contacts", "ruffini_msgs/msg/ContactArray"),
    Topic("softness", "ruffini_msgs/msg/Softness"),
    Topic("learned", "ruffini_msgs/msg/Learned"),
    Topic("residual", "sensor_msgs/msg/Image", is_reliable=True),
)
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", is_reliable=True)


def ros_name(serial: str) -> str:
    """Name of a sensor's node and topics: what ROS allows of its serial number."""
    return "ruffini_" + (re.sub(r"[^A-Za-z0-9_]", "_", serial) or "sensor")


def pad_name(serial: str, sensor: int, n_sensors: int) -> str:
    """Name of one pad: the sensor's, with its number where there are several."""
    return ros_name(serial) + (f"_{sensor}" if n_sensors > 1 else "")


def frame_id(name: str, frame: SensorFrame | Frame) -> str:
    """Name of the frame that a message's numbers are in."""
    mark = "simulated_" if frame.is_simulated else "replay_" if frame.is_replay else ""
    return f"{mark}{name}_pad"


def header(stamp_ns: int, frame: str) -> Message:
    """`stamp_ns` of the system clock."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    stamp = Message("builtin_interfaces/msg/Time", {"sec": seconds, "nanosec": rest})
    return Message("std_msgs/msg/Header", {"stamp": stamp, "frame_id": frame})


def _vector(values: Sequence[float] | Array, type_: str = "geometry_msgs/msg/Vector3") -> Message:
    return Message(type_, dict(zip("xyz", map(float, values), strict=True)))


def _wrench(frame: SensorFrame) -> Message:
    assert frame.wrench is not None
    return Message(
        "geometry_msgs/msg/Wrench", {"force": _vector(frame.wrench.force), "torque": _vector(frame.wrench.torque)}
    )


def _measurement(frame: SensorFrame, head: Message, stamp_error_s: float) -> Message:
    assert frame.wrench is not None
    w = frame.wrench
    is_sure = w.covariance is not None and w.covariance_validity == VALID
    covariance = w.covariance.ravel() if is_sure and w.covariance is not None else np.full(N_COVARIANCE, NAN)
    return Message(
        "ruffini_msgs/msg/Measurement",
        {
            "header": head, "stamp_error": stamp_error_s, "frame": frame.number,
            "capture_us": round(frame.capture_s * 1e6), "flags": frame.flag_bits, "flag_names": list(frame.flags),
            "is_simulated": frame.is_simulated, "is_replay": frame.is_replay,
            "validity": np.array(w.validity, np.uint8), "wrench": _wrench(frame), "covariance": covariance,
            "covariance_validity": w.covariance_validity,
            "depth_sigma": NAN if frame.depth is None else _or_nan(frame.depth.sigma),
        },
    )  # fmt: skip


def cloud_values(field: Field, nodes: Array) -> dict[str, Array]:
    """(n_y, n_x) values of the field by the name of its PointField; nodes (n_y, n_x, 2) metres at rest."""
    parts: dict[str, Array] = {"": np.concatenate([nodes, np.zeros((*nodes.shape[:2], 1))], axis=2), "f": field.force}
    if field.displacement is not None:
        parts["u"] = valid_or_nan(field.displacement, field.validity, field.flags)
        parts[""] = parts[""] + np.nan_to_num(parts["u"])  # where the nodes have moved to, as far as that is known
    if field.sigma is not None:
        parts["s"] = valid_or_nan(field.sigma, (field.sigma_validity,) * 3, field.flags)
    columns = {letter + axis: part[..., i] for letter, part in parts.items() for i, axis in enumerate("xyz")}
    if field.slip is not None:
        columns["slip"] = field.slip.astype(np.float64)
    return columns


def _cloud(field: Field, nodes: Array, head: Message) -> Message:
    columns = cloud_values(field, nodes)
    points = np.stack(list(columns.values()), axis=-1).astype("<f4")
    n_y, n_x, n_columns = points.shape
    kind = "sensor_msgs/msg/PointField"
    fields = [
        Message(kind, {"name": name, "offset": 4 * i, "datatype": FLOAT32, "count": 1})
        for i, name in enumerate(columns)
    ]
    return Message(
        "sensor_msgs/msg/PointCloud2",
        {
            "header": head, "height": n_y, "width": n_x, "fields": fields, "is_bigendian": False,
            "point_step": 4 * n_columns, "row_step": 4 * n_columns * n_x,
            "data": points.tobytes(), "is_dense": bool(np.isfinite(points).all()),
        },
    )  # fmt: skip


def _picture(values: Array, head: Message) -> Message:
    """(n_y, n_x) or (n_y, n_x, 3) numbers."""
    pixels = values.astype("<f4")
    n_y, n_x, *n_components = values.shape
    n = n_components[0] if n_components else 1
    return Message(
        "sensor_msgs/msg/Image",
        {
            "header": head, "height": n_y, "width": n_x, "encoding": f"32FC{n}",
            "is_bigendian": 0, "step": 4 * n * n_x, "data": pixels.tobytes(),
        },
    )  # fmt: skip


def _or_nan(value: float | None) -> float:
    return NAN if value is None else value


def _skin(t: SkinTouch) -> Message:
    return Message(
        "ruffini_msgs/msg/SkinTouch",
        {
            "place": _vector(t.place_m, "geometry_msgs/msg/Point"), "normal_force": _vector(t.normal_force_n),
            "force_sigma": _or_nan(t.force_sigma_n), "center_sigma": _or_nan(t.center_sigma_m),
        },
    )  # fmt: skip


def _tool(t: ToolTouch) -> Message:
    (x, y), (x_sigma, y_sigma) = t.place_m, t.place_sigma_m
    return Message(
        "ruffini_msgs/msg/ToolTouch",
        {
            "x": x, "y": y, "way": t.way_m, "roll": t.roll_rad, "pitch": t.pitch_rad,
            "normal_force": _vector(t.normal_force_n), "flat_area": _or_nan(t.flat_area_m2),
            "force_sigma": t.force_sigma_n, "x_sigma": x_sigma, "y_sigma": y_sigma, "way_sigma": t.way_sigma_m,
            "roll_sigma": t.roll_sigma_rad, "pitch_sigma": t.pitch_sigma_rad,
            "face_area_sigma": t.face_area_sigma_m2, "flat_area_sigma": _or_nan(t.flat_area_sigma_m2),
        },
    )  # fmt: skip


def _model(c: ContactModel) -> Message:
    return Message(
        "ruffini_msgs/msg/ContactModel",
        {
            "kind": KINDS[c.kind], "kind_confidence": _or_nan(c.kind_confidence), "gel_depth": c.gel_depth_m,
            "gel_depth_sigma": c.gel_depth_sigma_m, "press_depth": c.press_depth_m,
            "effective_area": c.effective_area_m2, "depth_validity": c.depth_validity,
            "stiffness": c.stiffness_pa_per_m, "shore_a": c.shore_a, "shore_a_sigma": c.shore_a_sigma,
            "hardness_validity": c.hardness_validity, "mean_flow": c.mean_flow_m,
            "moment_by_flow": c.moment_by_flow_nm,
        },
    )  # fmt: skip


def _learned(result: Learned, head: Message) -> Message:
    return Message(
        "ruffini_msgs/msg/Learned",
        {
            "header": head, "frame": result.frame, "names": list(result.quantities),
            "values": np.array(list(result.quantities.values()), np.int64), "is_valid": result.is_valid,
            "took": result.took_s, "latency": result.latency_s, "rate": result.rate_hz,
        },
    )  # fmt: skip


def _contact(c: Contact) -> Message:
    return Message(
        "ruffini_msgs/msg/Contact",
        {
            "id": c.id, "position": _vector((*c.center, 0.0), "geometry_msgs/msg/Point"), "force": _vector(c.force),
            "area": c.area or NAN, "peak_depth": float(valid_or_nan([c.peak_depth], (c.validity,), c.flags)[0]),
            "slip_state": SLIP_STATES[c.slip_state], "shear_ratio": _or_nan(c.shear_ratio),
            "friction": _or_nan(c.friction), "friction_sigma": _or_nan(c.friction_sigma),
            "slip_share": _or_nan(c.slip_share), "slip_margin": _or_nan(c.slip_margin_n),
            "reaches_border": c.reaches_border, "skin": [] if c.skin is None else [_skin(c.skin)],
            "tool": [] if c.tool is None else [_tool(c.tool)],
            "model": [] if c.model is None else [_model(c.model)],
            "flow_parts": [] if c.flow_parts is None else [Message("ruffini_msgs/msg/FlowParts", vars(c.flow_parts))],
        },
    )  # fmt: skip


def _contacts(frame: SensorFrame, head: Message) -> Message:
    assert frame.contacts is not None
    contacts = [_contact(c) for c in frame.contacts.contacts]
    n_found = frame.contacts.n_found
    return Message("ruffini_msgs/msg/ContactArray", {"header": head, "n_found": n_found, "contacts": contacts})


def _softness(s: Softness, head: Message) -> Message:
    return Message(
        "ruffini_msgs/msg/Softness",
        {
            "header": head, "validity": s.validity, "squeeze": s.squeeze, "n_frames": s.n_frames,
            "modulus": s.modulus_pa, "low": s.low_pa, "high": s.high_pa, "log_share": s.log_share,
            "log_share_sigma": s.log_sigma,
        },
    )  # fmt: skip


def messages_of(
    frame: SensorFrame, name: str, nodes: Array | None, stamp_ns: int, stamp_error_s: float
) -> Iterator[tuple[str, Message]]:
    """(name of its topic, message) for each part of the frame that came.

    Parameters
    ----------
    name : of the pad, for the frame_id.
    nodes : (n_y, n_x, 2) metres, places of the field's nodes; None: the sensor has no field.
    stamp_ns : middle of the exposure on the system clock; stamp_error_s : how far off that may be, NaN: not known.
    """
    head = header(stamp_ns, frame_id(name, frame))
    if frame.wrench is not None:
        yield "wrench", Message("geometry_msgs/msg/WrenchStamped", {"header": head, "wrench": _wrench(frame)})
        yield "measurement", _measurement(frame, head, stamp_error_s)
    if frame.field is not None and nodes is not None:
        yield "field", _cloud(frame.field, nodes, head)
    if frame.depth is not None:
        yield "depth", _picture(frame.depth.depth, head)
    if frame.contacts is not None:
        yield "contacts", _contacts(frame, head)
        if frame.contacts.softness is not None:
            yield "softness", _softness(frame.contacts.softness, head)
    if frame.learned is not None:
        yield "learned", _learned(frame.learned, head)
    if frame.residual is not None:
        yield "residual", _picture(frame.residual.residual, head)


def diagnostics(stamp_ns: int, serial: str, level: int, problems: Sequence[str], values: dict[str, str]) -> Message:
    """How the sensor fares, for /diagnostics; `problems` in words, none: well."""
    pairs = [Message("diagnostic_msgs/msg/KeyValue", {"key": k, "value": v}) for k, v in values.items()]
    status = Message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        {
            "level": level, "name": f"{ros_name(serial)}: sensor", "message": "; ".join(problems) or "well",
            "hardware_id": serial, "values": pairs,
        },
    )  # fmt: skip
    return Message("diagnostic_msgs/msg/DiagnosticArray", {"header": header(stamp_ns, ""), "status": [status]})
