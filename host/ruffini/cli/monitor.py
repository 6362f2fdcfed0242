"""`ruffini monitor`, and a frame as a line of text or JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import RESUME_S, ResumeOption, Settings, note, printable

if TYPE_CHECKING:
    from ruffini.api import SensorFrame
    from ruffini.device import Contacts, Learned


def monitor(
    n: Annotated[int, typer.Option("--n", min=0, help="Stop after so many frames (0 = never).")] = 0,
    resume: ResumeOption = RESUME_S,
    json_: Annotated[bool, typer.Option("--json", help="One JSON object per line and frame.")] = False,
) -> None:
    """The wrench as it comes, how near the largest contact is to sliding, and what a learned network last said."""
    import itertools

    from ruffini.api import connect

    with connect(Settings.port, Settings.serial, field=0, depth=0, resume_s=resume, on_note=note) as sensor:
        for frame in itertools.islice(sensor.frames(partial=True), n or None):
            show(frame, as_json=json_)


def show(frame: SensorFrame, *, as_json: bool) -> None:
    """One frame, on stdout."""
    if frame.wrench is None:
        return
    end = "\r" if sys.stdout.isatty() and not as_json else "\n"
    print(json.dumps(_told(frame)) if as_json else printable(_line(frame)).ljust(150), end=end, flush=True)


def _told(frame: SensorFrame) -> dict[str, Any]:
    wrench = frame.wrench
    assert wrench is not None
    return {
        "frame": frame.number, "capture_s": frame.capture_s, "host_time_ns": frame.host_time_ns,
        "host_time_error_ns": frame.host_time_error_ns, "wrench": _numbers(wrench.values),
        "sigma": None if wrench.sigma is None else wrench.sigma.tolist(),
        "covariance": None if wrench.covariance is None else wrench.covariance.tolist(),
        "sigma_validity": wrench.covariance_validity, "validity": list(wrench.validity), "flags": list(frame.flags),
        "contacts": None if frame.contacts is None else _contacts(frame.contacts),
        "learned": None if frame.learned is None else asdict(frame.learned), "missed": frame.n_missed,
        "simulated": frame.is_simulated, "replay": frame.is_replay,
    }  # fmt: skip


def _numbers(values: Any) -> list[float | None]:
    """For JSON, which has no NaN."""
    return [None if v != v else v for v in values.tolist()]


def _contacts(contacts: Contacts) -> dict[str, Any]:
    """`force`, `skin` and `tool` have no number where it is not valid; the raw ones are as sent."""
    told: dict[str, Any] = asdict(contacts)
    for row, contact in zip(told["contacts"], contacts.contacts, strict=True):
        row["force"] = contact.force.tolist()
        row["skin"], row["tool"] = (part and asdict(part) for part in (contact.skin, contact.tool))
    plain: dict[str, Any] = _plain(told)
    return plain


def _plain(value: Any) -> Any:
    """The same with None in place of NaN."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return None if value != value else value


def _line(frame: SensorFrame) -> str:
    wrench = frame.wrench
    assert wrench is not None
    fx, fy, fz = wrench.values[:3]
    tx, ty, tz = wrench.values[3:] * 1e3
    tags = (["SIMULATED"] if frame.is_simulated else []) + (["REPLAY"] if frame.is_replay else [])
    force_sigma, torque_sigma = _plus_minus(wrench.sigma)
    return (f"{frame.number:6d}  F {fx:8.3f} {fy:8.3f} {fz:8.3f}{force_sigma} N   "
            f"T {tx:8.3f} {ty:8.3f} {tz:8.3f}{torque_sigma} N mm"
            f"{_slip(frame.contacts)}{_learned(frame.learned)} {' '.join([*tags, *frame.flags])}")  # fmt: skip


def _slip(contacts: Contacts | None) -> str:
    """State of the largest contact, its shear ratio against the friction, and what it still takes."""
    if contacts is None or not contacts.contacts or contacts.contacts[0].slip_state is None:
        return ""
    c = contacts.contacts[0]
    known = "?" if c.friction is None else f"{c.friction:.2f} +- {c.friction_sigma:.2f}"
    left = "" if c.slip_margin_n is None else f", {c.slip_margin_n:.2f} N left"
    return f" {c.slip_state} {c.shear_ratio:.2f}/{known}{left}"


def _learned(learned: Learned | None) -> str:
    """What the network said of an earlier frame, and how late and how often it does."""
    if learned is None:
        return ""
    said = " ".join(f"{name} {value}" for name, value in learned.quantities.items()) if learned.is_valid else "invalid"
    return f" | network: {said} of frame {learned.frame}, {1e3 * learned.latency_s:.0f} ms, {learned.rate_hz:.1f} Hz"


def _plus_minus(sigma: Any) -> tuple[str, str]:
    """Standard deviations behind force and moment, "+-?" where they are not measured."""
    if sigma is None:
        return " +-?", " +-?"
    force, torque = sigma[:3], sigma[3:] * 1e3
    return f" +- {force[0]:.3f} {force[1]:.3f} {force[2]:.3f}", f" +- {torque[0]:.3f} {torque[1]:.3f} {torque[2]:.3f}"
