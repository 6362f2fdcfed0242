"""One touch as it is kept: what arrived while it lasted, cut and looked at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ruffini.rig.guarded_stage import CONTACT_N
from ruffini.rig.log_file import ACTIVITY, CONTACT_SHORE, MOTION, TouchRecord
from ruffini.rig.program import HOLD_S
from ruffini.rig.reference import Reading
from ruffini.rig.stage import Place
from ruffini.rig.stream_watch import StreamSample, Window

Array = npt.NDArray[np.float64]
Arrays = dict[str, npt.NDArray[Any]]
T = TypeVar("T")

LONGEST_GAP_S = 0.3  # without a frame
MIN_FRAMES, MIN_READINGS = 5, 3  # while it is held
TWISTED = "condition"  # kind of touch that may have a moment and no force
SEEN_PART = 0.1  # of the reference's force: a sensor that is yet to be calibrated sees more than that
FREE_N = CONTACT_N / 2  # of the reference after the tip was lifted
FIELDS_KEPT, IMAGES_KEPT = 4, 4  # of a hold: they are all alike
REST_IMAGES_KEPT = 4  # if there is one at every step of an indenter
WAY_IMAGES_KEPT = 8  # between the contact and the hold, if nothing else is kept of it
REST_FIELDS_KEPT = 8  # of before it: 16 touches then tell the noise of the untouched pad
MARKERS_KEPT = 40
FREE_FEATURES_KEPT, FEATURES_KEPT = 10, 40  # before the contact and from it on: the forces on the way count, too
FEATURE_STEPS = 65536.0
MOTIONS = 3  # ways of moving that are kept: as many as a force has axes


def record_of(
    window: Window, readings: Sequence[Reading], path: Sequence[tuple[float, Place]], facts: dict[str, Any]
) -> TouchRecord:
    """What arrived since the touch began; `facts` says when it was held.

    Frames that queued on their way get the host's time at which they would have arrived without.
    """
    delay_s = least_delay_s(window.frames)
    window = window._replace(frames=[f._replace(host_s=f.stream_s + delay_s) for f in window.frames])
    arrays = {
        **_stream_arrays(window.frames), **_activity(window), **_contacts(window), **_kept(window, facts),
        "reference_s": np.array([r.host_s for r in readings]),
        "reference_wrench": np.array([r.wrench for r in readings]).reshape(-1, 6),
        "stage_s": np.array([t for t, _ in path]), "stage_place": np.array([p for _, p in path]).reshape(-1, 3),
    }  # fmt: skip
    more = {"image_step_px": window.images[-1].step_px} if "image" in arrays else {}
    return TouchRecord({**facts, **more}, _rising(arrays))


def least_delay_s(frames: Sequence[StreamSample]) -> float:
    """Host's time of arrival less the sensor's time, of the frame that was fastest."""
    return min((f.host_s - f.stream_s for f in frames), default=0.0)


def faults_of(
    arrays: Arrays, facts: dict[str, Any], bad_flags: dict[int, str], *, longest_gap_s: float = LONGEST_GAP_S
) -> list[str]:
    """What is wrong with a touch, in words; nothing where it is good."""
    host_s, flags = arrays["stream_host_s"], arrays["stream_flags"]
    is_held = (host_s > facts["held_host_s"]) & (host_s < facts["lifted_host_s"])
    found = []
    if is_held.sum() < MIN_FRAMES:
        found.append(f"{is_held.sum()} frames while it was held, {MIN_FRAMES} are needed")
    if len(host_s) > 1 and np.diff(host_s).max() > longest_gap_s:
        found.append(f"no frame for {np.diff(host_s).max():.2f} s")
    found += [name for bit, name in bad_flags.items() if (flags[is_held] & bit).any()]
    reference_s, wrench = arrays["reference_s"], arrays["reference_wrench"]
    is_seen = (reference_s > facts["held_host_s"]) & (reference_s < facts["lifted_host_s"])
    if is_seen.sum() < MIN_READINGS:
        return [*found, f"{is_seen.sum()} readings of the reference while it was held, {MIN_READINGS} are needed"]
    if facts.get("is_saturated"):
        found.append("the reference was saturated")
    pressed = np.nan_to_num(wrench[is_seen, :3].mean(axis=0))
    pressed_n = float(np.linalg.norm(pressed))
    if pressed_n < CONTACT_N and facts.get("kind") != TWISTED:
        found.append(f"the reference saw only {pressed_n:.3f} N")
    seen = arrays["stream_wrench"][is_held, :3].mean(axis=0) if is_held.any() else np.full(3, np.nan)
    is_measured = np.isfinite(seen)  # a skin measures what is out of it, z, alone
    seen_n, of_n = float(np.linalg.norm(seen[is_measured])), float(np.linalg.norm(pressed[is_measured]))
    if of_n > pressed_n / 2 and seen_n < SEEN_PART * of_n:  # what is left of a press sideways tells nothing
        found.append(f"the sensor saw {seen_n:.3f} N of {of_n:.3f} N: is it this pad that was pressed?")
    left_n = float(np.linalg.norm(np.nan_to_num(wrench[-1, :3])))
    if left_n > FREE_N:
        found.append(f"{left_n:.3f} N stayed after the tip was lifted: the reference drifted, or the tip sticks")
    return found


def _stream_arrays(samples: list[StreamSample]) -> Arrays:
    return {
        "stream_s": np.array([s.stream_s for s in samples]), "stream_host_s": np.array([s.host_s for s in samples]),
        "stream_frame": np.array([s.frame for s in samples], np.int64),
        "stream_flags": np.array([s.flags for s in samples], np.int64),
        "stream_wrench": np.array([s.wrench for s in samples]).reshape(-1, 6),
        "stream_validity": np.array([s.validity for s in samples], np.int64).reshape(-1, 6),
    }  # fmt: skip


def _moved(window: Window) -> tuple[list[float], Array]:
    """Times, and what has moved from rest (t, n, k): markers in px, or on a gel without them the features."""
    if window.markers:
        return [m.stream_s for m in window.markers], np.array([m.displacement[:, :2] for m in window.markers])
    rows = np.array([f.value for f in window.features], np.float64)
    return [f.stream_s for f in window.features], rows[..., None] / FEATURE_STEPS


def activity_of(window: Window) -> Array | None:
    """How far the markers moved on the average in each frame: what is pressed shows where no force is measured."""
    when, moved = _moved(window)
    if not when:
        return None
    activity: Array = np.linalg.norm(moved, axis=2).mean(axis=1)
    return np.interp([f.stream_s for f in window.frames], when, activity)


def motion_of(window: Window) -> Array | None:
    """The markers' motion in the ways in which they moved most in this time, strongest first, (t, MOTIONS).

    To first order these follow the axes of a load, up and down, which a mean length does not.
    """
    of_s, moved = _moved(window)
    if len(of_s) <= MOTIONS:
        return None
    moved = (moved - moved[0]).reshape(len(moved), -1)
    u, s, _ = np.linalg.svd(moved / np.sqrt(moved.shape[1]), full_matrices=False)
    when = [f.stream_s for f in window.frames]
    return np.stack([np.interp(when, of_s, column) for column in (u * s).T[:MOTIONS]], axis=1)


def _activity(window: Window) -> Arrays:
    found = {ACTIVITY: activity_of(window), MOTION: motion_of(window)}
    return {name: values for name, values in found.items() if values is not None}


def _contacts(window: Window) -> Arrays:
    """Every contact of every frame, one row each."""
    rows = window.contacts
    if not rows:
        return {}
    return {
        "contact_s": np.array([c.stream_s for c in rows]), "contact_number": np.array([c.number for c in rows]),
        "contact_place": np.array([c.place for c in rows]), "contact_force": np.array([c.force_n for c in rows]),
        "contact_sigma": np.array([c.sigma for c in rows]), CONTACT_SHORE: np.array([c.shore_a for c in rows]),
    }  # fmt: skip


def _kept(window: Window, facts: dict[str, Any]) -> Arrays:
    """The dense results: a few of the hold, and a few of before the contact. Fields as a usual hold ends, however long
    this one is: rubber forgets, and all touches are to have the same age."""
    held = {s.stream_s for s in window.frames if facts["held_host_s"] < s.host_s < facts["lifted_host_s"]}
    free = {s.stream_s for s in window.frames if s.host_s < facts["touched_host_s"]}
    young = {s.stream_s for s in window.frames if s.stream_s in held and s.host_s < facts["held_host_s"] + HOLD_S}
    out: Arrays = {}
    for prefix, when, n in (("field", held, FIELDS_KEPT), ("rest_field", free, REST_FIELDS_KEPT)):
        all_of_it = [f for f in window.fields if f.stream_s in when]
        fields = [f for f in all_of_it if f.stream_s in young][-n:] if prefix == "field" else all_of_it[-n:]
        fields = fields if len(fields) == n else all_of_it[:n]
        if fields:
            out[f"{prefix}_s"] = np.array([f.stream_s for f in fields])
            out[f"{prefix}_displacement"] = np.array([f.displacement for f in fields], np.float32)
    markers = _spread([m for m in window.markers if m.stream_s in held | free], MARKERS_KEPT)
    if markers:
        out["marker_s"] = np.array([m.stream_s for m in markers])
        out["marker_displacement"] = np.array([m.displacement for m in markers], np.float32)
        places = [m.place for m in markers if m.place is not None]
        out.update({"marker_place": places[-1]} if places else {})
    features = _spread([f for f in window.features if f.stream_s in free], FREE_FEATURES_KEPT)
    features += _spread([f for f in window.features if f.stream_s not in free], FEATURES_KEPT)
    if features:
        out["feature_s"] = np.array([f.stream_s for f in features])
        out["feature"] = np.array([f.value for f in features])
    n_free = REST_IMAGES_KEPT if facts.get("is_pictured") else 1
    images = [i for i in window.images if i.stream_s in free][-n_free:]
    if not (window.fields or markers or features):  # what rubber forgets follows from how the force grew
        way = {s.stream_s for s in window.frames if facts["touched_host_s"] < s.host_s <= facts["held_host_s"]}
        images += _spread([i for i in window.images if i.stream_s in way], WAY_IMAGES_KEPT)
    of_hold = [i for i in window.images if i.stream_s in held]
    images += of_hold if facts.get("is_pictured") else _spread(of_hold, IMAGES_KEPT - 1)
    if images:
        out["image_s"] = np.array([i.stream_s for i in images])
        out["image"] = np.array([i.pixels for i in images])
    return out


def _spread(samples: list[T], n: int) -> list[T]:
    """At most n of them, evenly."""
    return samples if len(samples) <= n else [samples[i] for i in np.linspace(0, len(samples) - 1, n).astype(int)]


def _rising(arrays: Arrays) -> Arrays:
    """Readings that came in one batch carry one host time: the last of each batch stays."""
    time_s = arrays["reference_s"]
    keep = np.append(np.diff(time_s) > 0, True) if len(time_s) else np.zeros(0, bool)
    return {k: v[keep] if k.startswith("reference_") else v for k, v in arrays.items()}
