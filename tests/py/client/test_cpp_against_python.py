"""The C++ consumer beside the host's own decoder: made-up messages with every field, and those spoilt.

Whole messages: every number is the same. Spoilt ones: every number of what both take is the same. C++ refuses more: a
field of another wire type, groups, more contacts than a device sends. It also takes some that Python refuses: it does
not look into texts and into messages within that it does not read.
"""

from __future__ import annotations

import ctypes
import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import DecodeError

from ruffini.device.results import KNOWN_FLAGS, VALID, Contacts, Depth, Field, Markers, Residual, Wrench
from ruffini.errors import InputError
from ruffini.native import native_folder
from ruffini.wire import Schema
from ruffini.wire.dense import decode_dense, encode_dense

SCHEMA = Schema.own()
CAPACITY = 1 << 16
MADE = ("Hello", "Status", "Wrench", "Field", "Depth", "Contacts", "Event", "Reply", "Time", "Residual", "Markers",
        "Learned")  # fmt: skip


@pytest.fixture(scope="module")
def door() -> Any:
    path = native_folder() / "libruffini_client_door.so"
    library = ctypes.CDLL(str(path))
    library.ruffini_client_says.restype = ctypes.c_int64
    return library


def cpp(door: Any, name: str, payload: bytes) -> list[float] | None:
    out = (ctypes.c_double * CAPACITY)()
    number = SCHEMA.type_numbers[name.upper()]
    n = door.ruffini_client_says(number, payload, ctypes.c_int64(len(payload)), out, ctypes.c_int64(CAPACITY))
    assert n >= -1, "too many numbers for this test"
    return None if n < 0 else list(out[:n])


# ---- what Python makes of the same ----------------------------------------------------------------


def judged(validity: int, flags: int) -> int:
    """As proto/README.md asks for: what is not known is invalid."""
    known = validity if 0 <= validity <= 3 else 3
    return 3 if known == VALID and flags & ~KNOWN_FLAGS else known


def measured(value: float, validity: int, flags: int) -> Iterator[float]:
    said = judged(validity, flags)
    yield from (value if said == VALID else math.nan, value, said)


def stamp(m: Any) -> list[float]:
    return [m.stamp.capture_us, m.stamp.frame, m.stamp.flags, m.stamp.calibration_id]


def grid(m: Any, part: str) -> list[float]:
    if not m.HasField(part):
        return [0, 0]
    d = getattr(m, part)
    values = decode_dense(d.codec, d.n_x, d.n_y, d.n_components, d.data)
    return [d.n_x, d.n_y, *values.ravel().tolist()]


def of_wrench(m: Any) -> list[float]:
    w, flags = Wrench.from_message(m), m.stamp.flags
    sent = [m.force_x_un, m.force_y_un, m.force_z_un, m.torque_x_un_um, m.torque_y_un_um, m.torque_z_un_um]
    validity = list(m.validity) or [0] * 6
    out = stamp(m)
    for i, (value, v) in enumerate(zip(sent, validity, strict=True)):
        out += measured(value * (1e-6 if i < 3 else 1e-12), v, flags)
    is_sure = judged(m.covariance_validity, flags) == VALID and w.covariance is not None
    return out + (w.covariance.ravel().tolist() if is_sure and w.covariance is not None else [])


def of_field(m: Any) -> list[float]:
    f = Field.from_message(m)  # refuses parts that do not fit each other
    validity = [judged(v, m.stamp.flags) for v in m.validity] or [0, 0, 0]
    grids = [v for part in ("force", "displacement", "slip", "sigma") for v in grid(m, part)]
    steps = [f.force_lsb_n, m.displacement_lsb_nm * 1e-9]
    return [*stamp(m), *steps, judged(m.sigma_validity, m.stamp.flags), *validity, *grids]


def of_depth(m: Any) -> list[float]:
    d = Depth.from_message(m)
    step_m, sigma_m = m.depth_lsb_nm * 1e-9, d.sigma or 0.0
    return [*stamp(m), step_m, m.step_px, sigma_m, judged(m.validity, m.stamp.flags), *grid(m, "depth")]


def of_residual(m: Any) -> list[float]:
    r = Residual.from_message(m)
    step = m.residual_lsb_1e6 * 1e-6
    first = r.residual.reshape(-1, 3)[:1].ravel().tolist()
    return [*stamp(m), step, judged(r.validity, m.stamp.flags), *first, *grid(m, "residual")]


def of_markers(m: Any) -> list[float]:
    markers = Markers.from_message(m)
    rest, quality, area = ([] if not m.HasField(name) or not getattr(m, name).n_x else [name]
                           for name in ("rest", "quality", "area"))  # fmt: skip
    grids = [v for name in ["displacement", "rest", "quality", "area"] for v in grid(m, name)]
    assert all((part is None) != bool(there) for part, there in
               ((markers.rest_px, rest), (markers.quality, quality), (markers.area_px2, area)))  # fmt: skip
    return [*stamp(m), m.position_lsb_upx * 1e-6, *grids, *markers.is_lost.ravel().tolist()]


