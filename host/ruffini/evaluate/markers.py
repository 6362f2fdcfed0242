"""The board's marker tracker on a recording, without a truth of its own: four tests that need none.

warp     the first frame moved by known fields (`warps`): error against the field, beside OpenCV's Lucas-Kanade
order    the recording with frames left out, backwards and shuffled: the same frame must give the same displacement
rest     the untouched frames before the first motion: what noise and codec make of a displacement of zero
identity no marker may come closer to a neighbour, or go farther from it, than a gel can stretch

Displacements count from the mean of the board's first `n_rest_frames` frames, in the warp test from the first frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.core import Pipeline
from ruffini.core.faults import faults
from ruffini.errors import InputError
from ruffini.evaluate.warps import Picture, Warp
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

N_FIELDS = 20
FIELD_SEED = 20_531
LARGEST_PX = 8.4
N_SHUFFLES = 5
STRETCH = (0.5, 1.5)  # of the distance between neighbours at rest
MOVED_PX = 0.15  # a frame in which a marker moved this far is touched
ASTRAY_PX = 1.0  # farther off is another place, not an inaccurate one: counted, and left out of the peer's RMS
LK_WINDOW_PX, LK_LEVELS = 21, 3


@dataclass(frozen=True)
class Tracks:
    """A tracked recording: displacement (n_frames, n_y, n_x, 2) px, and which markers were seen."""

    rest_px: Array
    moved_px: Array
    is_seen: Bools

    @property
    def largest_px(self) -> Array:
        """Largest displacement of a seen marker, frame by frame."""
        return np.asarray(np.where(self.is_seen, np.linalg.norm(self.moved_px, axis=-1), 0).max(axis=(1, 2)))

    @property
    def step_px(self) -> Array:
        """Largest motion of a marker since the frame before, where it was seen in both."""
        step = np.linalg.norm(np.diff(self.moved_px, axis=0), axis=-1)
        both = self.is_seen[1:] & self.is_seen[:-1]
        return np.concatenate([[0.0], np.where(both, step, 0).max(axis=(1, 2))])


def follow(board: Board, rest: Array, frames: Iterable[Picture]) -> Tracks:
    """Track frames in the order given, from `rest`, (h, w, 3) grey levels."""
    moved, seen = [], []
    with Pipeline(board) as pipeline:
        pipeline.set_rest(rest)
        for frame in frames:
            pipeline.process(frame)
            rest_px, displacement, state = pipeline.markers()
            moved.append(displacement)
            seen.append(state == 0)
    return Tracks(rest_px, np.array(moved), np.array(seen))


def _grey(picture: Picture) -> Any:
    import cv2

    return cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)


def lucas_kanade(still: Picture, moved: Picture, places_px: Array) -> tuple[Array, float]:
    """OpenCV's displacement of (n, 2) places, and its milliseconds on one thread, grey pictures given."""
    import cv2

    cv2.setNumThreads(1)
    first, second = _grey(still), _grey(moved)
    points = places_px.reshape(-1, 1, 2).astype(np.float32)
    start = time.perf_counter()
    found = cv2.calcOpticalFlowPyrLK(
        first, second, points, points.copy(), winSize=(LK_WINDOW_PX, LK_WINDOW_PX), maxLevel=LK_LEVELS
    )[0]
    spent_ms = (time.perf_counter() - start) * 1e3
    return np.asarray(found, dtype=float).reshape(-1, 2) - places_px, spent_ms


def _size(error: Array) -> dict[str, float]:
    length = np.linalg.norm(error, axis=-1)
    return {"rms_px": float(np.sqrt((length**2).mean())), "worst_px": float(length.max())}


def _astray(error: Array) -> dict[str, float]:
    """Size of the errors that are not beyond ASTRAY_PX, and how many are."""
    is_near = np.linalg.norm(error, axis=-1) <= ASTRAY_PX
    near = _size(error[is_near]) if is_near.any() else {"rms_px": float("nan"), "worst_px": float("nan")}
    return {"near_rms_px": near["rms_px"], "near_worst_px": near["worst_px"], "astray": int((~is_near).sum())}


