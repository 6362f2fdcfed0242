"""Learn the rest image again and wait for the result."""

from __future__ import annotations

from ruffini.device.connection import SILENCE_S, Connection
from ruffini.device.line import DEVICE
from ruffini.errors import NoDeviceError, RefusedError

# Events that end the learning without a new rest image.
ENDED_BY = ("zero_refused", "zero_given_up")
# So many frames after the command without FLAG_NO_REFERENCE: it was learned, and the line lost the frames in between.
N_SURE = 10


def learn_rest(sensor: Connection, n_frames: int = 0, *, even_if_touched: bool = False, waits: bool = True) -> None:
    """Learn rest from the next frames (0: as many as the board says), and wait until it is learned.

    Waiting, it subscribes to WRENCH alone.

    Raises
    ------
    RefusedError
        Something presses on the pad, now or while rest is learned; or the camera stood still. Rest is what it was.
    NoDeviceError
        No frame comes.
    """
    if waits:
        sensor.subscribe(wrench=1)
    reply = sensor.command(zero={"n_frames": n_frames} | ({"even_if_touched": True} if even_if_touched else {}))
    if reply.code:
        raise RefusedError(f"{sensor.port}: {reply.text}")
    if not waits:
        return
    learning = sensor.schema.enum_number("FlagBit", "FLAG_NO_REFERENCE")
    has_begun, n_after = False, 0
    for frame, message in sensor.stream(timeout_s=SILENCE_S):
        name = sensor.schema.type_name(frame.type)
        if name == "EVENT" and message.what in ENDED_BY:
            raise RefusedError(f"{sensor.port}: {message.text}")
        if name != "WRENCH" or frame.sensor == DEVICE:  # a repeated result
            continue
        is_learning = bool(message.stamp.flags & learning)
        has_begun, n_after = has_begun or is_learning, 0 if is_learning else n_after + 1
        if n_after > (0 if has_begun else N_SURE):
            return
    raise NoDeviceError(f"{sensor.port}: no frame for {SILENCE_S:.0f} s, rest is not learned: is the camera running?")