def of_learned(m: Any) -> list[float]:
    is_valid = judged(m.validity, m.stamp.flags) == VALID
    quantities = [v for q in m.quantities for v in (*q.name.encode(), q.value)]
    return [*stamp(m), is_valid, *quantities, m.took_us * 1e-6, m.latency_us * 1e-6, m.period_us * 1e-6]


def numbers(part: Any) -> list[Any]:
    """Of a dataclass, those of a tuple one after the other."""
    out: list[Any] = []
    for value in () if part is None else astuple(part):
        out += value if isinstance(value, tuple) else [value]
    return out


def plain(values: Iterable[float | None]) -> list[float]:
    return [math.nan if v is None else v for v in values]


def of_contacts(m: Any) -> list[float]:
    out, flags = [*stamp(m), m.n_found], m.stamp.flags
    for sent, c in zip(m.contacts, Contacts.from_message(m).contacts, strict=True):
        out += [c.id, c.area, *c.center]
        for force, v in zip(c.raw_force, c.force_validity or (c.validity,) * 3, strict=True):
            out += measured(force, v, flags)
        out += measured(c.peak_depth, c.validity, flags)
        told = [c.shear_ratio, c.slip_share, c.friction, c.friction_sigma, c.slip_margin_n]
        out += [sent.slip.slip_state if c.slip_state else 0, *plain(told), c.reaches_border]
        out += [*plain(numbers(c.skin)), *plain(numbers(c.tool))]
        if c.model is not None:
            row = list(astuple(c.model))
            row[0] = {"planar": 1, "hertzian": 2}.get(row[0], 0)
            for at in (6, 10):
                row[at] = judged(row[at], flags)
            out += plain(row)
        out += plain(numbers(c.flow_parts))
    if (softness := Contacts.from_message(m).softness) is not None:
        out += [*numbers(softness)[:-1], judged(softness.validity, flags)]
    return out


def of_hello(m: Any) -> list[float]:
    out = [m.session_id, m.needs_key]
    for s in m.sensors:
        places = (s.grid_origin_x_nm, s.grid_origin_y_nm, s.grid_step_x_nm, s.grid_step_y_nm)
        c = s.calibration
        out += [s.sensor, s.grid_n_x, s.grid_n_y, *(v * 1e-9 for v in places)]
        out += [c.present, c.development_key, c.on_trial, *c.summary.encode()]
    return out


def of_status(m: Any) -> list[float]:
    lost = (m.drops.capture_overrun, m.drops.invalid_frame, m.drops.link_backpressure)
    warmth = [t.milli_celsius * 1e-3 for t in m.temperatures]
    return [m.uptime_us, m.frame_rate_mhz * 1e-3, *lost, m.health, *warmth]


PYTHON = {
    "Wrench": of_wrench, "Field": of_field, "Depth": of_depth, "Contacts": of_contacts, "Hello": of_hello,
    "Status": of_status, "Event": lambda m: [m.time_us, m.severity], "Reply": lambda m: [m.request_id, m.code],
    "Time": lambda m: [m.token, m.received_us, m.sent_us], "Residual": of_residual,
    "Markers": of_markers, "Learned": of_learned,
}  # fmt: skip


def python(name: str, payload: bytes) -> list[float] | None:
    message = SCHEMA.new(name)
    try:
        message.ParseFromString(payload)
        return [float(v) for v in PYTHON[name](message)]
    except (DecodeError, InputError):
        return None


# ---- made-up messages -----------------------------------------------------------------------------


def random_dense(chance: random.Random, n_x: int, n_y: int, n_components: int) -> dict[str, Any]:
    spread = chance.choice((1, 40, 2000, 1 << 20))
    values = np.array([chance.randint(-spread, spread) for _ in range(n_x * n_y * n_components)])
    values[: chance.randrange(len(values) + 1)] = 0
    codec, data = encode_dense(values.reshape(n_y, n_x, n_components), n_components)
    return {"codec": codec, "n_x": n_x, "n_y": n_y, "n_components": n_components, "data": data}


