"""One page about a recording: forces with how sure they are, the field at its peak, contacts, rate, gaps, latency."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ruffini.api.frame import SensorFrame
from ruffini.api.sensor import node_places, sensor_info
from ruffini.calibrate.report.html import Page
from ruffini.device.results import NOT_MEASURED, VALID, Array
from ruffini.errors import InputError
from ruffini.record.export import chosen_sensor
from ruffini.record.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072b2", "#e69f00", "#009e73")  # x, y, z: told apart by any eye
NAMES = ("x", "y", "z")
WORDS = {"frames": "frames", "length_s": "length, s", "frames_per_s": "frames a second",
         "missing_frames": "missing frames",
         "valid_share": "share of frames with a valid wrench", "largest_force_n": "largest force, N",
         "median_latency_s": "from exposure to arrival, median, s", "line_lost": "times the line was lost"}  # fmt: skip
BROKEN = 3  # so many missing frames break a curve
MAX_POINTS = 20_000  # of a curve: more are not seen
ARROWS = 24  # in a row


@dataclass
class _Story:
    """What the figures show."""

    time_s: list[float] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)  # (6,), as sent
    validity: list[tuple[int, ...]] = field(default_factory=list)
    sigma: list[Array] = field(default_factory=list)
    n_contacts: list[float] = field(default_factory=list)
    area: list[float] = field(default_factory=list)
    slip_share: list[float] = field(default_factory=list)
    latency_s: list[float] = field(default_factory=list)
    n_missed: list[int] = field(default_factory=list)
    gaps: list[tuple[float, str]] = field(default_factory=list)
    flags: dict[str, int] = field(default_factory=dict)
    is_simulated: bool = False
    is_replay: bool = False
    peak: SensorFrame | None = None
    peak_n: float = -1.0


def plot(recording: Recording, out: Path, sensor: int | None = None) -> dict[str, Any]:
    """Write the page; returns what it says in numbers.

    Raises
    ------
    InputError
        No frame in it, or several sensors and no choice.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    sensor = chosen_sensor(recording, sensor)
    story = _read(recording, sensor)
    if not story.time_s:
        raise InputError(f"{recording.path}: has no frame of sensor {sensor}")
    info = sensor_info(recording.hello, sensor, str(recording.path))
    badges = [*(["SIMULATED"] if story.is_simulated else []), *(["REPLAY"] if story.is_replay else [])]
    page = Page(f"{recording.path.name}: {info.board} {recording.hello.device_serial} {' '.join(badges)}".strip())
    numbers = _numbers(story)
    page.table(
        ["", ""], [[words, "not known" if numbers[k] is None else str(numbers[k])] for k, words in WORDS.items()]
    )
    for text in recording.problems:
        page.text(text, "bad")
    page.heading("Force and moment ON the pad")
    page.text("Bands: two standard deviations, where the sensor states them. Grey: not valid, no number is shown. "
              "Red lines: the line was lost.")  # fmt: skip
    page.picture(_wrench_figure(story), f"force, largest {numbers['largest_force_n']} N, and moment over time")
    if story.peak is not None and story.peak.field is not None:
        page.heading("The field at its peak")
        nodes = node_places(info)
        page.picture(
            _field_figure(story.peak, nodes), f"normal force and shear at every node, frame {story.peak.number}"
        )
    page.heading("Contacts")
    page.picture(_contact_figure(story), "number of contacts, area of the largest, share of it that slips")
    page.heading("Rate, gaps and latency")
    page.picture(_rate_figure(story), "time between frames, frames that are missing, latency")
    if story.flags:
        page.heading("Flags")
        share = [[name, n, f"{100 * n / len(story.time_s):.1f} %"] for name, n in sorted(story.flags.items())]
        page.table(["flag", "frames", "of all"], share)
    page.write(out)
    return {"file": str(out), **numbers, "flags": story.flags, "problems": recording.problems}


