"""The sensor's stream under watch: a thread reads it; forces, frames and stalls are told at once."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.device import Connection, Field, Wrench
from ruffini.errors import NoDeviceError, RuffiniError

Array = npt.NDArray[np.float64]

STALL_S = 2.0
START_S = 20.0  # until it has learned rest


class StreamSample(NamedTuple):
    """One frame: host time of arrival, the sensor's own time, force and moment ON the pad, what it says of them."""

    host_s: float
    stream_s: float
    frame: int
    flags: int
    wrench: Array  # (6,) N, N m; NaN where not measured
    validity: tuple[int, ...]


class FieldSample(NamedTuple):
    """Displacement (n_y, n_x, 3) in metres at the sensor's own time."""

    stream_s: float
    displacement: Array


class StreamWatch:
    """Reads a sensor until `close`. Nobody else may use the connection meanwhile."""

    def __init__(self, sensor: Connection, *, field_every: int = 1) -> None:
        sensor.subscribe(wrench=1, field=field_every)
        self.name = f"sensor on {sensor.port}"
        self._sensor = sensor
        self._samples: list[StreamSample] = []
        self._fields: list[tuple[float, FieldSample]] = []
        self._error: RuffiniError | None = None
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)
        self._thread.start()

    def __enter__(self) -> StreamWatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop reading; the connection stays open."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        numbers = self._sensor.schema.type_numbers
        try:
            while not self._stop.is_set():
                for frame, message in self._sensor.stream(timeout_s=0.1):
                    if frame.type == numbers["WRENCH"]:
                        self._take(Wrench.from_message(message))
                    elif frame.type == numbers["FIELD"]:
                        self._take_field(Field.from_message(message))
                    if self._stop.is_set():
                        return
        except RuffiniError as error:
            self._error = error

    def _take(self, w: Wrench) -> None:
        sample = StreamSample(time.monotonic(), w.capture_s, w.frame, w.flags, w.values, w.validity)
        with self._lock:
            self._samples.append(sample)

    def _take_field(self, field: Field) -> None:
        if field.displacement is not None:
            with self._lock:
                self._fields.append((time.monotonic(), FieldSample(field.capture_s, field.displacement)))

    def latest(self) -> StreamSample:
        """The newest frame.

        Raises
        ------
        NoDeviceError
            The line was lost, or no frame came for a while.
        """
        start = time.monotonic()
        while True:
            if self._error is not None:
                raise self._error
            with self._lock:
                newest = self._samples[-1] if self._samples else None
            if newest is not None and time.monotonic() - newest.host_s < STALL_S:
                return newest
            if newest is not None or time.monotonic() - start > START_S:
                raise NoDeviceError(f"{self.name}: no frame for {STALL_S:g} s: the camera stands still: what was "
                                    "collected is kept; when it runs again, the same command goes on")  # fmt: skip
            time.sleep(0.02)

    def wait_for_rest(self, no_reference_bit: int) -> None:
        """Until the sensor has learned its untouched image."""
        deadline = time.monotonic() + START_S
        while self.latest().flags & no_reference_bit:
            if time.monotonic() > deadline:
                raise NoDeviceError(
                    f"{self.name} does not learn rest within {START_S:g} s: does something touch the pad?"
                )
            time.sleep(0.05)

    def force(self) -> Array:
        """Force of the newest frame, (3,) N, NaN where not measured; raises as `latest`."""
        return self.latest().wrench[:3]

    def since(self, host_s: float) -> tuple[list[StreamSample], list[FieldSample]]:
        """Frames and fields that arrived after `host_s`."""
        with self._lock:
            return [s for s in self._samples if s.host_s > host_s], [f for t, f in self._fields if t > host_s]

    def forget(self, host_s: float) -> None:
        """Free what arrived before `host_s`."""
        with self._lock:
            self._samples = [s for s in self._samples if s.host_s > host_s] or self._samples[-1:]
            self._fields = [f for f in self._fields if f[0] > host_s]