def judge_warps(board: Board, first: Picture, n_fields: int = N_FIELDS) -> dict[str, Any]:
    """Errors on warps of the first frame; ours and Lucas-Kanade's on the markers that ours saw."""
    ours, theirs, ours_ms, theirs_ms, largest, n_lost = [], [], [], [], 0.0, 0
    with Pipeline(board) as pipeline:
        for field in range(n_fields):
            rng = np.random.default_rng([FIELD_SEED, field])
            warp = Warp.random(rng, (board.camera.width_px, board.camera.height_px), LARGEST_PX)
            moved = warp.render(first, rng)
            pipeline.set_rest(first)
            result = pipeline.process(moved)
            rest, displacement, state = pipeline.markers()
            seen = state == 0
            truth = warp.forward(rest[seen])
            peer, peer_ms = lucas_kanade(first, moved, rest[seen])
            ours.append(displacement[seen] - truth)
            theirs.append(peer - truth)
            ours_ms.append(result.stage_ns["markers"] * 1e-6)
            theirs_ms.append(peer_ms)
            largest = max(largest, float(np.linalg.norm(truth, axis=-1).max()))
            n_lost += int((state == 1).sum())
    return {
        "fields": n_fields, "largest_px": largest, "lost": n_lost,
        "ruffini": {**_size(np.concatenate(ours)), **_astray(np.concatenate(ours)), "ms": float(np.median(ours_ms))},
        "lucas_kanade": {**_astray(np.concatenate(theirs)), "ms": float(np.median(theirs_ms))},
    }  # fmt: skip


def orders(n_frames: int) -> dict[str, npt.NDArray[np.int_]]:
    """Ways to play a recording of n frames."""
    frames = np.arange(n_frames)
    ways = {"every 2nd": frames[::2], "every 4th": frames[::4], "backwards": frames[::-1]}
    for seed in range(N_SHUFFLES):
        ways[f"shuffled {seed}"] = np.random.default_rng([FIELD_SEED, seed]).permutation(n_frames)
    return ways


def judge_orders(
    board: Board, rest: Array, frames: list[Picture], straight: Tracks, progress: Callable[[float], None]
) -> dict[str, Any]:
    """Each way to play against straight play: worst difference, markers that are seen in one of both only."""
    result = {}
    ways = orders(len(frames))
    for done, (name, order) in enumerate(ways.items()):
        played = follow(board, rest, (frames[i] for i in order))
        both = played.is_seen & straight.is_seen[order]
        apart = np.linalg.norm(played.moved_px - straight.moved_px[order], axis=-1)
        result[name] = {
            "frames": len(order), "worst_px": float(np.where(both, apart, 0).max()),
            "beyond_0.05_px": int((both & (apart > 0.05)).sum()),
            "seen_in_one_only": int((played.is_seen ^ straight.is_seen[order]).sum()),
            "largest_step_px": float(played.step_px.max()),
        }  # fmt: skip
        progress((done + 1) / len(ways))
    return result


def judge_rest(tracks: Tracks) -> dict[str, Any]:
    """Displacement of the frames before the first motion; `sd_px` is about each marker's own mean."""
    touched = np.flatnonzero((tracks.largest_px > MOVED_PX) | ~tracks.is_seen.any(axis=(1, 2)))
    n = int(touched[0]) if touched.size else len(tracks.moved_px)
    if n < 2:
        return {"frames": n}
    seen = tracks.is_seen[:n].all(axis=0)
    still = tracks.moved_px[:n][:, seen]
    return {"frames": n, **_size(still), "rms_axis_px": float(np.sqrt((still**2).mean())),
            "sd_px": float(np.sqrt(still.var(axis=0).sum(axis=-1).mean()))}  # fmt: skip


def judge_identity(tracks: Tracks) -> dict[str, Any]:
    """Distances between neighbours over those at rest, and frames in which one leaves `STRETCH`."""
    place = tracks.rest_px + tracks.moved_px
    extremes, is_wrong = [], np.zeros(len(place), dtype=bool)
    for axis in (0, 1):
        at_rest = np.linalg.norm(np.diff(tracks.rest_px, axis=axis), axis=-1)
        distance = np.linalg.norm(np.diff(place, axis=axis + 1), axis=-1) / at_rest
        seen = np.take(tracks.is_seen, np.arange(1, place.shape[axis + 1]), axis=axis + 1)
        seen = seen & np.take(tracks.is_seen, np.arange(place.shape[axis + 1] - 1), axis=axis + 1)
        extremes += [float(distance[seen].min()), float(distance[seen].max())]
        is_wrong |= (seen & ((distance < STRETCH[0]) | (distance > STRETCH[1]))).any(axis=(1, 2))
    return {"nearest": min(extremes), "farthest": max(extremes), "torn_frames": np.flatnonzero(is_wrong).tolist()}


