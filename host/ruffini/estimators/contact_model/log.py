"""Presses with a force sensor and a stage beside them: what `ruffini cal fit --only contact` fits and judges on.

A log is a folder of runs as `ruffini reproduce --only recordings` makes them: frames, rig.npz (what the bench read) and
run.json (indenter, its radius in micrometres, hardness). The sensor's side is the core's own integers.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.contact_model.profile import N_RINGS
from ruffini.estimators.wrench.log import zero_of
from ruffini.files import readable
from ruffini.frames import read_frames
from ruffini.rubber import RUBBER_POISSON, shore_a_modulus

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Progress = Callable[[float], None]

PX = 65536.0
LEAST_STEP_MM = 0.02
WHOLLY = 0.99  # of the nodes about a patch touch
LOST_OR_DARK = 8 | 64 | 128  # of FlagBit: markers lost, dark, overexposed
FACES = {"triangle": 3**0.5, "square": 4.0, "flat": float(np.pi)}  # of planar indenters, over the radius squared
HERTZIAN = ("sphere",)
GIVE = 1.5
MOST_SHORE = 98.0
LEAST_SHORE = 15.0  # softer objects give way more than the gel: the paper's force fails on Shore A 5


@dataclass(frozen=True)
class Press:
    """One run from the first touch on: what the bench knows, and what the core saw.

    flow (t, n) shifts of the patches, px; radial (t, 16), size and fall: the core's profile; center (t, 2) um;
    force (t, 6) N and N m less the reading at rest; travel (t,), gel (t,) mm and area (t,) mm2, of what the log knows.
    surface (t, patches) mm how deep the gel is at each patch, and whether the patch touches: None of a bench.
    """

    name: str
    group: str  # of runs with one size at one place
    shape: str
    radius_mm: float
    shore_a: float
    flow: Array
    radial: Integers
    size: Integers
    fall: Integers
    center_um: Array
    is_good: npt.NDArray[np.bool_]
    force: Array
    travel_mm: Array
    gel_mm: Array
    area_mm2: Array
    surface_mm: Array | None = None
    under: npt.NDArray[np.bool_] | None = None

    @property
    def is_hertzian(self) -> bool:
        return self.shape in HERTZIAN

    @property
    def has_model(self) -> bool:
        """Whether a contact model holds for its shape and hardness."""
        return self.shore_a >= LEAST_SHORE and (self.is_hertzian or self.shape in FACES)

    @property
    def goes_down(self) -> bool:
        """Whether the stage only went down, not sideways or up again: then kind and hardness are judged by it."""
        return bool(np.diff(self.travel_mm).min(initial=np.inf) > LEAST_STEP_MM)

    @property
    def effective_area_mm2(self) -> Array:
        """Of a planar indenter its face; of a ball pi R d (Hertz), d the stage's travel."""
        if self.is_hertzian:
            return np.asarray(np.pi * self.radius_mm * np.maximum(self.travel_mm, 0.0))
        return np.full(len(self.travel_mm), FACES.get(self.shape, np.pi) * self.radius_mm**2)

    @property
    def known_gel_mm(self) -> Array:
        """Mean depth of the gel (t,): of the log where it says so, else the travel less what the object gives way.

        That is the paper's eq. (4) with the object's modulus, GIVE times for a body no higher than wide; of a ball
        3 F / (4 a E*), a^2 = R d, and the gel is three quarters as deep on the mean as in the middle (Hertz).
        """
        modulus = shore_a_modulus(min(self.shore_a, MOST_SHORE)) / (1 - RUBBER_POISSON**2)
        force = np.maximum(-self.force[:, 2], 0.0)
        radius_m = 1e-3 * np.sqrt(np.maximum(self.effective_area_mm2, 1e-6) / np.pi)
        if self.is_hertzian:
            of_bench = 0.75 * self.travel_mm - 1e3 * 0.75 * force / (radius_m * modulus)
        else:
            of_bench = self.travel_mm - 1e3 * GIVE * force / (2 * radius_m * modulus)
        return np.asarray(np.where(np.isfinite(self.gel_mm), self.gel_mm, np.maximum(of_bench, 0.0)))

    @property
    def known_area_mm2(self) -> Array:
        """Area of the contact (t,): of the log where it says so, else that of the face, or pi R d."""
        return np.asarray(np.where(np.isfinite(self.area_mm2), self.area_mm2, self.effective_area_mm2))

    def of_bench(self) -> Press:
        """The same press without what only a simulation knows of it."""
        nothing = np.full_like(self.gel_mm, np.nan)
        return replace(self, gel_mm=nothing, area_mm2=nothing, surface_mm=None, under=None)