def _read(recording: Recording, sensor: int) -> _Story:
    story, first_s = _Story(), None
    for frame in recording.frames(sensor, partial=True):
        wrench, contacts = frame.wrench, frame.contacts
        if frame.is_stale:
            continue  # said before
        first_s = frame.capture_s if first_s is None else first_s
        now_s = frame.capture_s - first_s
        story.time_s.append(now_s)
        unknown = np.full(6, np.nan)
        story.values.append(unknown if wrench is None else np.concatenate([wrench.force, wrench.torque]))
        story.validity.append((NOT_MEASURED,) * 6 if wrench is None else wrench.validity)
        story.sigma.append(unknown if wrench is None or wrench.sigma is None else wrench.sigma)
        first = contacts.contacts[0] if contacts is not None and contacts.contacts else None
        story.n_contacts.append(np.nan if contacts is None else len(contacts.contacts))
        story.area.append(np.nan if first is None or first.validity != VALID else first.area)
        story.slip_share.append(np.nan if first is None or first.slip_share is None else first.slip_share)
        arrived_ns, host_ns = recording.arrival_ns, frame.host_time_ns
        story.latency_s.append(np.nan if arrived_ns is None or host_ns is None else (arrived_ns - host_ns) * 1e-9)
        story.n_missed.append(frame.n_missed or 0)
        if frame.gap is not None:
            story.gaps.append((now_s, str(frame.gap)))
        for name in frame.flags:
            story.flags[name] = story.flags.get(name, 0) + 1
        story.is_simulated |= frame.is_simulated
        story.is_replay |= frame.is_replay
        if wrench is not None and frame.field is not None and (n := float(np.linalg.norm(wrench.force))) > story.peak_n:
            story.peak, story.peak_n = frame, n
    return story


def _numbers(story: _Story) -> dict[str, Any]:
    force = np.linalg.norm(np.array(story.values)[:, :3], axis=1)
    valid = _is_valid(story)
    length_s = story.time_s[-1]
    latency = np.array(story.latency_s)
    return {
        "frames": len(story.time_s), "length_s": round(length_s, 3),
        "frames_per_s": round((len(story.time_s) - 1) / length_s, 2) if length_s > 0 else None,
        "missing_frames": sum(story.n_missed), "valid_share": round(float(valid.mean()), 4),
        "largest_force_n": round(float(np.nanmax(force)), 4) if np.isfinite(force).any() else None,
        "median_latency_s": round(float(np.nanmedian(latency)), 4) if np.isfinite(latency).any() else None,
        "line_lost": len(story.gaps),
    }  # fmt: skip


def _is_valid(story: _Story) -> npt.NDArray[np.bool_]:
    """(n,): all that this board measures of the wrench is VALID."""
    validity = np.array(story.validity)
    measured = validity != NOT_MEASURED
    return np.asarray(((validity == VALID) | ~measured).all(axis=1) & measured.any(axis=1))


