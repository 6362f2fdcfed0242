"""Program `log`: records the sensor's stream while another program writes the reference to a CSV with its own clock.

The stream is stored on disk as it arrives; clocks and touches are determined once the CSV is available.
"""

from __future__ import annotations

import itertools
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError, RuffiniError
from ruffini.files import write_whole
from ruffini.rig.bench import Person
from ruffini.rig.clock import MIN_CORRELATION, ClockFit, fit_curved
from ruffini.rig.csv_log import Gauges, read_csv_log
from ruffini.rig.cutting import Cut, cut, tare_of
from ruffini.rig.found import estimate
from ruffini.rig.log_file import LogWriter
from ruffini.rig.reference import Reading
from ruffini.rig.stream_watch import KINDS, StreamWatch, Window
from ruffini.rig.touch import activity_of, faults_of, record_of
from ruffini.rig.window_file import packed, read_window

Array = npt.NDArray[np.float64]

CHUNK_S = 5.0
COARSE_S = 0.01
MIN_OVERLAP_S = 3.0
MOST_ALIKE = 0.999  # a single press that happens to fit is no surer than that
OTHER_S, OTHER_PART = 1.0, 0.6  # a shift so far from the best one, and what it may explain of what the best one does


class Joined(NamedTuple):
    """Result of joining a record: the touches kept, and the faults of those rejected."""

    n_touches: int
    faults: list[str]


def record(stream: StreamWatch, person: Person, log: LogWriter, session: str) -> None:
    """Store the stream while the person presses and another program writes; does nothing if it is stored already."""
    if _chunks(log):
        person.say(f"the stream is there already: reading the CSV (to record again, remove {log.side_file('')})")
        return
    stop, failed = threading.Event(), list[RuffiniError]()

    def keep() -> None:
        stream.take()  # of before the record
        for number in itertools.count():
            is_last = stop.wait(CHUNK_S)
            try:
                write_whole(log.side_file(f"stream-{number:04d}.npz"), packed(stream.take(), session))
                stream.latest()
            except RuffiniError as error:
                failed.append(error)
                return
            if is_last:
                return

    thread = threading.Thread(target=keep, name="keep the stream", daemon=True)
    thread.start()
    try:
        person.confirm("start the other program, press and let go at least six times, a second each, with different "
                       "forces and pauses, stop it")  # fmt: skip
    finally:
        stop.set()
        thread.join()
    if failed:
        raise failed[0]


def join(
    log: LogWriter, csv_path: Path, bad_flags: dict[int, str], *, longest_gap_s: float, gauges: Gauges | None = None
) -> Joined:
    """Touches of the stored stream, with the CSV's wrench on the host's clock; finishes the log.

    A CSV of voltages needs its `gauges`.

    Raises
    ------
    InputError
        The CSV cannot be read, has no times, or shows other presses; the stream is kept, and the same command can be
        repeated.
    """
    window, session = _kept(log)
    wrenches = read_csv_log(csv_path, gauges)
    wrench = wrenches.wrench - tare_of(str(csv_path), wrenches.wrench)
    stream_s = np.array([f.stream_s for f in window.frames])
    host_s = np.array([f.host_s for f in window.frames])
    size_n = np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1)
    fit = align(stream_s, _activity(window), wrenches.time_s, size_n)
    rough_s = float(np.median(host_s - stream_s))
    on_stream_s = fit.middle_s + (wrenches.time_s - fit.middle_s - fit.offset_s) / (1 + fit.drift)
    on_host_s = on_stream_s + rough_s
    faults, n = list[str](), 0
    for one in cut(str(csv_path), on_host_s, wrench):
        part, found = _touch(window, rough_s, on_host_s, wrench, one, session, bad_flags, longest_gap_s)
        if found:
            faults.append(f"touch at {one.held_s - on_host_s[0]:.1f} s: {'; '.join(found)}")
        else:
            log.write(n, part)
            n += 1
    if n == 0:
        raise InputError(f"{csv_path}: none of {len(faults)} touches is good: {faults[0]}")
    axes_missing = np.isnan(wrench).all(axis=0)
    reference = {"name": csv_path.name, "unit": "N", "sigma": np.where(axes_missing, 0, 5e-3).tolist()}
    clock = {"offset_s": fit.offset_s, "drift": fit.drift, "middle_s": fit.middle_s, "sigma_s": fit.offset_sigma_s}
    touches = list(log.touches().values())
    log.finish({"reference": reference, "csv_clock": clock, "faults": faults, **estimate(touches, reference)})
    return Joined(n, faults)