def read_presses(paths: list[Path], board: Board, *, progress: Progress = lambda _: None) -> list[Press]:
    """Every run below the folders whose run.json says part "fit", in order of names.

    Raises
    ------
    InputError
        There is none, or one lacks what the bench read.
    """
    folders = [run.parent for path in paths for run in sorted(path.glob("**/run.json"))]
    runs = [(folder, _card(folder)) for folder in folders]
    wanted = [(folder, run) for folder, run in runs if run.get("part", "fit") == "fit"]
    if not wanted:
        raise InputError(
            f'{", ".join(map(str, paths))}: no run of `ruffini reproduce --only recordings` with part "fit" below it'
        )
    out = []
    for done, (folder, run) in enumerate(wanted, 1):
        out.append(read_press(folder, run, board))
        progress(done / len(wanted))
    return out


def _card(folder: Path) -> dict[str, object]:
    path = folder / "run.json"
    try:
        run = json.loads(readable(path).read_text())
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} is no JSON ({error}): record the run again with ruffini reproduce --only recordings"
        ) from error
    if not isinstance(run, dict):
        raise InputError(f"{path} says nothing of a run: record it again with ruffini reproduce --only recordings")
    return run


def read_press(folder: Path, run: dict[str, object], board: Board) -> Press:
    """One run.

    Raises
    ------
    InputError
        It lacks what the bench read, or nothing touches in it.
    """
    try:
        with np.load(readable(folder / "rig.npz"), allow_pickle=False) as file:
            rig = {name: file[name] for name in file.files}
        force, travel, shore = rig["force"], rig["depth_m"], float(rig["shore_a"])
        chosen = run["chosen"]
        shape, radius_mm = str(chosen["indenter"]), float(chosen["radius_um"]) * 1e-3  # type: ignore[index]
    except (OSError, KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(
            f"{folder}: no run of a bench ({error}): record it with ruffini reproduce --only recordings"
        ) from error
    if force.ndim != 2 or force.shape[1] != 6 or travel.shape != force.shape[:1] or not np.isfinite(force).all():
        raise InputError(f"{folder}: rig.npz must hold force (t, 6), finite, and depth_m (t,): record the run again")
    flow, profiles, good = _seen(folder, board)
    touched = np.flatnonzero(travel > 0)
    if len(flow) != len(force) or not touched.size or touched[0] < board.pipeline.n_rest_frames:
        raise InputError(f"{folder}: frames and force readings do not belong together, or nothing rests at first")
    if not good[touched].any():
        raise InputError(f"{folder}: no touched frame shows enough of the texture: is it board {board.name!r}'s?")
    at = touched
    nothing = np.full(len(force), np.nan)
    return Press(
        f"{folder.parent.name}/{folder.name}", folder.parent.name, shape, radius_mm, shore,
        flow[at], profiles[at, :N_RINGS], profiles[at, N_RINGS], profiles[at, N_RINGS + 1],
        profiles[at, N_RINGS + 2 : N_RINGS + 4].astype(np.float64), good[at],
        (force - zero_of(force[: touched[0]]))[at], travel[at] * 1e3,
        rig.get("gel_depth_m", nothing)[at] * 1e3, rig.get("area_m2", nothing)[at] * 1e6,
        *_surface(folder / "truth.npz", board, at),
    )  # fmt: skip


def _surface(
    path: Path, board: Board, frames: npt.NDArray[np.intp]
) -> tuple[Array, npt.NDArray[np.bool_]] | tuple[None, None]:
    """What a simulation knows of the gel at the patches; nothing of a bench, or where it is beside the pad's nodes."""
    m = board.markers
    if m is None or not path.is_file():
        return None, None
    with np.load(readable(path), allow_pickle=False) as truth:
        z_mm, touches = truth["displacement"][frames][..., 2] * -1e3, truth["contact"][frames].astype(np.float64)
    n_y, n_x = z_mm.shape[1:]
    x = (m.first_x_um + m.pitch_x_um * np.arange(m.n_x)) / board.pad.size_x_um * (n_x - 1)
    y = (m.first_y_um + m.pitch_y_um * np.arange(m.n_y)) / board.pad.size_y_um * (n_y - 1)

    def at_patches(values: Array) -> Array:
        along = _linear(n_y, y) @ values @ _linear(n_x, x).T
        return np.asarray(along.reshape(len(values), -1))

    return at_patches(z_mm), np.asarray(at_patches(touches) > WHOLLY)


def _linear(n: int, at: Array) -> Array:
    """Weights (k, n) of values at 0..n-1 for the values between."""
    return np.asarray(np.maximum(1 - np.abs(np.arange(n)[None, :] - at[:, None]), 0))


def _seen(folder: Path, board: Board) -> tuple[Array, Integers, npt.NDArray[np.bool_]]:
    flow, profiles, good = [], [], []
    with Pipeline(board) as pipeline:
        for image in read_frames(folder):
            frame = pipeline.process(image)
            p = pipeline.profile()
            flow.append(pipeline.features() / PX)
            profiles.append([*p.radial_q4, p.size_q4, p.fall_q16, p.center_x_um, p.center_y_um])
            good.append(not frame.flags & LOST_OR_DARK)
    return np.array(flow), np.array(profiles, np.int64), np.array(good)