def _thinned(story: _Story) -> slice:
    return slice(None, None, max(len(story.time_s) // MAX_POINTS, 1))


def _shade(ax: Axes, story: _Story) -> None:
    """Grey where something is not valid, a line where the line was lost."""
    time_s, bad = np.array(story.time_s), ~_is_valid(story)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        ax.axvspan(time_s[begin], time_s[min(end, len(time_s) - 1)], color="#bbb", alpha=0.5, lw=0)
    for at_s, _ in story.gaps:
        ax.axvline(at_s, color="#b00020", lw=1)


def _wrench_figure(story: _Story) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.6), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    thin, at = _thinned(story), np.flatnonzero(np.array(story.n_missed) >= BROKEN)
    time_s = np.insert(story.time_s, at, np.array(story.time_s)[at])[thin]
    values, sigma = (np.insert(a, at, np.nan, axis=0)[thin] for a in (np.array(story.values), np.array(story.sigma)))
    for ax, first, scale, unit in ((axes[0], 0, 1.0, "force, N"), (axes[1], 3, 1e3, "moment, N mm")):
        _shade(ax, story)
        for i in range(3):
            value, band = scale * values[:, first + i], 2 * scale * sigma[:, first + i]
            ax.plot(time_s, value, color=COLOURS[i], lw=1, label=NAMES[i])
            if np.isfinite(band).any():
                ax.fill_between(time_s, value - band, value + band, color=COLOURS[i], alpha=0.2, lw=0)
        ax.set_ylabel(unit)
        ax.grid(alpha=0.3)
    axes[0].legend(loc="upper right", ncols=3)
    axes[1].set_xlabel("time on the sensor's clock, s")
    return figure


def _field_figure(frame: SensorFrame, nodes: Array) -> Any:
    from matplotlib.figure import Figure

    assert frame.field is not None
    force = 1e3 * frame.field.force
    x, y = 1e3 * nodes[..., 0], 1e3 * nodes[..., 1]
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    pressed = left.pcolormesh(x, y, -force[..., 2], cmap="viridis", shading="nearest")
    figure.colorbar(pressed, ax=left, label="pressing (-z), mN a node")
    left.set_title(f"normal force, frame {frame.number}")
    size = np.hypot(force[..., 0], force[..., 1])
    sheared = right.pcolormesh(x, y, size, cmap="cividis", shading="nearest")
    figure.colorbar(sheared, ax=right, label="shear, mN a node")
    step = max(x.shape[1] // ARROWS, 1)
    largest = np.nanmax(size) if np.isfinite(size).any() else 0.0
    if largest > 0:
        every = (slice(None, None, step), slice(None, None, step))
        # A large arrow is two steps of the nodes long.
        scale = largest / (2 * step * abs(x[0, 1] - x[0, 0]) if x.shape[1] > 1 else 1)
        right.quiver(x[every], y[every], force[..., 0][every], force[..., 1][every], color="white", angles="xy",
                     scale_units="xy", scale=scale, width=0.004)  # fmt: skip
    right.set_title("shear")
    for ax in (left, right):
        ax.set_aspect("equal")
        ax.set_xlabel("x, mm")
    left.set_ylabel("y, mm (down in the image)")
    left.invert_yaxis()
    return figure


def _contact_figure(story: _Story) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.8), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    thin = _thinned(story)
    time_s = np.array(story.time_s)[thin]
    rows = ((story.n_contacts, 1.0, "contacts"), (story.area, 1e6, "area of the\nlargest, mm²"),
            (story.slip_share, 1.0, "share of it\nthat slips"))  # fmt: skip
    for ax, (values, scale, label) in zip(axes, rows, strict=True):
        shown = scale * np.array(values)[thin]
        if np.isfinite(shown).any():
            ax.step(time_s, shown, where="post", color=COLOURS[0], lw=1)
        else:
            ax.text(0.5, 0.5, "not measured", transform=ax.transAxes, ha="center", va="center", color="#777")
        ax.set_ylabel(label)
        _shade(ax, story)
        ax.set_ylim(bottom=0)
        ax.grid(alpha=0.3)
    axes[2].set_xlabel("time on the sensor's clock, s")
    return figure


def _rate_figure(story: _Story) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.8), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    thin = _thinned(story)
    time_s = np.array(story.time_s)
    axes[0].plot(time_s[1:][thin], 1e3 * np.diff(time_s)[thin], ".", ms=2, color=COLOURS[0])
    axes[0].set_ylabel("between\nframes, ms")
    missed = np.array(story.n_missed)
    axes[1].vlines(time_s[missed > 0], 0, missed[missed > 0], color="#b00020", lw=1.5)
    axes[1].set_ylabel("frames that\nare missing")
    latency = 1e3 * np.array(story.latency_s)
    if np.isfinite(latency).any():
        axes[2].plot(time_s[thin], latency[thin], ".", ms=2, color=COLOURS[2])
    else:
        axes[2].text(0.5, 0.5, "not known: no clock in this recording", transform=axes[2].transAxes, ha="center",
                     va="center", color="#777")  # fmt: skip
    axes[2].set_ylabel("exposure to\narrival, ms")
    axes[2].set_xlabel("time on the sensor's clock, s")
    for ax in axes:
        ax.set_ylim(bottom=0)
        ax.grid(alpha=0.3)
        for at_s, _ in story.gaps:
            ax.axvline(at_s, color="#b00020", lw=1)
    return figure
