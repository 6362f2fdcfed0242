"""The sensor's stream under watch: a thread reads it; forces, frames and stalls are told at once."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.device import Connection, Field, Wrench
from ruffini.device.results import NOT_MEASURED, VALID, Image
from ruffini.errors import NoDeviceError, RuffiniError
from ruffini.wire.dense import decode_dense

Array = npt.NDArray[np.float64]

STALL_S = 2.0
WARM_S = 5.0  # for so long a temperature is believed; STATUS comes once a second
AREA_STEPS = 256  # of a square pixel, in MARKERS
START_S = 20.0  # until it has learned rest
KEPT_S = 300.0  # of the stream: longer than any touch lasts, and a person may leave a question open for hours


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


class MarkerSample(NamedTuple):
    """Displacement (n, 2 or 3) and, where the sensor sends them, rest places (n, 2), at the sensor's own time.

    Pixels; the third is the change of area, square pixels.
    """

    stream_s: float
    displacement: Array
    place: Array | None


class ImageSample(NamedTuple):
    """Picture (h, w, 3), each `step_px`-th pixel, at the sensor's own time."""

    stream_s: float
    pixels: npt.NDArray[np.uint8]
    step_px: int


class ContactSample(NamedTuple):
    """One contact in one frame, at the sensor's own time; a frame without contacts has none.

    place (2,) m of its centre on the pad, force_n along the outward normal (pressing is negative; NaN where not
    measured), sigma (2,) N and m, NaN where not stated; shore: hardness of the object, NaN where it is not valid.
    """

    stream_s: float
    number: int  # the same while it lasts
    place: Array
    force_n: float
    sigma: Array
    shore_a: float = math.nan


class Window(NamedTuple):
    """What arrived in a time."""

    frames: list[StreamSample]
    fields: list[FieldSample]
    markers: list[MarkerSample]
    images: list[ImageSample]
    contacts: list[ContactSample]

    def between(self, low_s: float, high_s: float) -> Window:
        """What was measured in a time of the sensor's own clock."""
        return Window(
            *([s for s in samples if low_s < s.stream_s < high_s] for samples in cast(list[list[Any]], list(self)))
        )


Sample = StreamSample | FieldSample | MarkerSample | ImageSample | ContactSample
KINDS: tuple[type[Sample], ...] = (StreamSample, FieldSample, MarkerSample, ImageSample, ContactSample)  # of a Window


