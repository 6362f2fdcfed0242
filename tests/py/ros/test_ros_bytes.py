"""Type hashes and bytes of every published message, by implementations of their own: rosbags, which makes them for the
bridge, takes no part here.

Hashes: REP 2016's RIHS01 as rosidl makes it, SHA-256 of the type description as JSON without default values. Bytes: CDR
little endian, each number at a multiple of its size behind the head of four bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import struct
from typing import Any

import pytest
from made_frames import NODES, frame
from test_ros_messages import KNOWN_HASHES

from ruffini.record.ros_types import point_cloud
from ruffini.ros.cdr import SOURCES, Types
from ruffini.ros.messages import DIAGNOSTICS, TOPICS, Message, diagnostics, messages_of

# ---- hashes --------------------------------------------------------------------------------------

STANDARD = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/String": "string data",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Wrench": "Vector3 force\nVector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\nWrench wrench",
    "sensor_msgs/PointField": "uint8 FLOAT32=7\nstring name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/PointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\n"
    "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense",
    "sensor_msgs/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
    "uint32 step\nuint8[] data",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": "byte OK=0\nbyte level\nstring name\nstring message\nstring hardware_id\n"
    "KeyValue[] values",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status",
}
OURS = {f"ruffini_msgs/{path.stem}": path.read_text() for path in SOURCES.glob("msg/*.msg")}
# FieldType.msg of type_description_interfaces.
NESTED, FIXED_ARRAY, ANY_NUMBER = 1, 48, 144
NUMBERS = {"int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
           "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17}  # fmt: skip
OWN_HASHES = {
    "ruffini_msgs/msg/Contact": "RIHS01_073d7c766bfb917993f2b18d5e4d3777ffd576c906691e26d4215c6180d35c1d",
    "ruffini_msgs/msg/ContactArray": "RIHS01_8422e003f6c775cc991df8176c517f21de31dbb446c05759efc1d75be625373b",
    "ruffini_msgs/msg/ContactModel": "RIHS01_bd0d92da6401fd6d6d3ed1ff28eb2d81eefb824a8e89ae03728c4ee52f6fd961",
    "ruffini_msgs/msg/FlowParts": "RIHS01_8d505b15bb954cb9aa0faf43304ffcb15ae8777923ae7d3b6ee91189033e2ced",
    "ruffini_msgs/msg/Learned": "RIHS01_ce5d9110c518f55ab43e5737c7731ade31e7debd0491b545da348c9350906722",
    "ruffini_msgs/msg/Measurement": "RIHS01_3a455b4fc51b05eee1c989521632530b736f17da2e3f29711ed712af78393842",
    "ruffini_msgs/msg/SkinTouch": "RIHS01_25d4fea3fb09df34fdb042c0e637576ee5f6f9bccf2f0bdd3b1ee895141bfef6",
    "ruffini_msgs/msg/Softness": "RIHS01_f3a07e5f0aaa1cd37b1f5f60cdebcd437686bac9c32d793cd6d371a7e5dd426d",
    "ruffini_msgs/msg/ToolTouch": "RIHS01_92fa2b2785e093a395c1eece7c986fe01cc487356460a6a2bfb9576c31ec2d39",
}


def described(name: str, found: dict[str, Any]) -> None:
    """Put the IndividualTypeDescription of `name` and of all that it holds into `found`."""
    fields: list[dict[str, Any]] = []
    package = name.split("/")[0]
    full = f"{package}/msg/{name.split('/')[1]}"
    found[full] = {"type_name": full, "fields": fields}
    for line in {**STANDARD, **OURS}[name].splitlines():
        words = line.partition("#")[0].split()
        if not words or "=" in line.partition("#")[0]:  # constants do not count
            continue
        kind, brackets, number = re.fullmatch(r"([\w/]+)(\[(\d*)\])?", words[0]).groups()  # type: ignore[union-attr]
        nested = "" if kind in NUMBERS else kind if "/" in kind else f"{package}/{kind}"
        type_id = NUMBERS.get(kind, NESTED) + (0 if not brackets else FIXED_ARRAY if number else ANY_NUMBER)
        fields.append({"name": words[1], "type": {
            "type_id": type_id, "capacity": int(number or 0), "string_capacity": 0,
            "nested_type_name": nested.replace("/", "/msg/"),
        }})  # fmt: skip
        if nested:
            described(nested, found)


def rihs01(type_: str) -> str:
    found: dict[str, Any] = {}
    described(type_.replace("/msg/", "/"), found)
    own = found.pop(type_)
    whole = {"type_description": own, "referenced_type_descriptions": [found[name] for name in sorted(found)]}
    return "RIHS01_" + hashlib.sha256(json.dumps(whole).encode()).hexdigest()


@pytest.mark.parametrize(("type_", "hash_"), [*KNOWN_HASHES.items(), *OWN_HASHES.items()])
def test_a_hash_is_what_ros_computes(type_: str, hash_: str) -> None:
    assert rihs01(type_) == hash_
    assert Types().hash(type_) == hash_


def test_every_published_type_has_its_hash_here() -> None:
    assert {topic.type for topic in (*TOPICS, DIAGNOSTICS)} <= KNOWN_HASHES.keys() | OWN_HASHES.keys()
    assert {f"ruffini_msgs/msg/{path.stem}" for path in SOURCES.glob("msg/*.msg")} == OWN_HASHES.keys()


# ---- bytes ---------------------------------------------------------------------------------------

STAMP_NS, SECONDS, NANOSECONDS = 1_700_000_000_123_456_789, 1_700_000_000, 123_456_789
NAN = math.nan
# So that what comes behind the frame_id stands at each of the eight remainders.
NAMES = ["ruffini_" + "7" * n for n in range(1, 9)]


def laid(*parts: Any) -> bytes:
    """A letter of struct and the numbers behind it, each at a multiple of its size; texts; octets."""
    body, kind = b"", ""
    for part in parts:
        if isinstance(part, tuple):
            kind, *numbers = part
            size = struct.calcsize(kind)
            for number in numbers:
                body += b"\0" * (-len(body) % size) + struct.pack("<" + kind, number)
        else:
            data = part.encode() + b"\0" if isinstance(part, str) else part
            body += b"\0" * (-len(body) % 4) + struct.pack("<I", len(data)) + data
    return b"\0\1\0\0" + body


def test_the_layout_itself() -> None:
    want = "00010000 07000000 0300000061620001 01000000 000000000000f03f 0200 0000 02000000 fffe"
    assert laid(("B", 7), "ab", ("B", 1), ("B", 1), ("d", 1.0), ("H", 2), b"\xff\xfe") == bytes.fromhex(want)


def sent(name: str, **changes: object) -> dict[str, Message]:
    return dict(messages_of(frame(**changes), name, NODES, STAMP_NS, 2e-5))  # type: ignore[arg-type]


def head(name: str) -> tuple[Any, ...]:
    return ("i", SECONDS), ("I", NANOSECONDS), f"simulated_{name}_pad"


FORCES = (1e-3, -2e-3, -3e-3, 4e-6, 5e-6, 6e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_wrench(name: str) -> None:
    message = sent(name)["wrench"]
    numbers = [v for part in message.fields["wrench"].fields.values() for v in part.fields.values()]
    assert numbers == pytest.approx(FORCES)
    assert Types().encode(message) == laid(*head(name), ("d", *numbers))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("flags", "names"), [(0, []), (1024, ["FLAG_LIGHT"])])
def test_a_measurement(name: str, flags: int, names: list[str]) -> None:
    message = sent(name, flags=flags, validity=(1, 1, 3, 1, 0, 2))["measurement"]
    covariance = message.fields["covariance"].tolist()
    force, torque = message.fields["wrench"].fields.values()
    assert [force.fields["x"], force.fields["y"], torque.fields["x"]] == pytest.approx([1e-3, -2e-3, 4e-6])
    want = laid(
        *head(name), ("d", 2e-5), ("Q", 420, 7_000_000), ("I", flags), ("I", len(names)), *names,
        ("B", 1, 0),  # simulated, replay
        ("B", 1, 1, 3, 1, 0, 2),  # six octets without their number
        ("d", force.fields["x"], force.fields["y"], NAN, torque.fields["x"], NAN, NAN), ("d", *covariance),
        ("B", 1), ("d", NAN),  # of the covariance; of the depth none is stated
    )  # fmt: skip
    assert len(covariance) == 36
    assert Types().encode(message) == want


@pytest.mark.parametrize("name", NAMES)
def test_a_field(name: str) -> None:
    message = sent(name)["field"]
    columns = ["x", "y", "z", "fx", "fy", "fz", "ux", "uy", "uz", "slip"]
    fields = [part for i, c in enumerate(columns) for part in (c, ("I", 4 * i), ("B", 7), ("I", 1))]
    points = message.fields["data"]
    assert len(points) == 2 * 3 * 40
    want = laid(
        *head(name), ("I", 2, 3), ("I", 10), *fields, ("B", 0), ("I", 40, 120), points, ("B", 1),
    )  # fmt: skip
    assert Types().encode(message) == want


@pytest.mark.parametrize("name", NAMES)
def test_a_field_in_a_recording(name: str) -> None:
    """`ruffini record` writes it without rosbags."""
    field = frame().field
    assert field is not None
    rest = [(x, y, 0.0) for y in (0, 2e-3) for x in (-1e-3, 0.0, 1e-3)]
    step = range(-9, 9)  # of 0.1 um and of 10 uN, node by node
    numbers = [
        n for i, place in enumerate(rest) for s in (step[3 * i : 3 * i + 3],)
        for n in (*(p + 1e-7 * k for p, k in zip(place, s, strict=True)), *(1e-5 * k for k in s))
    ]  # fmt: skip
    columns = ("x", "y", "z", "fx", "fy", "fz")
    fields = [part for i, c in enumerate(columns) for part in (c, ("I", 4 * i), ("B", 7), ("I", 1))]
    got = point_cloud(field, NODES, STAMP_NS, f"simulated_{name}_pad")
    points = got[-145:-1]
    assert struct.unpack("<36f", points) == pytest.approx(numbers, abs=1e-9)
    assert got == laid(*head(name), ("I", 2, 3), ("I", 6), *fields, ("B", 0), ("I", 24, 72), points, ("B", 1))


@pytest.mark.parametrize("name", NAMES)
def test_a_depth(name: str) -> None:
    pixels = struct.pack("<12f", *(1e-6 * -i for i in range(12)))
    message = sent(name)["depth"]
    assert Types().encode(message) == laid(*head(name), ("I", 3, 4), "32FC1", ("B", 0), ("I", 16), pixels)


@pytest.mark.parametrize("name", NAMES)
def test_contacts(name: str) -> None:
    message = sent(name)["contacts"]
    (contact,) = message.fields["contacts"]
    place = (1e-4, -2e-4, 0.0)
    force, area, depth = contact.fields["force"].fields.values(), contact.fields["area"], contact.fields["peak_depth"]
    share = [contact.fields[k] for k in ("friction", "friction_sigma", "slip_share", "slip_margin")]
    assert list(contact.fields["position"].fields.values()) == pytest.approx(place)
    assert [*force, area, depth] == pytest.approx([0, 0, -3e-3, 5e-9 * 1000, -5e-5])
    want = laid(
        *head(name), ("I", 9), ("I", 1),
        ("I", 3), ("d", *contact.fields["position"].fields.values()), ("d", *force), ("d", area, depth), ("B", 2),
        ("d", contact.fields["shear_ratio"], *share), ("B", 1), *parts_of(contact),
    )  # fmt: skip
    assert contact.fields["shear_ratio"] == pytest.approx(0.35)
    assert Types().encode(message) == want


def parts_of(contact: Message) -> list[Any]:
    """Skin, tool, model and flow, one each, in the order of their definitions; numbers against `made_frames.parts`."""
    skin, tool, model, flow = ([float(v) for v in numbers(contact.fields[part][0])]
                               for part in ("skin", "tool", "model", "flow_parts"))  # fmt: skip
    micro = [1e-6 * v for v in (1, 2, 3, 4, 5, 6, 7, 8)]
    assert skin == pytest.approx(micro)
    assert tool == pytest.approx([*(1e-6 * v for v in (11, 12, 13, 14, 15, 16, 17, 18)), 28e-9,
                                  *(1e-6 * v for v in (21, 22, 23, 24, 25, 26)), 27e-9, 29e-9])  # fmt: skip
    assert model == pytest.approx([2, 0.87, 31e-6, 33e-6, 32e-6, 34e-9, 1, -35e6, 36, 3.7, 1, 38e-6, 39e-9])
    assert flow == pytest.approx([41e-9, 42e-9, -43e-6])
    kind, confidence, *depths, of_depth, stiffness, shore, shore_sigma, of_hardness, mean_flow, moment = model
    return [
        ("I", 1), ("d", *skin), ("I", 1), ("d", *tool),
        ("I", 1), ("B", int(kind)), ("d", confidence, *depths), ("B", int(of_depth)),
        ("d", stiffness, shore, shore_sigma), ("B", int(of_hardness)), ("d", mean_flow, moment), ("I", 1), ("d", *flow),
    ]  # fmt: skip


def numbers(message: Message) -> list[Any]:
    """All numbers of a message in their order."""
    found: list[Any] = []
    for value in message.fields.values():
        found += numbers(value) if isinstance(value, Message) else [value]
    return found


@pytest.mark.parametrize("name", NAMES)
def test_learned(name: str) -> None:
    want = laid(
        *head(name), ("Q", 419), ("I", 2), "force_un", "roll_urad", ("I", 2), ("q", 4, -5), ("B", 1),
        ("d", 0.01, 0.02, 30.0),
    )  # fmt: skip
    assert Types().encode(sent(name)["learned"]) == want


@pytest.mark.parametrize("name", NAMES)
def test_a_residual(name: str) -> None:
    pixels = struct.pack("<18f", *(0.015625 * (i - 9) for i in range(18)))
    message = sent(name)["residual"]
    assert Types().encode(message) == laid(*head(name), ("I", 2, 3), "32FC3", ("B", 0), ("I", 36), pixels)


@pytest.mark.parametrize("words", [["a"], ["late", "too warm"], ["0123456"]])
def test_diagnostics(words: list[str]) -> None:
    message = diagnostics(STAMP_NS, "00-1", 2, words, {"frame rate": "60.0 Hz", "k": "v"})
    want = laid(
        ("i", SECONDS), ("I", NANOSECONDS), "", ("I", 1),
        ("B", 2), "ruffini_00_1: sensor", "; ".join(words), "00-1", ("I", 2), "frame rate", "60.0 Hz", "k", "v",
    )  # fmt: skip
    assert Types().encode(message) == want