def random_message(chance: random.Random, name: str) -> Any:
    """Every field is drawn, numbers over their whole range; grids fit each other."""
    if name in ("Field", "Depth", "Residual", "Markers"):
        n_x, n_y = chance.randint(1, 9), chance.randint(1, 9)
        header = {"stamp": {"capture_us": chance.getrandbits(50), "flags": chance.getrandbits(18), "frame": 7}}
        validity = [chance.randrange(4) for _ in range(3)]
        if name == "Depth":
            return SCHEMA.new(name, **header, depth_lsb_nm=chance.randrange(1, 9000), step_px=2, sigma_um=3,
                              validity=validity[0], depth=random_dense(chance, n_x, n_y, 1))  # fmt: skip
        if name == "Markers":
            parts = {part: random_dense(chance, n_x, n_y, 2 if part == "rest" else 1)
                     for part in ("rest", "quality", "area") if chance.randrange(2)}  # fmt: skip
            return SCHEMA.new(name, **header, n_x=n_x, n_y=n_y, position_lsb_upx=1000, lost=chance.randbytes(11),
                              displacement=random_dense(chance, n_x, n_y, 2), **parts)  # fmt: skip
        if name == "Residual":
            part = {"residual": random_dense(chance, n_x, n_y, 3)} if chance.randrange(4) else {}
            return SCHEMA.new(name, **header, residual_lsb_1e6=15_625, validity=validity[0], **part)
        parts = {part: random_dense(chance, n_x, n_y, 1 if part == "slip" else 3)
                 for part in ("displacement", "slip", "sigma") if chance.randrange(3)}  # fmt: skip
        parts["force"] = random_dense(chance, n_x, n_y, 3)
        return SCHEMA.new(name, **header, force_lsb_un=chance.randrange(1, 50), displacement_lsb_nm=25,
                          validity=validity, sigma_validity=1, **parts)  # fmt: skip
    message = SCHEMA.new(name)
    fill(chance, message)
    if name == "Wrench":
        message.validity[:] = [chance.randrange(5) for _ in range(6)]
        message.covariance[:] = [chance.randint(-(1 << 40), 1 << 40) for _ in range(21)]
        message.stamp.flags &= KNOWN_FLAGS if chance.randrange(4) else 0xFFFFFFFF
    for contact in getattr(message, "contacts", ()):
        contact.force_validity[:] = [1, 2, 3] if chance.randrange(2) else []
        contact.slip.slip_state = chance.randrange(5)
        contact.validity = chance.choice((1, 1, contact.validity))
        for part in ("skin", "tool", "model", "helmholtz", "slip"):
            if chance.randrange(3) == 0:
                contact.ClearField(part)
        for part, lists in (
            ("skin", {"place_um": 3, "normal_force_un": 3}),
            ("tool", {"tool_um": 3, "turn_urad": 2, "normal_force_un": 3, "tool_sigma": 7}),
        ):
            for name, n in lists.items() if contact.HasField(part) else ():
                low = 0 if name == "tool_sigma" else -(1 << 30)
                getattr(getattr(contact, part), name)[:] = [chance.randint(low, 1 << 30) for _ in range(n)]
    return message


def fill(chance: random.Random, message: Any) -> None:
    for field in message.DESCRIPTOR.fields:
        if field.is_repeated if hasattr(field, "is_repeated") else field.label == field.LABEL_REPEATED:
            if field.message_type is not None and field.name != "stage_times":
                for _ in range(chance.randrange(3)):
                    fill(chance, getattr(message, field.name).add())
        elif field.message_type is not None:
            fill(chance, getattr(message, field.name))
        elif field.cpp_type == field.CPPTYPE_STRING:
            setattr(message, field.name, "abc" if field.type == field.TYPE_STRING else b"abc")
        elif field.cpp_type == field.CPPTYPE_ENUM:
            setattr(message, field.name, chance.randrange(4))
        else:
            bits = 52 if field.cpp_type in (field.CPPTYPE_INT64, field.CPPTYPE_UINT64) else 31  # a double holds 53
            is_signed = field.cpp_type in (field.CPPTYPE_INT32, field.CPPTYPE_INT64)
            value = chance.getrandbits(chance.randrange(1, bits))
            setattr(message, field.name, -value if is_signed and chance.randrange(2) else bool(value) if
                    field.cpp_type == field.CPPTYPE_BOOL else value)  # fmt: skip


def spoilt(chance: random.Random, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(1 + chance.randrange(3)):
        at = chance.randrange(len(out) + 1)
        match chance.randrange(4):
            case 0 if out:
                out[at % len(out)] ^= 1 << chance.randrange(8)
            case 1:
                out[at:at] = chance.randbytes(1 + chance.randrange(2))
            case 2:
                del out[at : at + 1 + chance.randrange(3)]
            case _:
                out += out[at : at + 40]
    return bytes(out)


def same(a: list[float], b: list[float]) -> bool:
    return len(a) == len(b) and np.allclose(a, b, rtol=1e-12, atol=0, equal_nan=True)


def test_whole_messages_are_read_alike(door: Any) -> None:
    chance = random.Random(1)
    for i in range(1_800):
        name = MADE[i % len(MADE)]
        payload = random_message(chance, name).SerializeToString()
        ours, theirs = cpp(door, name, payload), python(name, payload)
        assert ours is not None, f"{name} {payload.hex()}"
        assert theirs is not None
        assert same(ours, theirs), f"{name} {payload.hex()}: {ours} {theirs}"


def test_what_both_take_of_spoilt_messages_is_the_same(door: Any) -> None:
    chance, seen = random.Random(2), Counter[str]()
    for i in range(9_000):
        name = MADE[i % len(MADE)]
        payload = spoilt(chance, random_message(chance, name).SerializeToString())[:4_048]
        ours, theirs = cpp(door, name, payload), python(name, payload)
        seen["both" if ours and theirs else "C++ alone" if ours else "Python alone" if theirs else "none"] += 1
        if ours is not None and theirs is not None:
            assert same(ours, theirs), f"{name} {payload.hex()}: {ours} {theirs}"
    assert seen["both"] > 1_000
    assert seen["none"] > 1_000
    assert seen["C++ alone"] < 500