class StreamWatch:
    """Reads a sensor until `close`. Nobody else may use the connection meanwhile.

    Parameters
    ----------
    field_every, marker_every, image_every, contact_every : each n-th frame's; 0 = none.
    stall_s : longer without a frame, and the camera stands still.
    """

    def __init__(
        self, sensor: Connection, *, field_every: int = 1, marker_every: int = 0, image_every: int = 0,
        contact_every: int = 0, stall_s: float = STALL_S,
    ) -> None:  # fmt: skip
        sensor.subscribe(
            wrench=1, field=field_every, markers=marker_every, image=image_every, contacts=contact_every, status=1
        )
        self.name, self.stall_s, self.has_images = f"sensor on {sensor.port}", stall_s, image_every > 0
        self._sensor = sensor
        self._samples: deque[tuple[float, Sample]] = deque()  # with the host's time of arrival
        self._newest: StreamSample | None = None
        self._warmth: tuple[float, dict[str, float]] = (-np.inf, {})  # real time of arrival; degrees by place
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
        schema = self._sensor.schema
        readers = {"WRENCH": _frame, "FIELD": _field, "MARKERS": _markers, "IMAGE": _image, "CONTACTS": _contacts}
        stale = schema.enum_number("FlagBit", "FLAG_STALE")
        by_type = {schema.type_numbers[name]: read for name, read in readers.items()}
        try:
            while not self._stop.is_set():
                for frame, message in self._sensor.stream(timeout_s=0.1):
                    now = host_clock.now()
                    if frame.type == schema.type_numbers["STATUS"]:
                        celsius = {t.place: t.milli_celsius * 1e-3 for t in message.temperatures}
                        self._warmth = (time.monotonic(), celsius)
                    is_result = frame.type in by_type and not message.stamp.flags & stale  # else nothing new
                    made = by_type[frame.type](now, message) if is_result else []
                    with self._lock:
                        self._samples += [(now, sample) for sample in made]
                        self._forget(now - KEPT_S)
                        self._newest = next((s for s in made if isinstance(s, StreamSample)), self._newest)
                    if made and isinstance(made[0], StreamSample):
                        host_clock.has_seen(made[0].frame)
                    if self._stop.is_set():
                        return
        except RuffiniError as error:
            self._error = error

    def latest(self) -> StreamSample:
        """The newest frame.

        Raises
        ------
        NoDeviceError
            The line was lost, or no frame came for a while.
        """
        start = host_clock.now()
        while True:
            if self._error is not None:
                raise self._error
            newest = self._newest
            if newest is not None and host_clock.now() - newest.host_s < self.stall_s:
                return newest
            if newest is not None or host_clock.now() - start > START_S:
                raise NoDeviceError(f"{self.name}: no frame for {self.stall_s:g} s: the camera stands still: what was "
                                    "collected is kept; when it runs again, the same command goes on")  # fmt: skip
            host_clock.sleep(0.02)

    def wait_for_rest(self, no_reference_bit: int) -> None:
        """Until the sensor has learned its untouched image."""
        deadline = host_clock.now() + START_S
        while self.latest().flags & no_reference_bit:
            if host_clock.now() > deadline:
                raise NoDeviceError(
                    f"{self.name} does not learn rest within {START_S:g} s: does something touch the pad?"
                )
            host_clock.sleep(0.05)

    def force(self) -> Array:
        """Force of the newest frame, (3,) N, NaN where not measured; raises as `latest`."""
        return self.latest().wrench[:3]

    def temperatures(self) -> dict[str, float]:
        """What the device says of its temperatures now, degrees Celsius by place; empty where it says none."""
        arrived_s, celsius = self._warmth
        return dict(celsius) if time.monotonic() - arrived_s < WARM_S else {}

    def since(self, host_s: float) -> Window:
        """What arrived after `host_s`."""
        window = Window(*([] for _ in KINDS))
        of_type: dict[type, list[Any]] = dict(zip(KINDS, window, strict=True))
        with self._lock:
            for arrived_s, sample in self._samples:
                if arrived_s > host_s:
                    of_type[type(sample)].append(sample)
        return window

    def recent(self, duration_s: float) -> list[StreamSample]:
        """Frames of the last `duration_s`; none where the camera stands still. Raises nothing."""
        since, found = host_clock.now() - duration_s, list[StreamSample]()
        with self._lock:
            for arrived_s, sample in reversed(self._samples):
                if arrived_s <= since:
                    break
                if isinstance(sample, StreamSample):
                    found.append(sample)
        return found[::-1]

    def forget(self, host_s: float) -> None:
        """Free what arrived before `host_s`."""
        with self._lock:
            self._forget(host_s)

    def _forget(self, host_s: float) -> None:
        while self._samples and self._samples[0][0] <= host_s:
            self._samples.popleft()


def _frame(now: float, message: Any) -> list[Sample]:
    w = Wrench.from_message(message)
    return [StreamSample(now, w.capture_s, w.frame, w.flags, w.values, w.validity)]


def _field(_: float, message: Any) -> list[Sample]:
    field = Field.from_message(message)
    return [] if field.displacement is None else [FieldSample(field.capture_s, field.displacement)]


def _contacts(_: float, message: Any) -> list[Sample]:
    """Contacts of a skin, whose z is out of it everywhere, or of a contact model."""
    stream_s = message.stamp.capture_us * 1e-6
    made: list[Sample] = []
    for c in message.contacts:
        validity = c.force_validity[2] if len(c.force_validity) == 3 else c.validity
        force_n = np.nan if validity == NOT_MEASURED else c.force_z_un * 1e-6
        sigma = [c.force_sigma_un * 1e-6 or np.nan, c.center_sigma_um * 1e-6 or np.nan]  # 0: not stated
        place = np.array([c.center_x_um, c.center_y_um]) * 1e-6
        is_hard_known = getattr(c, "hardness_validity", NOT_MEASURED) == VALID
        shore_a = c.shore_a_1e1 * 0.1 if is_hard_known else math.nan
        made.append(ContactSample(stream_s, c.id, place, force_n, np.array(sigma), shore_a))
    return made


def _markers(_: float, message: Any) -> list[Sample]:
    scale = message.position_lsb_upx * 1e-6
    moved, rest, area = (
        decode_dense(d.codec, d.n_x, d.n_y, d.n_components, d.data).reshape(-1, d.n_components)
        if name in message.DESCRIPTOR.fields_by_name and message.HasField(name) and (d := getattr(message, name)).n_x
        else None
        for name in ("displacement", "rest", "area")
    )
    if moved is None:
        return []
    displacement = moved * scale if area is None else np.hstack([moved * scale, area / AREA_STEPS])
    return [MarkerSample(message.stamp.capture_us * 1e-6, displacement, None if rest is None else rest * scale)]


def _image(_: float, message: Any) -> list[Sample]:
    image = Image.from_message(message)
    return [ImageSample(image.capture_s, image.pixels.copy(), image.step_px)]
