"""The twin's pictures of a pressed ball beside videos of a real gel without markers and their load cell.

Every video's statistics stand beside the twin's, counted by the same functions over the gel's part of the picture and
over the rise to the largest force. Of one object, a rigid ball of known size, the twin is pressed where the real gel
was, to the same forces, and the two changes of the picture are compared pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.log.videos import VideoColumns, readings_of, recording_of, videos_in, zero_of_rest
from ruffini.errors import InputError
from ruffini.frames import read_frames
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Progress = Callable[[float], None]

CHANGED = 10.0  # grey levels of any channel: a dozen times the noise of the recorded cameras
SHARE_N = (5.0, 15.0)  # forces over which the share of changed pixels is averaged
LEAST_N = 0.5  # below, a load cell's own noise counts
SMOOTHED_PX = 2.0  # before two pictures are compared
RIM_PX = 25  # of the gel's edge, where light and mount change the picture whatever is pressed
BLOCK_PX = 8  # of JPEG
DEPTH_STEP_M = 0.05e-3
N_REST = 8  # untouched frames of the twin's film


class Film(NamedTuple):
    """Frames (t, h, w, 3) from rest to the largest force, their pressing force (t,) N; how many are untouched."""

    name: str
    frames: npt.NDArray[np.uint8]
    force: Array
    n_rest: int


class Statistics(NamedTuple):
    """Of one film: mean change of level a newton, noise of a pixel (3,); share of pixels changed; blockiness.

    blockiness : mean step between neighbours across the borders of 8 x 8 blocks over that inside; 1: not compressed.
    """

    change: Array
    changed: float
    noise: Array
    blockiness: float


def gel_mask(board: Board) -> Mask:
    """Pixels of the gel, by the corners of [picture_features].

    Raises
    ------
    InputError
        The board has none.
    """
    import cv2

    if board.picture_features is None:
        raise InputError(f"board {board.name!r} has no [picture_features]: its corners say where the gel is")
    mask = np.zeros((board.camera.height_px, board.camera.width_px), np.uint8)
    cv2.fillConvexPoly(mask, np.array(board.picture_features.corners_px, np.int32), 1)
    return mask > 0


def real_film(video: Path, board: Board, columns: VideoColumns) -> Film:
    """The closing of a video, less its load cell's zero; frames without a reading are left out."""
    frames = np.stack([np.asarray(image) for image in read_frames(video)])
    readings = readings_of(video, columns, len(frames))
    n_rest = board.pipeline.n_rest_frames
    force = np.where(readings.is_used, readings.force - zero_of_rest(readings, n_rest), np.nan)
    last = int(np.nanargmax(force)) + 1
    return Film(video.stem, frames[:last], force[:last], n_rest)


def statistics(film: Film, mask: Mask) -> Statistics:
    """Each as the class says; NaN where the film has no frame that tells it."""
    gel = film.frames[:, mask].astype(float)
    size = np.abs(gel - gel[: film.n_rest].mean(axis=0))
    mean = size.mean(axis=1) - size[: film.n_rest].mean(axis=(0, 1))
    with np.errstate(invalid="ignore"):
        pressed = film.force > LEAST_N
        middle = (film.force > SHARE_N[0]) & (film.force < SHARE_N[1])
    force = film.force[pressed]
    change = mean[pressed].T @ force / (force @ force) if pressed.any() else np.full(3, np.nan)
    changed = float((size[middle].max(axis=2) > CHANGED).mean()) if middle.any() else float("nan")
    noise = np.sqrt((np.diff(gel[: film.n_rest], axis=0) ** 2).mean(axis=(0, 1)) / 2)
    return Statistics(np.asarray(change), changed, np.asarray(noise), _blockiness(film.frames[0], mask))


def _blockiness(frame: npt.NDArray[np.uint8], mask: Mask) -> float:
    step = np.abs(np.diff(frame.astype(float), n=2, axis=1)).mean(axis=2)  # a smooth slope has none
    is_inside = mask[:, 1:-1]
    column = (np.arange(step.shape[1]) + 1) % BLOCK_PX
    across = np.isin(column, (BLOCK_PX - 1, 0))[None, :] & is_inside
    return float(step[across].mean() / max(step[is_inside & ~across].mean(), 1e-9))


def change_at_most(film: Film) -> Array:
    """Smoothed change of the picture at the largest force, (h, w, 3)."""
    import cv2

    rest = film.frames[: film.n_rest].mean(axis=0)
    return np.asarray(cv2.GaussianBlur(film.frames[-1] - rest, (0, 0), SMOOTHED_PX))


def inner(mask: Mask) -> Mask:
    """The gel without its rim."""
    import cv2

    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1))) > 0)


def contact_px(change: Array, mask: Mask) -> tuple[int, int]:
    """Column and row of the middle of what changed most, inside the gel's rim."""
    size = np.abs(change).max(axis=2) * inner(mask)
    rows, columns = np.nonzero(size > 0.5 * np.quantile(size[mask], 0.99))
    return round(float(np.median(columns))), round(float(np.median(rows)))


