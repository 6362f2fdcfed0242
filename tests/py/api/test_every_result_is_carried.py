"""Each field of each result in ruffini.proto reaches every consumer: changed alone, it changes what the consumer has.

What a consumer leaves out on purpose is listed with the reason. The page's table is in tests/page/carried.test.ts; the
LeRobot plug-in hands on the whole SensorFrame (`Touch.results`).
"""

from __future__ import annotations

import ctypes
import types
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
from made_frames import FORCE, N_X, N_Y, NODES, SCHEMA, dense, parts

from ruffini.api.frame import SensorFrame
from ruffini.device.results import RESULTS
from ruffini.native import native_folder
from ruffini.record import export
from ruffini.ros.messages import messages_of
from ruffini.view.rerun_sink import RerunSink
from ruffini.wire.dense import decode_dense

RESULT_NAMES = ("WRENCH", "FIELD", "RESIDUAL", "DEPTH", "CONTACTS", "MARKERS", "LEARNED", "IMAGE")
ID = "which calibration file, no result: HELLO and STATUS name the one in force"
PICTURE = "the camera's picture is for the eye: record it, or take it from the Python API"
TRACKING = "places in the picture, before they are a result: recorded, and in the Python API"
LEFT_OUT: dict[str, dict[str, str]] = {
    "python": {"stamp.calibration_id": ID, "IMAGE.format": "only BGR8 is sent"},
    "ros": {
        "stamp.calibration_id": ID, "IMAGE": PICTURE, "MARKERS": TRACKING,
        "DEPTH.step_px": "the width of the camera's picture over that of this one",
    },
    "export": {
        "stamp.calibration_id": ID, "IMAGE": PICTURE,
        "DEPTH.step_px": "the width of the camera's picture over that of this one",
    },
    "rerun": {
        "stamp.calibration_id": ID, "IMAGE.format": "only BGR8 is sent", "IMAGE.step_px": "drawn as it is",
        "DEPTH.step_px": "drawn as it is", "WRENCH.stamp.capture_us": "the timeline has the host's time of it",
    },
    "cpp": {"IMAGE": PICTURE},
}  # fmt: skip


def base() -> dict[str, Any]:
    """Every field is set, every validity VALID, every number another one."""
    stamp = {"capture_us": 7_000_000, "frame": 420, "flags": 1024, "calibration_id": 3}
    upper = [90, 1, 2, 3, 4, 5, 91, 6, 7, 8, 9, 92, 10, 11, 12, 93, 13, 14, 94, 15, 95]
    node = dense(np.full((N_Y, N_X, 1), 1))
    slip = {"slip_state": 2, "shear_ratio_1e3": 350, "friction_1e3": 500, "friction_sigma_1e3": 100,
            "slip_share_1e3": 620, "slip_margin_un": 25_000}  # fmt: skip
    contact = {"id": 3, "area_um2_k": 5000, "center_x_um": 100, "center_y_um": -200, "force_x_un": 30,
               "force_y_un": 40, "force_z_un": -3000, "peak_depth_nm": -50_000, "validity": 1, "reaches_border": True,
               "force_validity": [1, 1, 1], "slip": slip, **parts(1)}  # fmt: skip
    softness = {"validity": 1, "squeeze": 3, "n_frames": 12, "modulus_pa": 60_000, "low_pa": 40_000, "high_pa": 90_000,
                "log_share_q16": -70_000, "log_sigma_q16": 9_000}  # fmt: skip
    pair = dense(FORCE[..., :2])
    quantity = {"name": "force_un", "value": -5}
    return {
        "WRENCH": SCHEMA.new("Wrench", stamp=stamp, force_x_un=1000, force_y_un=-2000, force_z_un=-3000,
                             torque_x_un_um=4_000_000, torque_y_un_um=5_000_000, torque_z_un_um=6_000_000,
                             validity=[1] * 6, covariance=upper, covariance_validity=1),
        "FIELD": SCHEMA.new("Field", stamp=stamp, force_lsb_un=10, force=dense(FORCE), displacement_lsb_nm=100,
                            displacement=dense(FORCE), validity=[1] * 3, slip=node, sigma=dense(abs(FORCE) + 1),
                            sigma_validity=1),
        "RESIDUAL": SCHEMA.new("Residual", stamp=stamp, residual_lsb_1e6=15_625, residual=dense(FORCE), validity=1),
        "DEPTH": SCHEMA.new("Depth", stamp=stamp, depth_lsb_nm=1000, step_px=2, validity=1, sigma_um=9,
                            depth=dense(-np.arange(12).reshape(3, 4, 1))),
        "CONTACTS": SCHEMA.new("Contacts", stamp=stamp, contacts=[contact], n_found=9, softness=softness),
        "MARKERS": SCHEMA.new("Markers", stamp=stamp, n_x=N_X, n_y=N_Y, position_lsb_upx=1000, displacement=pair,
                              lost=b"\5", rest=pair, quality=node, area=node),
        "LEARNED": SCHEMA.new("Learned", stamp=stamp, validity=1, quantities=[quantity], took_us=10, latency_us=20,
                              period_us=30_000),
        "IMAGE": SCHEMA.new("Image", stamp=stamp, format=1, width_px=2, height_px=1, step_px=4, data=b"abcdef"),
    }  # fmt: skip


