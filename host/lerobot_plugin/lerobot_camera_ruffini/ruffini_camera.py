"""Pictures of the force field, and the numbers that they were made of."""

from __future__ import annotations

import threading
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from lerobot.cameras.camera import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import ruffini
from lerobot_camera_ruffini.config_ruffini import RuffiniCameraConfig
from ruffini.api import Sensor, SensorFrame
from ruffini.errors import NoDeviceError, RuffiniError
from ruffini.patience import PATIENCE

Picture = npt.NDArray[np.uint8]
READ_MS, WARMUP_MS = 1_000.0 * PATIENCE, 5_000.0 * PATIENCE


class Touch(NamedTuple):
    """What a picture was made of: SI units, pad frame (+z out of the pad), forces ON the pad, all of it VALID.

    points : (N, 6) x, y, z of each node on the undeformed pad (m) and its force (N); force along an axis that the board
        does not measure is NaN.
    wrench : (6,) force (N) and moment (N m) about the pad's centre; NaN where it is not measured.
    captured_s : middle of the exposure on `time.perf_counter`, as far as the sensor's clock is known, else of arrival.
    results : everything that the sensor sent of this picture, with validity: contacts with hardness, depth, tool, skin
        and slip, a network's quantities, standard deviations, depth.
    """

    points: npt.NDArray[np.float64]
    wrench: npt.NDArray[np.float64]
    captured_s: float
    number: int
    is_simulated: bool
    results: SensorFrame


def render(force: npt.NDArray[np.float64], how: str, force_max_n: float, width: int, height: int) -> Picture:
    """(n_y, n_x, 3) newtons as a picture (height, width, 3) uint8; a node is a rectangle of one colour."""
    if how == "vector_rgb":
        small = np.round(128 + 127 * np.clip(force / force_max_n, -1, 1))
    else:
        small = np.repeat(np.round(255 * np.clip(-force[..., 2:] / force_max_n, 0, 1)), 3, axis=2)
    rows = np.arange(height) * force.shape[0] // height
    columns = np.arange(width) * force.shape[1] // width
    return np.ascontiguousarray(small.astype(np.uint8)[rows][:, columns])