def twin_film(unit: TwinUnit, ball_mm: float, at_px: tuple[int, int], most_n: float) -> Film:
    """A rigid ball pressed into the twin until the force, or until its linear model ends."""
    renderer, rng = unit.renderer(), np.random.default_rng(0)
    seen = renderer.views[0]
    origin, way = (rays[at_px[1], at_px[0]].astype(float) for rays in (seen.origin, seen.direction))
    x_m, y_m = (origin - origin[2] / way[2] * way)[:2] * 1e-3
    frames, force = [renderer.image(unit.at_rest(), rng) for _ in range(N_REST)], [0.0] * N_REST
    solver, depth_m = unit.solver(Indenter("sphere", ball_mm / 2e3)), 0.0
    while force[-1] < most_n:
        depth_m += DEPTH_STEP_M
        try:
            solver.advance(Pose(float(x_m), float(y_m), depth_m))
        except InputError:
            break
        frames.append(renderer.image(solver.displacement, rng))
        force.append(-float(solver.nodal_force[:, 2].sum()))
    return Film(f"twin, ball of {ball_mm:g} mm", np.stack(frames), np.array(force), N_REST)


class Compared(NamedTuple):
    """A film, the twin's of the same ball at its place, and how their changes at the largest force correlate (3,)."""

    real: Film
    twin: Film
    correlation: Array
    size: Array  # RMS of the twin's change over the real one's, (3,)


def compare(real: Film, unit: TwinUnit, ball_mm: float, mask: Mask) -> Compared:
    """The twin at the real film's place and largest force, inside the gel's rim."""
    change = change_at_most(real)
    twin = twin_film(unit, ball_mm, contact_px(change, mask), float(np.nanmax(real.force)))
    inside = inner(mask)
    a, b = change[inside], change_at_most(twin)[inside]
    correlation = [np.corrcoef(a[:, c], b[:, c])[0, 1] for c in range(3)]
    return Compared(real, twin, np.array(correlation), np.sqrt((b**2).mean(axis=0) / (a**2).mean(axis=0)))


def run(
    folder: Path, board: Board, unit: TwinUnit, columns: VideoColumns, ball: tuple[str, float], out: Path | None,
    progress: Progress = lambda _: None,
) -> tuple[dict[str, Any], str]:  # fmt: skip
    """Numbers and text; `ball`: which object is a rigid ball, and its diameter in mm.

    Raises
    ------
    InputError
        No videos, none of that object, or pictures of another size.
    """
    mask, videos = gel_mask(board), videos_in([folder]).read
    name, ball_mm = ball
    names = sorted({recording_of(video, columns) for video in videos})
    if name not in names:
        raise InputError(f"--object {name!r}: there is no recording of it, only of {', '.join(names)}")
    rows, compared = list[tuple[str, Statistics]](), list[Compared]()
    for i, video in enumerate(videos):
        film = real_film(video, board, columns)
        if film.frames.shape[1:3] != mask.shape:
            raise InputError(f"{video}: pictures of {film.frames.shape[2]}x{film.frames.shape[1]}, the board's are "
                             f"{mask.shape[1]}x{mask.shape[0]}")  # fmt: skip
        rows.append((film.name, statistics(film, mask)))
        if recording_of(video, columns) == name:
            compared.append(compare(film, unit, ball_mm, mask))
            rows.append((f"{compared[-1].twin.name}, as {film.name}", statistics(compared[-1].twin, mask)))
        progress((i + 1) / len(videos))
    result: dict[str, Any] = {
        "board": board.name,
        "films": {row: {"levels_per_n": s.change.tolist(), "changed": s.changed, "noise": s.noise.tolist(),
                        "blockiness": s.blockiness} for row, s in rows},
        "compared": {c.real.name: {"correlation": c.correlation.tolist(), "size": c.size.tolist()} for c in compared},
    }  # fmt: skip
    text = _table(rows, compared)
    if out is not None:
        result["picture"] = str(side_by_side(out, compared))
        text += f"\n{out}"
    return result, text


def _table(rows: list[tuple[str, Statistics]], compared: list[Compared]) -> str:
    def three(values: Array, digits: int) -> str:
        return " ".join(f"{v:.{digits}f}" for v in values)

    heads = ("", "levels a newton, B G R", f"changed, {SHARE_N[0]:g} to {SHARE_N[1]:g} N", "noise, B G R", "blockiness")
    lines = aligned(heads, [
        (name, three(s.change, 2), f"{100 * s.changed:.0f} %", three(s.noise, 2), f"{s.blockiness:.2f}")
        for name, s in rows
    ])  # fmt: skip
    lines += [f"{c.real.name} and the twin at the largest force: correlation {three(c.correlation, 2)}, "
              f"size of the twin's change over the real one's {three(c.size, 2)}" for c in compared]  # fmt: skip
    return "\n".join(lines)


def side_by_side(path: Path, compared: list[Compared]) -> Path:
    """Of each pair a row: real picture and change, the twin's picture and change; grey is no change."""
    import cv2

    rows = []
    for pair in compared:
        films = [(film.frames[-1], 128 + 2 * change_at_most(film)) for film in (pair.real, pair.twin)]
        rows.append(np.hstack([np.clip(part, 0, 255).astype(np.uint8) for film in films for part in film]))
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.vstack(rows)):
        raise InputError(f"{path} cannot be written: check --out")
    return path
