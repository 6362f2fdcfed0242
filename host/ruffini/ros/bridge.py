"""Frames of a sensor to a ROS node's topics, and once a second how the sensor fares to /diagnostics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.api.frame import SensorFrame
from ruffini.api.sensor import Sensor
from ruffini.device.connection import Connection
from ruffini.device.health import health_words
from ruffini.device.namesakes import REMEDY
from ruffini.device.system_clock import SystemClock
from ruffini.errors import NoDeviceError, RuffiniError
from ruffini.ros.messages import (
    BAD_HEALTH,
    DIAGNOSTICS,
    ERROR,
    OK,
    STALE,
    TOPICS,
    WARN,
    Message,
    Topic,
    diagnostics,
    messages_of,
    pad_name,
    ros_name,
)

DIAGNOSTICS_S, TURN_S = 1.0, 0.2


class Node(Protocol):
    """What publishes: zenoh or rclpy."""

    def advertise(self, name: str, topic: Topic) -> None:
        """Before anything is published on it."""

    def publish(self, name: str, message: Message) -> None:
        """On a topic that was advertised."""

    def n_namesakes(self) -> int:
        """Other nodes of this name in the graph."""


class Bridge:
    """One sensor's topics on one node; `on_note` is told when another node has its name, and so its topics."""

    def __init__(self, sensor: Sensor, node: Node, on_note: Callable[[str], None] = lambda _: None) -> None:
        self._sensor, self._node, self._clock = sensor, node, SystemClock()
        self._on_note, self._n_namesakes = on_note, 0
        self._pads: dict[int, tuple[str, npt.NDArray[np.float64] | None]] = {}
        self._due_s = 0.0
        self._last: SensorFrame | None = None
        self.n_frames = 0
        for number in sensor.call(lambda c: [s.sensor for s in c.hello.sensors]):
            name = pad_name(sensor.serial_number, number, len(sensor.boards))
            try:
                nodes = sensor.nodes(number)
            except RuffiniError:  # a board without a field
                nodes = None
            self._pads[number] = name, nodes
            for topic in TOPICS:
                node.advertise(f"/{name}/{topic.name}", topic)
        node.advertise(DIAGNOSTICS.name, DIAGNOSTICS)

    @property
    def node_name(self) -> str:
        return ros_name(self._sensor.serial_number)

    def run(self, is_over: Callable[[], bool], n_frames: int | None = None) -> None:
        """Until `is_over`, or so many frames went through.

        Raises
        ------
        NoDeviceError
            The line was lost and did not come back; /diagnostics said so.
        """
        frames = self._sensor.frames(partial=True)
        while not is_over() and (n_frames is None or self.n_frames < n_frames):
            try:
                frame = frames.get(TURN_S)
            except StopIteration:
                return
            except NoDeviceError as error:
                self._tell(ERROR, [str(error)], {})
                raise
            if frame is not None:
                self.put(frame)
            if time.monotonic() >= self._due_s:
                self._due_s = time.monotonic() + DIAGNOSTICS_S
                self.tell_health(is_silent=frame is None)

    def put(self, frame: SensorFrame) -> None:
        """Publish what came of one picture. A repeated result (sensor 255) is the first pad's, without a number."""
        name, nodes = self._pads.get(frame.sensor) or next(iter(self._pads.values()))
        if frame.host_time_ns is None:
            stamp_ns, error_s = time.time_ns(), math.nan
        else:
            stamp_ns, error_s = self._clock.from_monotonic(frame.host_time_ns), 1e-9 * (frame.host_time_error_ns or 0)
        for topic, message in messages_of(frame, name, nodes, stamp_ns, error_s):
            self._node.publish(f"/{name}/{topic}", message)
        self._last = frame
        self.n_frames += 1

    def tell_health(self, *, is_silent: bool = False) -> None:
        """Ask the sensor how it fares and publish that."""
        namesakes = self._namesakes()
        try:
            status = self._sensor.call(Connection.status)
        except RuffiniError as error:
            return self._tell(ERROR, [str(error)], {})
        names = self._sensor.call(lambda c: c.schema.enum_names("HealthBit", status.health))
        counters = self._sensor.call(lambda c: c.decoder.counters)
        last = self._last
        words, level = list(health_words(names)), WARN if names else OK
        if last is not None and last.is_simulated:
            words, level = ["SIMULATED", *words], WARN
        if last is not None and not last.is_valid:
            words, level = [*words, "forces are not valid: " + (", ".join(last.flags) or "not measured")], ERROR
        if set(names) & set(BAD_HEALTH):
            level = ERROR
        if namesakes:
            words, level = [*words, namesakes], ERROR
        if is_silent or (last is not None and last.is_stale):
            words, level = [*words, "no new picture comes"], STALE
        values = {
            "frame rate": f"{status.frame_rate_mhz / 1e3:.1f} Hz",
            "frames processed": str(status.frames_processed),
            "frames replaced": str(status.drops.capture_overrun),
            "frames damaged on the line": str(counters.damaged),
            "messages lost on the line": str(counters.lost),
            "messages left out while a command waited": str(self._sensor.n_left_out),
            "frames with a message too late": str(self._sensor.n_late),
            "published": str(self.n_frames),
            "calibration": status.calibration_sha256.hex()[:12] or "none",
        }
        return self._tell(level, words, values)

    def _namesakes(self) -> str:
        """What is wrong where another node publishes on these topics, too; told when that begins."""
        n_before, self._n_namesakes = self._n_namesakes, self._node.n_namesakes()
        if not self._n_namesakes:
            return ""
        text = (
            f"another node is named {self.node_name}, too, and two sensors' forces may be mixed on its topics: end one "
            f"of the bridges; where two sensors have serial number {self._sensor.serial_number}, {REMEDY}"
        )
        if not n_before:
            self._on_note(text)
        return text

    def _tell(self, level: int, words: list[str], values: dict[str, str]) -> None:
        message = diagnostics(time.time_ns(), self._sensor.serial_number, level, words, values)
        self._node.publish(DIAGNOSTICS.name, message)