class RuffiniCamera(Camera):
    """LeRobot's camera interface on one pad.

    Every picture is of a frame whose forces are valid: what is not is no frame, and a reader's time runs out with the
    reason. So no picture shows a wrong force. A data set must keep pictures as images: `--dataset.video=false`, video
    loses small forces.
    """

    def __init__(self, config: RuffiniCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._sensor: Sensor | None = None
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._newest: tuple[Picture, Touch] | None = None
        self._shown: Touch | None = None
        self._is_fresh = False
        self._trouble = "no frame came"

    def __str__(self) -> str:
        return f"RuffiniCamera({self.config.port or self.config.serial or 'the only sensor'})"

    @property
    def is_connected(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Sensors that answer."""
        from ruffini.device import Connection
        from ruffini.device.connection import candidate_ports

        found = []
        for port in candidate_ports():
            try:
                with Connection(port) as sensor:
                    boards = [s.product for s in sensor.hello.sensors]
                    found.append(
                        {"type": "ruffini", "id": port, "serial": sensor.serial_number, "name": ", ".join(boards)}
                    )
            except RuffiniError:
                continue  # somebody else's serial port
        return found

    def connect(self, warmup: bool = True) -> None:
        """Open the sensor; with `warmup` wait for the first valid frame.

        Raises
        ------
        DeviceAlreadyConnectedError
            It is open.
        ConnectionError
            No sensor, or no valid frame: uncalibrated, rest not learned, a board without what `render` shows.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        try:
            self._sensor = ruffini.connect(self.config.port or None, self.config.serial or None)
            nodes = self._sensor.nodes(self.config.sensor)
        except RuffiniError as error:
            self._close()
            raise ConnectionError(str(error)) from error
        points = np.zeros((nodes.shape[0] * nodes.shape[1], 6))
        points[:, :2] = nodes.reshape(-1, 2)
        self._newest, self._shown, self._is_fresh, self._trouble = None, None, False, "no frame came"
        self._thread = threading.Thread(target=self._run, args=(self._sensor, points), name=str(self), daemon=True)
        self._thread.start()
        if warmup:
            try:
                self.async_read(WARMUP_MS)
            except TimeoutError as error:
                self.disconnect()
                raise ConnectionError(str(error)) from error

    def disconnect(self) -> None:
        """Give the port back."""
        if self._sensor is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        self._close()

    def read(self) -> Picture:
        """The next picture that is taken from now on."""
        with self._changed:
            self._is_fresh = False
        return self.async_read(READ_MS)

    def async_read(self, timeout_ms: float = 200) -> Picture:
        """The newest picture that was not given out yet.

        Raises
        ------
        TimeoutError
            No valid frame in time; says why.
        """
        self._check()
        with self._changed:
            self._changed.wait_for(lambda: self._is_fresh or not self.is_connected, timeout_ms / 1e3)
            if not self._is_fresh:
                raise TimeoutError(f"{self}: no valid frame within {timeout_ms:.0f} ms: {self._trouble}")
            self._is_fresh = False
            return self._give()

    def read_latest(self, max_age_ms: int = 500) -> Picture:
        """The newest picture, given out before or not.

        Raises
        ------
        TimeoutError
            It is older than that; says why.
        RuntimeError
            There was none yet.
        """
        self._check()
        with self._changed:
            if self._newest is None:
                raise RuntimeError(f"{self}: no valid frame yet: {self._trouble}")
            age_ms = 1e3 * (time.perf_counter() - self._newest[1].captured_s)
            if age_ms > max_age_ms:
                raise TimeoutError(f"{self}: the latest valid frame is {age_ms:.0f} ms old: {self._trouble}")
            return self._give()

    @property
    def touch(self) -> Touch:
        """The numbers of the picture that was read last.

        Raises
        ------
        RuntimeError
            None was read yet.
        """
        if self._shown is None:
            raise RuntimeError(f"{self}: read a picture first")
        return self._shown

    # ---- inside -------------------------------------------------------------------------------

    def _check(self) -> None:
        if self._sensor is None:
            raise DeviceNotConnectedError(f"{self} is not connected")

    def _give(self) -> Picture:
        assert self._newest is not None
        picture, self._shown = self._newest
        return picture

    def _close(self) -> None:
        sensor, self._sensor = self._sensor, None
        if sensor is not None:
            sensor.close()
        if self._thread is not None:
            self._thread.join(READ_MS / 1e3)
            self._thread = None

    def _run(self, sensor: Sensor, points: npt.NDArray[np.float64]) -> None:
        """The thread: pictures of frames as they come."""
        try:
            for frame in sensor.frames(newest=True, sensor=self.config.sensor):
                trouble = self._take(frame, points)
                with self._changed:
                    if trouble:
                        self._trouble = trouble
                    self._changed.notify_all()
        except NoDeviceError as error:
            with self._changed:
                self._trouble = str(error)
                self._changed.notify_all()

    def _take(self, frame: SensorFrame, points: npt.NDArray[np.float64]) -> str:
        """Keep the frame; why not, where its forces are not valid."""
        field, wrench = frame.field, frame.wrench
        if field is None or wrench is None:
            return "the sensor sends no force field: is it calibrated, and does its board have one?"
        wanted = field.force if self.config.render == "vector_rgb" else field.force[..., 2]
        if np.isnan(wanted).any():
            flags = ", ".join(frame.flags) or "this board does not measure all that this picture shows"
            return f"its forces are not valid ({flags})"
        c = self.config
        assert c.width is not None
        assert c.height is not None
        now_s = time.perf_counter()
        age_s = 0.0 if frame.host_time_ns is None else 1e-9 * (time.monotonic_ns() - frame.host_time_ns)
        rows = points.copy()
        rows[:, 3:] = field.force.reshape(-1, 3)
        both = np.concatenate([wrench.force, wrench.torque])
        touch = Touch(rows, both, now_s - age_s, frame.number, frame.is_simulated, frame)
        picture = render(field.force, c.render, c.force_max_n, c.width, c.height)
        with self._changed:
            self._newest, self._is_fresh = (picture, touch), True
        return ""
