"""The sensor's stream under watch: a thread reads it; forces, frames and stalls are told at once."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.device import Connection, Contacts, Field, Wrench
from ruffini.device.results import NOT_MEASURED, RESULTS, Features, Image, Markers
from ruffini.errors import NoDeviceError, RuffiniError

Array = npt.NDArray[np.float64]

STALL_S = 2.0
WARM_S = 5.0  # for so long a temperature is believed; STATUS comes once a second
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


class FeatureSample(NamedTuple):
    """Features (n,) of the wrench, the board's integers, at the sensor's own time."""

    stream_s: float
    value: npt.NDArray[np.int32]


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
    features: list[FeatureSample]

    def between(self, low_s: float, high_s: float) -> Window:
        """What was measured in a time of the sensor's own clock."""
        return Window(
            *([s for s in samples if low_s < s.stream_s < high_s] for samples in cast(list[list[Any]], list(self)))
        )


Sample = StreamSample | FieldSample | MarkerSample | ImageSample | ContactSample | FeatureSample
KINDS: tuple[type[Sample], ...] = (
    StreamSample, FieldSample, MarkerSample, ImageSample, ContactSample, FeatureSample,
)  # of a Window  # fmt: skip


class StreamWatch:
    """Reads a sensor until `close`. Nobody else may use the connection meanwhile.

    Parameters
    ----------
    field_every, marker_every, image_every, contact_every, feature_every : each n-th frame's; 0 = none.
    stall_s : longer without a frame, and the camera stands still.
    """

    def __init__(
        self, sensor: Connection, *, field_every: int = 1, marker_every: int = 0, image_every: int = 0,
        contact_every: int = 0, feature_every: int = 0, stall_s: float = STALL_S,
    ) -> None:  # fmt: skip
        sensor.subscribe(
            wrench=1, field=field_every, markers=marker_every, image=image_every, contacts=contact_every,
            features=feature_every, status=1,
        )  # fmt: skip
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
        readers: dict[str, Callable[[float, Any], list[Sample]]] = {
            "WRENCH": _frame, "FIELD": _field, "MARKERS": _markers, "IMAGE": _image, "CONTACTS": _contacts,
            "FEATURES": _features,
        }  # fmt: skip
        stale = schema.enum_number("FlagBit", "FLAG_STALE")
        by_type = {
            schema.type_numbers[name]: (RESULTS[name], read)
            for name, read in readers.items() if name in schema.type_numbers
        }  # fmt: skip
        try:
            while not self._stop.is_set():
                for frame, message in self._sensor.stream(timeout_s=0.1):
                    now = host_clock.now()
                    if frame.type == schema.type_numbers["STATUS"]:
                        celsius = {t.place: t.milli_celsius * 1e-3 for t in message.temperatures}
                        self._warmth = (time.monotonic(), celsius)
                    made: list[Sample] = []
                    if frame.type in by_type:
                        kind, read = by_type[frame.type]
                        result = kind.from_message(message)
                        made = [] if result.flags & stale else read(now, result)  # stale: nothing new
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
                                    "collected is kept; go on when it runs again")  # fmt: skip
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
        with self._lock:
            return _window(sample for arrived_s, sample in self._samples if arrived_s > host_s)

    def take(self) -> Window:
        """What arrived since the last call, each sample once; it is freed here."""
        with self._lock:
            taken, self._samples = self._samples, deque()
        return _window(sample for _, sample in taken)

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


def _window(samples: Iterable[Sample]) -> Window:
    window = Window(*([] for _ in KINDS))
    of_type: dict[type, list[Any]] = dict(zip(KINDS, window, strict=True))
    for sample in samples:
        of_type[type(sample)].append(sample)
    return window


def _frame(now: float, w: Wrench) -> list[Sample]:
    return [StreamSample(now, w.capture_s, w.frame, w.flags, w.values, w.validity)]


def _field(_: float, field: Field) -> list[Sample]:
    return [] if field.displacement is None else [FieldSample(field.capture_s, field.displacement)]


def _contacts(_: float, sent: Contacts) -> list[Sample]:
    """Contacts of a skin, whose z is out of it everywhere, or of a contact model."""
    made: list[Sample] = []
    for c in sent.contacts:
        validity = c.force_validity[2] if c.force_validity else c.validity
        force_n = math.nan if validity == NOT_MEASURED else c.raw_force[2]
        touch = c.raw_skin or c.raw_tool
        center_sigma_m = None if c.raw_skin is None else c.raw_skin.center_sigma_m
        sigma = [(touch and touch.force_sigma_n) or np.nan, center_sigma_m or np.nan]  # not stated: NaN
        shore_a = math.nan if c.model is None else c.model.shore_a
        made.append(ContactSample(sent.capture_s, c.id, np.array(c.center), force_n, np.array(sigma), shore_a))
    return made


def _markers(_: float, m: Markers) -> list[Sample]:
    moved = m.displacement_px.reshape(-1, 2)
    if not len(moved):
        return []
    if m.area_px2 is not None:
        moved = np.hstack([moved, m.area_px2.reshape(-1, 1)])
    return [MarkerSample(m.capture_s, moved, None if m.rest_px is None else m.rest_px.reshape(-1, 2))]


def _features(_: float, features: Features) -> list[Sample]:
    return [FeatureSample(features.capture_s, features.value)]


def _image(_: float, image: Image) -> list[Sample]:
    return [ImageSample(image.capture_s, image.pixels.copy(), image.step_px)]
