"""What STATUS says of a device's health, in words for a person."""

from __future__ import annotations

import signal
from typing import Any

HEALTH_WORDS = {
    "HEALTH_UNCALIBRATED": "no calibration: forces are not measured",
    "HEALTH_DEVELOPMENT_KEY": "takes files signed with the public development key",
    "HEALTH_CAMERA_STALLED": "no frame comes: see the camera's cable and light",
    "HEALTH_LINK_DEGRADED": "frames from this host arrive damaged: see the cable",
    "HEALTH_STORE_ERROR": "the calibrations' medium has a problem: see above",
    "HEALTH_NO_REFERENCE": "rest is not learned yet",
    "HEALTH_SKIN_AGED": "the skin's light is a quarter off: calibrate it again",
    "HEALTH_TRIAL": "a new calibration is on trial",
    "HEALTH_NETWORK": "the learned network does not run",
    "HEALTH_REFLEX": "the reflex line cannot be set: see [reflex] of board.toml and the device's log",
    "HEALTH_THROTTLED": "the computer is short of power or too warm",
    "HEALTH_LATE": "results come late: the computer is too slow or too busy",
    "HEALTH_CRASHED": "the run before this one crashed",
    "HEALTH_SAFE_MODE": "three crashes in a row: no calibration is used, flash it again or restart the device",
    "HEALTH_ZERO_LIMIT": "rest has crept as far as it is followed: `ruffini cal zero` with nothing on the pad",
    "HEALTH_LIGHT": "the lamps are not as the board asks (dark, open, too hot): the device's log says what it is",
    "HEALTH_RATE": "half of the camera's frames are left out: the computer is too slow for all, or lowers its clock",
    "HEALTH_UNJUDGED": "the calibration in force failed its gates, or nobody has judged it: `ruffini cal fit`",
}
ENDS = {0: "stopped as it was asked to", 1: "crashed", 2: "was cut: power, or killed from outside"}


def health_words(names: list[str]) -> list[str]:
    """Words for the names of HealthBits; a name that this host does not know stands as it is."""
    return [HEALTH_WORDS.get(name, name) for name in names]


def part_of(status: Any, name: str) -> dict[str, int] | None:
    """Numbers of a message in STATUS by field; None: an older device does not send it."""
    if name not in status.DESCRIPTOR.fields_by_name or not status.HasField(name):
        return None
    part = getattr(status, name)
    return {field.name: getattr(part, field.name) for field in part.DESCRIPTOR.fields}


def time_words(status: Any) -> list[str]:
    """Latency that the device measured, and what protects its frame thread; empty: an older device."""
    if part_of(status, "scheduling") is None:
        return []
    place, late = status.scheduling, status.line_latency
    cpus = ",".join(str(i) for i in range(64) if place.cpus >> i & 1)
    words = [
        "frame thread: "
        + (f"real-time priority {place.priority}" if place.priority else "ordinary priority")
        + (f", CPU {cpus}" if cpus else ", any CPU")
        + (", memory locked" if place.is_memory_locked else ", memory not locked")
    ]
    if late.n_frames:
        named = {"p50": late.p50_us, "p99": late.p99_us, "p99.9": late.p999_us, "largest": late.max_us}
        shown = "  ".join(f"{name} {us / 1e3:.2f}" for name, us in named.items())
        words.append(f"latency up to the line: {shown} ms ({late.n_frames} frames of the last subscription)")
    return words


def left_out_words(status: Any) -> list[str]:
    """Frames that the device left out to keep an even rate; empty: none, or an older device."""
    n = getattr(status, "frames_left_out", 0)
    if not n:
        return []
    return [f"left out {n} frames: the computer was too slow for every frame, or had lowered its clock"]


def last_run_words(status: Any) -> str:
    """How the run before this one ended; empty: not known, or an older device."""
    if "last_run" not in status.DESCRIPTOR.fields_by_name or not status.HasField("last_run"):
        return ""
    last = status.last_run
    text = ENDS.get(last.end, "ended in a way that this host does not know")
    if last.signal:
        try:
            text += f" with {signal.Signals(last.signal).name}"
        except ValueError:
            text += f" with signal {last.signal}"
    if last.thread:
        text += f" in thread {last.thread}"
    if last.stuck:
        text += f", while thread {last.stuck} stood still"
    if last.uptime_us:
        text += f", after {last.uptime_us * 1e-6:.0f} s"
    if last.calibration_id:
        text += f", calibration {last.calibration_id.hex()}"
    return text + (f"; {last.crashes} crashes in a row" if last.crashes > 1 else "")
