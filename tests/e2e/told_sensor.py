"""A sensor that only talks: HELLO of a real board on a pty, and made-up results of its kind, SIMULATED."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from hang import HANG_S

from ruffini.boards import Board
from ruffini.wire import Decoder, Schema, encode_message
from ruffini.wire.dense import encode_dense
from ruffini.wire.framing import SIMULATED

SCHEMA = Schema.own()
ANSWER_S = 0.02  # between two looks whether the test is over
Messages = dict[str, Any]
Teller = Callable[[int, Any], Messages]  # frame number and its stamp -> messages by type


def dense(values: npt.NDArray[np.int64], n_x: int, n_y: int, n_components: int) -> Any:
    """Node values as the device sends them."""
    codec, data = encode_dense(values, n_components)
    return SCHEMA.new("Dense", codec=codec, n_x=n_x, n_y=n_y, n_components=n_components, data=data)


def info_of(board: Board, sensor: int = 0, grid: tuple[int, int] | None = None) -> Any:
    """A SensorInfo of a board with `grid` nodes, all over its pad."""
    n_x, n_y = grid or (board.grid.n_x, board.grid.n_y)
    pad = board.pad
    return SCHEMA.new(
        "SensorInfo", sensor=sensor, board=board.name, product=board.board.product, grid_n_x=n_x, grid_n_y=n_y,
        image_width_px=board.camera.width_px, image_height_px=board.camera.height_px,
        grid_origin_x_nm=-500 * pad.size_x_um, grid_origin_y_nm=-500 * pad.size_y_um,
        grid_step_x_nm=1000 * pad.size_x_um // (n_x - 1), grid_step_y_nm=1000 * pad.size_y_um // (n_y - 1),
        stages=board.pipeline.stages, not_measured=board.board.not_measured, board_toml=board.text,
        calibration={"present": True, "kinds": ["operator"], "created_utc": "2026-01-01T00:00:00Z"},
    )  # fmt: skip


class ToldSensor:
    """The device's end of a pty; `with` makes it answer. It sends all, whatever is subscribed to.

    Parameters
    ----------
    rate_hz : frames a second, once something is subscribed to; None: only those of `send`.
    """

    def __init__(self, infos: list[Any], tell: Teller, *, rate_hz: float | None = 30.0, schema: bytes | None = None,
                 serial: str = "told") -> None:  # fmt: skip
        self._hello = SCHEMA.new("Hello", protocol_version=1, firmware_version="0.1.0", device_serial=serial,
                                 session_id=1, sensors=infos)  # fmt: skip
        self._schema = Schema(schema) if schema is not None else SCHEMA
        self._hello.schema_sha256 = self._schema.sha256
        self._sensors = [info.sensor for info in infos]
        self._tell, self._period_s = tell, 1 / rate_hz if rate_hz is not None else None
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self.slave)
        self.n_frames, self.stop_after = 0, 0  # frames until it falls silent; 0: never
        self.commands: list[Any] = []
        self._sequence = dict.fromkeys([*self._sensors, 255], 0)
        self.subscribed = threading.Event()
        self._stop, self._one_writes = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._talk, daemon=True)

    def __enter__(self) -> ToldSensor:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self.master)
        os.close(self.slave)

    def send(self, n: int = 1) -> int:
        """Send the next frames as soon as something is subscribed to; returns the number of the last."""
        assert self.subscribed.wait(HANG_S), "hangs: nothing is subscribed to"
        for _ in range(n):
            self._send_frame()
        return self.n_frames - 1

    def _talk(self) -> None:
        decoder, next_s = Decoder(from_host=True), time.monotonic()
        while not self._stop.is_set():
            wait_s = ANSWER_S if self._period_s is None else max(next_s - time.monotonic(), 0)
            if select.select([self.master], [], [], wait_s)[0]:
                with contextlib.suppress(OSError):
                    for frame in decoder.feed(os.read(self.master, 65_536)):
                        self._answer(frame)
            if self._period_s is not None and time.monotonic() >= next_s:
                next_s = max(next_s + self._period_s, time.monotonic() - 1)
                if self.subscribed.is_set():
                    self._send_frame()
                if self.stop_after and self.n_frames == self.stop_after:
                    return

    def _answer(self, frame: Any) -> None:
        name = SCHEMA.type_name(frame.type)
        if name == "HELLO":
            self._send("HELLO", self._hello, 255)
        elif name == "SCHEMA":
            said = SCHEMA.new("Schema", file_descriptor_set=self._schema.bytes, sha256=self._schema.sha256)
            self._send("SCHEMA", said, 255)
        elif name == "COMMAND":
            command: Any = SCHEMA.decode(frame.type, frame.payload)
            self.commands.append(command)
            self._send("REPLY", SCHEMA.new("Reply", request_id=command.request_id, text="done"), 255)
            if command.WhichOneof("action") == "subscribe":
                is_any = any(s.every for s in command.subscribe.subscriptions)
                (self.subscribed.set if is_any else self.subscribed.clear)()

    def _send_frame(self) -> None:
        for sensor in self._sensors:
            stamp = SCHEMA.new("Stamp", capture_us=int(time.monotonic() * 1e6), frame=self.n_frames, calibration_id=1)
            for name, message in self._tell(self.n_frames, stamp).items():
                self._send(name, message, sensor)
        self.n_frames += 1

    def _send(self, name: str, message: Any, sensor: int) -> None:
        number = SCHEMA.type_numbers[name]
        with self._one_writes:
            data = memoryview(encode_message(number, message.SerializeToString(), sensor=sensor,
                                             sequence=self._sequence[sensor], flags=SIMULATED))  # fmt: skip
            self._sequence[sensor] += 1
            while data and not self._stop.is_set():
                try:
                    data = data[os.write(self.master, data) :]
                except BlockingIOError:
                    self._stop.wait(0.001)


def wrench(stamp: Any, force_n: tuple[float, float, float], torque_nm: tuple[float, float, float],
           validity: tuple[int, ...] = (1,) * 6) -> Any:  # fmt: skip
    """A WRENCH with a covariance of 5 mN and 0.05 N mm."""
    un, un_um = [round(f * 1e6) for f in force_n], [round(t * 1e12) for t in torque_nm]
    upper = np.diag([5_000**2] * 3 + [50_000**2] * 3)[np.triu_indices(6)].tolist()
    return SCHEMA.new(
        "Wrench", stamp=stamp, force_x_un=un[0], force_y_un=un[1], force_z_un=un[2], torque_x_un_um=un_um[0],
        torque_y_un_um=un_um[1], torque_z_un_um=un_um[2], validity=validity, covariance=upper, covariance_validity=1,
    )  # fmt: skip


def told_field(n_x: int, n_y: int) -> Teller:
    """A dent that walks over the pad, with shear, slip and how sure it is."""
    y, x = np.mgrid[-1 : 1 : n_y * 1j, -1 : 1 : n_x * 1j]

    def tell(frame: int, stamp: Any) -> Messages:
        turn = frame / 40
        away = (x - 0.4 * np.cos(turn)) ** 2 + (y - 0.4 * np.sin(turn)) ** 2
        dent = np.exp(-away / 0.06)
        pressed = dent > 0.1
        force = (
            np.stack([300 * dent * np.cos(turn), 300 * dent * np.sin(turn), -900 * dent], axis=-1) * pressed[..., None]
        )
        steps = np.round(force).astype(np.int64)
        motion = np.round(np.stack([0.1 * dent, 0 * dent, -dent], axis=-1) * 6000).astype(np.int64)
        slip = np.where(pressed, np.where(dent < 0.4, 2, 1), 0)[..., None]
        sigma = np.broadcast_to(np.round(20 + 60 * dent)[..., None], force.shape).astype(np.int64)
        total = steps.sum(axis=(0, 1)) * 20e-6
        field = SCHEMA.new(
            "Field", stamp=stamp, force_lsb_un=20, force=dense(steps, n_x, n_y, 3), displacement_lsb_nm=100,
            displacement=dense(motion, n_x, n_y, 3), validity=[1, 1, 1], slip=dense(slip, n_x, n_y, 1),
            sigma=dense(sigma, n_x, n_y, 3), sigma_validity=1,
        )  # fmt: skip
        torque = (total[2] * 4e-3 * np.sin(turn), -total[2] * 4e-3 * np.cos(turn), 1e-3)
        return {"WRENCH": wrench(stamp, tuple(total), torque), "FIELD": field}

    return tell


def told_tray(frame: int, stamp: Any) -> Messages:
    """A wrench and nothing else."""
    turn = frame / 40
    force = (0.5 * np.cos(turn), 0.5 * np.sin(turn), -3 - np.sin(turn / 2))
    return {"WRENCH": wrench(stamp, force, (3e-3 * np.sin(turn), 3e-3 * np.cos(turn), 2e-3))}


def told_skin(radius_um: float) -> Teller:
    """Two touches on a tube."""

    def tell(frame: int, stamp: Any) -> Messages:
        contacts = []
        for number, (angle, along_um, force_un) in enumerate(
            [(frame / 60, 20_000, 6_000_000), (2.6, -30_000, 3_000_000)]
        ):
            angle = (angle + np.pi) % (2 * np.pi) - np.pi
            outward = np.array([np.cos(angle), np.sin(angle), 0])
            contacts.append(SCHEMA.new(
                "Contact", id=number, center_x_um=round(angle * radius_um), center_y_um=along_um, force_z_un=-force_un,
                validity=1, force_validity=[0, 0, 1],
                skin={"place_um": np.round(radius_um * outward + [0, 0, along_um]).astype(int).tolist(),
                      "normal_force_un": np.round(-force_un * outward).astype(int).tolist(),
                      "force_sigma_un": 200_000, "center_sigma_um": 900},
            ))  # fmt: skip
        total = (0, 0, -9.0)
        return {"WRENCH": wrench(stamp, total, (0, 0, 0), (0, 0, 1, 0, 0, 0)),
                "CONTACTS": SCHEMA.new("Contacts", stamp=stamp, contacts=contacts, n_found=2)}  # fmt: skip

    return tell


def told_tip(frame: int, stamp: Any) -> Messages:
    """A tool on a dome."""
    roll, pitch = 0.2 * np.sin(frame / 30), 0.15 * np.cos(frame / 30)
    axis = np.array([np.sin(pitch), -np.sin(roll), 1.0])
    axis /= np.linalg.norm(axis)
    contact = SCHEMA.new(
        "Contact", id=0, area_um2_k=28_000, center_x_um=round(axis[0] * 22_000), center_y_um=round(axis[1] * 22_000),
        force_z_un=-800_000, validity=1, force_validity=[0, 0, 1],
        tool={"tool_um": [300, -200, 900], "turn_urad": [round(roll * 1e6), round(pitch * 1e6)],
              "normal_force_un": np.round(-8e5 * axis).astype(int).tolist(),
              "tool_sigma": [9000, 400, 400, 20, 9000, 9000, 900]},
    )  # fmt: skip
    return {"WRENCH": wrench(stamp, (0, 0, -0.8), (0, 0, 0), (0, 0, 1, 0, 0, 0)),
            "CONTACTS": SCHEMA.new("Contacts", stamp=stamp, contacts=[contact], n_found=1)}  # fmt: skip


def told_uncertain(frame: int, stamp: Any) -> Messages:
    """Forces that are known to be wrong, or move the right way only, or were never measured."""
    stamp.flags = 4 | 64
    field = told_field(20, 16)(frame, stamp)["FIELD"]
    field.validity[:] = [3, 3, 2]
    return {"WRENCH": wrench(stamp, (0.1, 0.2, -1), (0, 0, 0), (3, 3, 2, 0, 0, 3)), "FIELD": field}