def evaluate(
    board: Board, frames: list[Picture], *, n_fields: int = N_FIELDS, progress: Callable[[float], None] = lambda _: None
) -> tuple[dict[str, Any], Tracks]:
    """All four tests on a recording; the result for `--json`, and the tracks for the picture.

    Raises
    ------
    InputError
        The board has no markers, too few frames, frames of several sizes, none of the board's markers at rest.
    """
    if not board.writes("markers") or board.markers is None:
        raise InputError(f"board {board.name!r} follows no markers: nothing to judge")
    n_rest = board.pipeline.n_rest_frames
    if len(frames) <= n_rest:
        raise InputError(f"{len(frames)} frames: board {board.name!r} learns rest from {n_rest}, more are needed")
    expected = (board.camera.height_px, board.camera.width_px, 3)
    odd = next((i for i, frame in enumerate(frames) if frame.shape != expected), None)
    if odd is not None:
        height, width = frames[odd].shape[:2]
        raise InputError(f"frame {odd} is {width}x{height}, board {board.name!r} needs {board.resolution}")
    rest = np.mean([frame.astype(float) for frame in frames[:n_rest]], axis=0)
    tracks = follow(board, rest, frames)
    n_at_rest = _markers_at_rest(board, rest, frames[0], n_rest)
    result = {
        "board": board.name, "frames": len(frames), "markers_at_rest": n_at_rest,
        "warp": judge_warps(board, frames[0], n_fields),
        "rest": judge_rest(tracks), "identity": judge_identity(tracks),
        "order": judge_orders(board, rest, frames, tracks, progress),
        "largest_px": tracks.largest_px.round(3).tolist(), "step_px": tracks.step_px.round(3).tolist(),
        "lost": (~tracks.is_seen).sum(axis=(1, 2)).tolist(),
    }  # fmt: skip
    return result, tracks


def _markers_at_rest(board: Board, rest: Array, frame: Picture, n_rest: int) -> int:
    with Pipeline(board) as pipeline:
        pipeline.set_rest(rest)
        result = pipeline.process(frame)
        n = pipeline.layout.marker_n_x * pipeline.layout.marker_n_y
    if result.n_markers_at_rest == 0:
        raise InputError(f"no markers of board {board.name!r} in the first {n_rest} frames: is it the right board?")
    wrong = faults(result.flags)
    if wrong:
        raise InputError(
            f"the first frames cannot be judged: {', '.join(wrong)} ({result.n_markers_at_rest} of the {n} markers of "
            f"board {board.name!r} found at rest): is it the right board and resolution?"
        )
    return result.n_markers_at_rest


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    warp, rest, identity = result["warp"], result["rest"], result["identity"]
    lines = [
        f"{result['board']}: {result['frames']} frames, {result['markers_at_rest']} markers at rest",
        f"first frame moved by {warp['fields']} known fields, up to {warp['largest_px']:.1f} px, {warp['lost']} lost",
        *aligned(("", "RMS px", "worst px", "beyond 1 px, left out", "median ms"), [
            (label, f"{row['near_rms_px']:.4f}", f"{row['near_worst_px']:.4f}", row["astray"], f"{row['ms']:.3f}")
            for label, row in (("ruffini", warp["ruffini"]), ("OpenCV Lucas-Kanade", warp["lucas_kanade"]))
        ]),
    ]  # fmt: skip
    lines.append(f"untouched: {rest['frames']} frames" + (
        f", RMS {rest['rms_px']:.4f} px ({rest['rms_axis_px']:.4f} an axis), worst {rest['worst_px']:.4f}; "
        f"noise about each marker's own mean {rest['sd_px']:.4f} px" if "rms_px" in rest else ", too few to judge"
    ))  # fmt: skip
    lines.append(
        f"identity: neighbours at {identity['nearest']:.2f} to {identity['farthest']:.2f} of their distance at rest, "
        f"torn in {len(identity['torn_frames'])} frames"
    )
    head = ("played otherwise", "frames", "worst px", "beyond 0.05 px", "seen in one only", "largest step px")
    lines += aligned(head, [
        (name, row["frames"], f"{row['worst_px']:.4f}", row["beyond_0.05_px"], row["seen_in_one_only"],
         f"{row['largest_step_px']:.2f}")
        for name, row in result["order"].items()
    ])  # fmt: skip
    lines.append("frame: largest displacement px (largest step since the frame before)")
    pairs = [f"{d:6.2f} ({s:5.2f})" for d, s in zip(result["largest_px"], result["step_px"], strict=True)]
    lines += [f"{i:5d}: " + " ".join(pairs[i : i + 8]) for i in range(0, len(pairs), 8)]
    return "\n".join(lines)
