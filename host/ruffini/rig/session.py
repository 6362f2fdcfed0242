"""Prepares a bench: connects sensor, reference and stage, homes, learns rest and sets up the guards."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from ruffini.boards import Board
from ruffini.device import Connection
from ruffini.errors import InputError
from ruffini.rig.bench import MAX_HOLD_S, Bench, Person
from ruffini.rig.guarded_stage import GuardedStage, Limits, force_guard
from ruffini.rig.holder import Holder
from ruffini.rig.placed_weight import PlacedWeight
from ruffini.rig.program import Tool
from ruffini.rig.reference import Reference
from ruffini.rig.settings import RigSettings
from ruffini.rig.stage import Guard, Place, Stage, no_guard
from ruffini.rig.stream_watch import STALL_S, StreamWatch
from ruffini.rig.touch import LONGEST_GAP_S
from ruffini.rig.watch import Watch
from ruffini.wire.framing import MAX_MESSAGE_BYTES

NO_REFERENCE = "FLAG_NO_REFERENCE"
DENSE_HZ = 20.0  # of fields and markers: a few are kept, and the host has to read all that comes
BAD_FLAGS = (NO_REFERENCE, "FLAG_MARKERS_LOST", "FLAG_SATURATED", "FLAG_DARK", "FLAG_OVEREXPOSED")
OVER_RANGE = "FLAG_OVER_RANGE"


class Pace(NamedTuple):
    """How slow a bench may be."""

    frame_hz: float | None = None  # of the camera; None = the board's
    stall_s: float = STALL_S
    longest_gap_s: float = LONGEST_GAP_S
    max_hold_s: float = MAX_HOLD_S
    image_bytes_per_s: float = 4e5  # of the line, for pictures


@dataclass(frozen=True)
class SensorParts:
    """A sensor that is connected, and who touches it."""

    sensor: Connection
    person: Person
    pace: Pace = field(default_factory=Pace)


@dataclass(frozen=True)
class Parts(SensorParts):
    """What a bench is made of, connected."""

    reference: Reference = field(kw_only=True)
    max_force_n: float = field(kw_only=True)
    stage: Stage | None = field(default=None, kw_only=True)
    origin: Place = field(default=Place(0.0, 0.0, 0.0), kw_only=True)
    mount: Callable[[Tool], None] | None = field(default=None, kw_only=True)
    holder: Holder | None = field(default=None, kw_only=True)


def open_real(
    stack: contextlib.ExitStack, settings: RigSettings, board: Board, sensor: Connection, person: Person
) -> Parts:
    """Connect to what a bench's file names; `stack` gives it back."""
    reference, max_force_n = settings.reference.open(), settings.limits.max_force_n
    if settings.stage is None:
        return Parts(sensor, person, reference=reference, max_force_n=max_force_n)
    try:
        stage = settings.stage.open(board)
    except BaseException:
        reference.close()
        raise
    stack.callback(stage.close)
    return Parts(sensor, person, reference=reference, max_force_n=max_force_n, stage=stage,
                 origin=settings.stage.origin(board),
                 holder=None if settings.holder is None else settings.holder.of(board))  # fmt: skip


class Watched(NamedTuple):
    """A stream at rest; the bits that spoil a frame, by name; a word for this run of the daemon."""

    stream: StreamWatch
    bad_flags: dict[int, str]
    session: str


def bad_flags_of(board: Board) -> tuple[str, ...]:
    """Flags of a frame that no log should hold.

    Where the board measures displacements, over range may be a bound of the gel; elsewhere it is one of the calibration
    in force, which a new log may be there to extend.
    """
    return (*BAD_FLAGS, OVER_RANGE) if board.writes("displacement") else BAD_FLAGS


def sent_image_bytes(width_px: int, height_px: int) -> int:
    """Size of a picture on the line: decimated until it fits one message (proto/README.md)."""
    sizes = (3 * (width_px // step) * (height_px // step) for step in itertools.count(1))
    return next(size for size in sizes if size < MAX_MESSAGE_BYTES)


@contextlib.contextmanager
def watched_stream(sensor: Connection, board: Board, pace: Pace) -> Iterator[Watched]:
    """The sensor's stream, with what its pipeline makes and some pictures.

    Raises
    ------
    InputError
        The sensor is not of `board`.
    """
    if board.name not in (boards := [described.board for described in sensor.hello.sensors]):
        raise InputError(f"{sensor.port} is of board {', '.join(boards)}, not {board.name}: give --board accordingly")
    names = {1 << i: sensor.schema.enum_names("FlagBit", 1 << i) for i in range(32)}
    bad = bad_flags_of(board)
    bits = {found[0]: bit for bit, found in names.items() if found and found[0] in bad}
    camera = board.camera
    frame_hz = pace.frame_hz or camera.rate_mhz * 1e-3
    dense_every = max(1, round(camera.rate_mhz * 1e-3 / DENSE_HZ))
    image_every = math.ceil(frame_hz * sent_image_bytes(camera.width_px, camera.height_px) / pace.image_bytes_per_s)
    has_markers = board.writes("markers") or board.writes("targets")
    has_features = board.writes("features") and not has_markers  # those of markers and targets follow from their motion
    has_contacts = board.writes("skin") or board.writes("contact_model")
    with StreamWatch(
        sensor, field_every=dense_every * board.writes("displacement"),
        marker_every=has_markers * (dense_every if board.writes("node_forces") else 1),
        image_every=image_every, contact_every=int(has_contacts), feature_every=int(has_features),
        stall_s=pace.stall_s,
    ) as stream:  # fmt: skip
        stream.wait_for_rest(bits[NO_REFERENCE])
        bad_flags = {bit: name.removeprefix("FLAG_").lower() for name, bit in bits.items()}
        yield Watched(stream, bad_flags, f"{sensor.hello.session_id:x}")


@contextlib.contextmanager
def ready_bench(parts: Parts, board: Board, limits: Limits | None, key: Guard = no_guard) -> Iterator[Bench]:
    """The bench, homed and at rest; `key` raises when it is to stop."""
    with Watch(parts.reference) as watch, watched_stream(parts.sensor, board, parts.pace) as watched:
        sensor_guard = force_guard("the sensor", watched.stream.force, parts.max_force_n)

        def guard() -> None:
            key()
            sensor_guard()

        stage = None
        if parts.stage is not None and limits is not None:
            parts.stage.home()
            stage = GuardedStage(parts.stage, parts.origin, limits, lambda: watch.latest().wrench, [guard],
                                 fresh_force_of=lambda: watch.fresh().wrench)  # fmt: skip
        weight = parts.reference if isinstance(parts.reference, PlacedWeight) else None
        yield Bench(
            watch, watched.stream, watched.bad_flags, parts.person, parts.max_force_n, stage, guard, weight,
            watched.session, parts.pace.longest_gap_s, parts.pace.max_hold_s, parts.mount, holder=parts.holder,
            pictures_on_way=board.writes("tool_touch"),
        )  # fmt: skip