def align(stream_s: Array, stream_signal: Array, log_s: Array, log_n: Array) -> ClockFit:
    """Fit the CSV's clock to the stream's, for any offset between them.

    Raises
    ------
    InputError
        As `fit_curved`, or the presses fit in two ways.
    """
    rough_s = _rough_shift(stream_s, stream_signal, log_s, log_n)
    fit = fit_curved(stream_s + rough_s, stream_signal, log_s, log_n)
    return fit._replace(offset_s=fit.offset_s + rough_s, middle_s=fit.middle_s - rough_s)


def _rough_shift(stream_s: Array, signal: Array, log_s: Array, force_n: Array) -> float:
    """Shift, in steps of 10 ms, that best explains one record by the other where they overlap.

    For a correlation r over n samples, the log-likelihood gained over one of r_0 is n/2 log((1 - r_0^2) / (1 - r^2)).
    Neither r nor n alone is a measure: where only one press overlaps, any two presses are alike, and presses in even
    time are somewhat alike at many shifts; r_0 is therefore the least correlation that `fit_clock` accepts.

    Raises
    ------
    InputError
        Another shift explains them nearly as well.
    """
    from scipy.signal import correlate

    a, b = (np.interp(np.arange(t[0], t[-1], COARSE_S), t, v) for t, v in ((stream_s, abs(signal)), (log_s, force_n)))
    a, b = a - np.median(a), b - np.median(b)
    ones_a, ones_b = np.ones_like(a), np.ones_like(b)
    overlap = correlate(ones_b, ones_a, method="fft")
    energy = correlate(b**2, ones_a, method="fft") * correlate(ones_b, a**2, method="fft")
    alike = correlate(b, a, method="fft") / np.sqrt(np.maximum(energy, 1e-12 * max(float(energy.max()), 1e-30)))
    alike[overlap < min(MIN_OVERLAP_S / COARSE_S, 0.5 * min(len(a), len(b)))] = 0
    gained = overlap * np.log((1 - MIN_CORRELATION**2) / (1 - np.clip(alike, 0, MOST_ALIKE) ** 2))
    if gained.max() <= 0:  # nothing alike enough: `fit_clock` judges the most alike, and says so
        return float(log_s[0] + (int(alike.argmax()) - (len(a) - 1)) * COARSE_S - stream_s[0])
    best = int(gained.argmax())
    gained_by_others = np.where(abs(np.arange(len(gained)) - best) * COARSE_S > OTHER_S, gained, 0.0)
    other = int(gained_by_others.argmax())
    if gained_by_others[other] > OTHER_PART * gained[best]:
        raise InputError(
            f"the presses of the CSV fit the sensor's in two ways, {abs(best - other) * COARSE_S:.1f} s apart: record "
            "again, both from before the first press to after the last, with different forces and pauses"
        )
    return float(log_s[0] + (best - (len(a) - 1)) * COARSE_S - stream_s[0])


def _activity(window: Window) -> Array:
    """A signal that follows the load, in any unit: the sensor's normal force, or the motion of its markers."""
    force = np.array([f.wrench[2] for f in window.frames])
    if not np.isnan(force).any():
        return force
    activity = activity_of(window)
    if activity is None:
        raise InputError("the sensor measures neither force nor markers yet: its stream shows no touch to compare with "
                         "the CSV: use --program free with a reference that is read here")  # fmt: skip
    return activity


def _touch(
    window: Window, rough_s: float, on_host_s: Array, wrench: Array, one: Cut, session: str,
    bad_flags: dict[int, str], longest_gap_s: float,
) -> tuple[Any, list[str]]:  # fmt: skip
    """The stream's own times place it on the host's clock, since they jitter less than the times of arrival."""
    part = window.between(one.start_s - rough_s, one.end_s - rough_s)
    part = part._replace(frames=[f._replace(host_s=f.stream_s + rough_s) for f in part.frames])
    rows = np.flatnonzero((on_host_s > one.start_s) & (on_host_s < one.end_s))
    readings = [Reading(float(on_host_s[i]), wrench[i]) for i in rows]
    facts = {"kind": "log", "session": session, "touched_host_s": one.touched_s, "held_host_s": one.held_s,
             "lifted_host_s": one.lifted_s}  # fmt: skip
    made = record_of(part, readings, [], facts)
    return made, faults_of(made.arrays, facts, bad_flags, longest_gap_s=longest_gap_s)


def _chunks(log: LogWriter) -> list[Path]:
    return sorted(log.side_file(".").glob("stream-*.npz"))


def _kept(log: LogWriter) -> tuple[Window, str]:
    window, session = Window(*([] for _ in KINDS)), ""
    for path in _chunks(log):
        session = read_window(path, window)
    if not window.frames:
        raise InputError(f"{log.path}: no frame was kept: is the sensor streaming?")
    return window, session
