"""The first pictures of a simulated sensor, by what its stages measure.

| the board measures | picture |
| --- | --- |
| forces at nodes | the field over the camera image, beside its truth |
| contacts | the camera image with their places, and these over the true force of the body; a tube's skin unrolled |
| depth | its map and its deepest row, with the truth; beside the camera image, if no other picture shows it |

The wrench over time is drawn by the main job for every board.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.demo.pictures import Touched, depth_map, field_over_frame, touches_on_body
from ruffini.demo.view import depth_places, node_pixels, node_places
from ruffini.device.results import Contact
from ruffini.frames import read_frames
from ruffini.sim.optics.camera import View
from ruffini.sim.optics.charts import chart_of
from ruffini.sim.optics.settings import ViewSettings
from ruffini.sim.settings import TwinSettings, load_twin

Array = npt.NDArray[np.float64]
BESIDE_M = 0.02  # contacts nearer to each other than this have one label
Results = dict[str, dict[int, Any]]  # of the line, by message and frame


def pictures_of_twin(board: Board, out: Path, results: Results, truth: dict[str, Any], badge: str) -> list[Path]:
    """Draw what a board measured of its twin's recording `out`/recording; `badge` begins every title.

    `truth` is the recording's, its wrench as the board defines it.
    """
    pictures = []
    if board.writes("node_forces"):
        pictures.append(_field(board, out, results, truth, badge))
    elif board.writes("contacts"):
        pictures.append(_touches(board, out, results, truth, badge))
    depths = [depth for depth in results["DEPTH"].values() if np.isfinite(depth.depth).any()]
    if depths:
        deepest = min(depths, key=lambda depth: depth.depth.min())
        pictures.append(depth_map(
            out / "depth.png", deepest.depth * 1e6, title=f"{badge}: depth at {_time(truth, deepest.frame)}",
            frame_bgr=None if pictures else _image(out, deepest.frame),
            place_mm=depth_places(board, deepest.depth, deepest.step_px) * 1e3,
            truth=_true_surface(board, truth, deepest.frame),
        ))  # fmt: skip
    return pictures


def _time(truth: dict[str, Any], frame: int) -> str:
    return f"{truth['time_s'][frame]:.2f} s (frame {frame})"


def _image(out: Path, frame: int) -> npt.NDArray[np.uint8]:
    return next(islice(read_frames(out / "recording"), frame, None))


def _field(board: Board, out: Path, results: Results, truth: dict[str, Any], badge: str) -> Path:
    frame = max(results["FIELD"], key=lambda i: float(np.hypot(*truth["wrench"][i, :2])))
    rows, columns = board.observed
    is_normal = "force_z" not in board.board.not_measured
    return field_over_frame(
        out / "field.png", _image(out, frame), node_pixels(board), node_places(board),
        results["FIELD"][frame].raw_force, z_calibrated=is_normal,
        title=f"{badge}: force field at {_time(truth, frame)}" + ("" if is_normal else ", shear only"),
        truth_n=truth["force"][frame][rows, columns].astype(float),
    )  # fmt: skip


def _touches(board: Board, out: Path, results: Results, truth: dict[str, Any], badge: str) -> Path:
    """The frame of the largest force; of a tube, whose touches are far from each other, that of every touch."""
    twin, found = load_twin(board), results["CONTACTS"]
    is_unrolled = twin.shape.kind == "tube"
    size = np.abs(truth["wrench"][:, 2])
    told = [i for i, message in found.items() if any(np.isfinite(c.force).any() for c in message.contacts)]
    strongest = max(told or found, key=lambda i: float(size[i]))
    frames = [strongest]
    if is_unrolled and told:
        numbers = {int(truth["touch"][i]) for i in told} - {-1}
        frames = [max((i for i in told if truth["touch"][i] == k), key=lambda i: float(size[i])) for k in numbers]
        frames = frames or [strongest]
    touches = [touch for i in frames for touch in _beside_truth(board, found[i].contacts, truth["force"][i])]
    places = np.array([contact.center for contact in found[strongest].contacts]).reshape(-1, 2) * 1e3
    return touches_on_body(
        out / "contacts.png", _image(out, strongest), np.sum([truth["force"][i].astype(float) for i in frames], axis=0),
        (board.pad.size_x_um * 1e-3, board.pad.size_y_um * 1e-3), touches,
        title=f"{badge}: touches", frame_title=f"camera at {_time(truth, strongest)}",
        touches_px=_pixels(board, twin, places), 
        is_unrolled=is_unrolled,
    )  # fmt: skip


def _beside_truth(board: Board, contacts: Sequence[Contact], force_n: Array) -> list[Touched]:
    """Contacts with the true force of the nodes that are nearest to each; neighbours share one number."""
    n_y, n_x = force_n.shape[:2]
    size_mm = np.array([board.pad.size_x_um, board.pad.size_y_um]) * 1e-3
    x_mm, y_mm = np.meshgrid(*(np.linspace(-0.5, 0.5, n) * size for n, size in zip((n_x, n_y), size_mm, strict=True)))
    groups: list[list[Contact]] = []
    for contact in contacts:
        near = [g for g in groups if any(math.dist(contact.center, c.center) < BESIDE_M for c in g)]
        groups = [g for g in groups if g not in near] + [[contact, *(c for g in near for c in g)]]
    apart = [np.min([np.hypot(x_mm - 1e3 * c.center[0], y_mm - 1e3 * c.center[1]) for c in g], axis=0) for g in groups]
    out = []
    for i, group in enumerate(groups):
        told = [np.nan_to_num(c.force) for c in group if np.isfinite(c.force).any()]
        force = np.sum(told, axis=0) if told else np.full(3, np.nan)
        true = force_n[np.argmin(apart, axis=0) == i].sum(axis=0)
        places = [(1e3 * c.center[0], 1e3 * c.center[1]) for c in group]
        out.append(Touched(places, float(np.linalg.norm(force)), float(np.linalg.norm(true))))
    return out


def _pixels(board: Board, twin: TwinSettings, places_mm: Array) -> Array:
    """Where each view sees places of the undeformed body, (n, 2) pixels of the whole frame."""
    if twin.shape.kind == "dome":
        radius = twin.shape.radius_um * 1e-3
        rise = np.sqrt(np.maximum(radius**2 - (places_mm**2).sum(axis=1), 0.0)) - radius
        points = np.column_stack([places_mm, rise])
    else:
        points = np.asarray(chart_of(twin.shape).points(*places_mm.T), np.float64)
    views = twin.view or [ViewSettings()]
    seen = []
    for i, settings in enumerate(views):
        view = View(board, settings, twin.lens, len(views), twin.gel.index_1e3 * 1e-3 if twin.gel else 1.0)
        seen.append(view.project(points)[0] + [i * view.width_px, 0])
    return np.concatenate(seen)


def _true_surface(board: Board, truth: dict[str, Any], frame: int) -> tuple[Array, Array]:
    """Where the simulated nodes are now, (n_y, n_x, 2) mm from the pad's centre, and their u_z, micrometres."""
    x = np.linspace(-0.5, 0.5, board.grid.n_x) * board.pad.size_x_um * 1e-3
    y = np.linspace(-0.5, 0.5, board.grid.n_y) * board.pad.size_y_um * 1e-3
    moved = truth["displacement"][frame]
    return np.stack(np.meshgrid(x, y), axis=-1) + moved[..., :2] * 1e3, moved[..., 2] * 1e6