SIZES = {"n_x", "n_y", "width_px", "height_px"}  # of an array beside them: they change only with it


def leaves(message: Any, path: str = "", *, is_stamped: bool = True) -> Iterator[tuple[str, Any, Any]]:
    """(path, message, field) of each field that holds no message; Dense counts as one.

    All messages of a frame have its stamp: that of WRENCH stands for all.
    """
    for field, value in message.ListFields():
        name = path + field.name
        if field.name == "stamp" and not is_stamped:
            continue
        if field.message_type is None:
            if field.name not in SIZES:
                yield name, message, field
        elif field.message_type.name == "Dense":
            yield name, message, field
        elif hasattr(value, "ListFields"):
            yield from leaves(value, name + ".")
        else:
            yield from leaves(value[0], name + ".")


def change(message: Any, field: Any) -> None:
    value = getattr(message, field.name)
    if field.message_type is not None:
        values = decode_dense(value.codec, value.n_x, value.n_y, value.n_components, value.data)
        values.flat[-1] += 1
        value.CopyFrom(dense(values))
    elif isinstance(value, bool):
        setattr(message, field.name, not value)
    elif isinstance(value, int):
        setattr(message, field.name, 3 if field.enum_type is not None and value == 1 else value + 1)
    elif isinstance(value, str):
        setattr(message, field.name, value + "x")
    elif isinstance(value, bytes):
        setattr(message, field.name, bytes([value[0] ^ 2]) + value[1:])
    else:
        value[0] = 3 if field.enum_type is not None else value[0] + 1


def frame_of(messages: dict[str, Any]) -> SensorFrame:
    stamp = messages["WRENCH"].stamp
    bits = 0
    for name, message in messages.items():
        bits |= 0 if name == "LEARNED" else message.stamp.flags
    learned = RESULTS["LEARNED"].from_message(messages["LEARNED"])
    on_time = {name: m for name, m in messages.items() if name != "LEARNED"}
    return SensorFrame("00-1", 0, stamp.frame, stamp.capture_us * 1e-6, 5_000_000_000, 20_000, bits,
                       tuple(SCHEMA.enum_names("FlagBit", bits)), True, False, on_time, learned)  # fmt: skip


def plain(value: Any) -> str:
    """All of a value as text."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.tolist()}"
    if is_dataclass(value):
        return plain({field.name: getattr(value, field.name) for field in fields(value)})
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {plain(part)}" for name, part in value.items()) + "}"
    if isinstance(value, types.SimpleNamespace):
        return plain(vars(value))
    return "[" + ", ".join(map(plain, value)) + "]" if isinstance(value, list | tuple) else repr(value)


def in_python(name: str, messages: dict[str, Any]) -> str:
    return plain(RESULTS[name].from_message(messages[name]))


def in_ros(_: str, messages: dict[str, Any]) -> str:
    return plain([(topic, m.fields) for topic, m in messages_of(frame_of(messages), "ruffini_1", NODES, 1, 2e-5)])


def in_export(_: str, messages: dict[str, Any]) -> str:
    recording: Any = types.SimpleNamespace(utc_ns=lambda _: 5)
    frame = frame_of(messages)
    return plain([export._row(recording, frame), [get(frame) for get in export.DENSE.values()]])


def in_rerun(_: str, messages: dict[str, Any]) -> str:
    logged: list[Any] = []
    any_kind: Any = types.SimpleNamespace()
    for kind in ("Arrows3D", "DepthImage", "Image", "Mesh3D", "Scalars", "SeriesLines", "Tensor", "TextLog"):
        setattr(any_kind, kind, lambda *values, **named: [list(values), named])
    any_kind.ViewCoordinates = types.SimpleNamespace(RDF="RDF")
    stream: Any = types.SimpleNamespace(
        set_time=lambda name, **at: logged.append([name, at] if name == "camera frame" else name),
        log=lambda path, entity, static=False: logged.append([path, entity]),
    )
    RerunSink(any_kind, stream, "ruffini_1", {0: NODES}, arrow_m_per_n=0.5).put(frame_of(messages))
    return plain(logged)


def in_cpp(name: str, messages: dict[str, Any]) -> str:
    door, out = ctypes.CDLL(str(native_folder() / "libruffini_client_door.so")), (ctypes.c_double * 4096)()
    door.ruffini_client_says.restype = ctypes.c_int64
    payload = messages[name].SerializeToString()
    n = door.ruffini_client_says(SCHEMA.type_numbers[name], payload, ctypes.c_int64(len(payload)), out,
                                 ctypes.c_int64(4096))  # fmt: skip
    assert n >= 0
    return repr(list(out[:n]))


CONSUMERS: dict[str, Callable[[str, dict[str, Any]], str]] = {
    "python": in_python, "ros": in_ros, "export": in_export, "rerun": in_rerun, "cpp": in_cpp,
}  # fmt: skip


def why_not(consumer: str, name: str, path: str) -> str | None:
    listed = LEFT_OUT[consumer]
    return listed.get(name) or listed.get(path) or listed.get(f"{name}.{path}")


def test_the_messages_of_this_test_set_every_field_of_the_schema() -> None:
    for name, message in base().items():
        todo = [message]
        while todo:
            one = todo.pop()
            unset = {f.name for f in one.DESCRIPTOR.fields} - {f.name for f, _ in one.ListFields()}
            assert unset <= ({"codec"} if one.DESCRIPTOR.name == "Dense" else set()), f"{name}: {unset}"
            for field, value in one.ListFields():
                if field.message_type is not None:
                    todo += [value] if hasattr(value, "ListFields") else list(value)


@pytest.mark.parametrize("consumer", CONSUMERS)
@pytest.mark.parametrize("name", RESULT_NAMES)
def test_every_field_reaches_the_consumer_or_is_listed(consumer: str, name: str) -> None:
    said = CONSUMERS[consumer]
    before = said(name, base())
    wrong = []
    for i, (path, _, _) in enumerate(list(leaves(base()[name], is_stamped=name == "WRENCH"))):
        messages = base()
        _, message, field = list(leaves(messages[name], is_stamped=name == "WRENCH"))[i]
        change(message, field)
        is_carried, reason = said(name, messages) != before, why_not(consumer, name, path)
        if is_carried == (reason is not None):
            wrong.append(f"{path}: {'carried, but listed as left out' if is_carried else 'is not carried'}")
    assert not wrong
