"""Simulated recordings on disk: frames, truth and settings that `ruffinid --camera replay:` plays.

    frames/000000.png ...   what the camera saw
    recording.toml          simulated = true, rate, board, seed, settings, versions
    truth.npz               frame (t,) number, time_s (t,), wrench (t, 6) N and N m about the pad's centre,
                            force (t, n_y, n_x, 3) N on the board's node grid (whole pad),
                            displacement (t, n_y, n_x, 3) m at the board's nodes,
                            pose (t, 6) x, y, depth (m), turn, roll, pitch (rad), NaN where nothing touches,
                            contact (t, n_y, n_x) at the board's nodes: 0 free, 1 sticks, 2 slips,
                            judged (t,) bool, touch (t,) number of the touch or -1,
                            tray (t, 6) its shift (m) and turn (rad) from rest, 0 where a board has none; the
                            displacement above is relative to it,
                            shape and radius_m of each touch's indenter

Everything random follows from the seed: the same machine writes the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ruffini.errors import InputError
from ruffini.files import write_whole
from ruffini.sim.contact import ContactSolver, Pose
from ruffini.sim.optics.camera import View
from ruffini.sim.optics.settings import ViewSettings
from ruffini.sim.programs import Step, Touch, ball_presses, n_frames_of
from ruffini.sim.rig import Unit
from ruffini.sim.scenario import Fault, Scenario
from ruffini.sim.story import Told, play
from ruffini.sim.surface import hat_areas
from ruffini.sim.toml import inline, settings_toml
from ruffini.sim.unit import PadError, TwinUnit
from ruffini.version import __version__

__all__ = ["PadError", "TwinUnit", "record_balls", "record_touches"]

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

RIM_POINTS = 36  # of a contact circle that a lens bends
N_REFERENCES = 8  # untouched images of a set of ball presses
MARKING_ERROR_PX = 0.5  # standard deviation with which a person marks the contact circle


def _write(path: Path, data: bytes) -> None:
    write_whole(path, data, remedy="make room and choose a new --out", is_durable=False)


def _new_folder(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} is there already and is not an empty folder: choose another --out")


def _png(image: npt.NDArray[np.uint8]) -> bytes:
    import cv2

    encoded, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not encoded:
        raise RuntimeError("OpenCV cannot write PNG")
    return data.tobytes()


def _truth_npz(rate_hz: float, rows: dict[str, list[npt.ArrayLike]]) -> bytes:
    arrays: dict[str, Any] = {name: np.asarray(values) for name, values in rows.items()}
    file = BytesIO()
    np.savez_compressed(file, time_s=arrays["frame"] / rate_hz, **arrays)
    return file.getvalue()


def record_touches(
    unit: Unit,
    story: list[Step],
    out: Path,
    *,
    seed: int,
    program: str,
    faults: Sequence[Fault] = (),
    moments: Iterable[Told] | None = None,
    progress: Progress = lambda _: None,
) -> int:
    """Play a story and write the recording. Returns the number of frames that its faults left.

    moments : the story's frames where somebody has played it already.

    Raises
    ------
    InputError
        The folder is not empty or cannot be written, or an indenter leaves the pad.
    """
    _new_folder(out)
    scenario, renderer, total = Scenario(seed=seed, fault=list(faults)), unit.renderer(), n_frames_of(story)
    touches = [step.indenter for step in story if isinstance(step, Touch)]
    rows: dict[str, list[npt.ArrayLike]] = {
        "frame": [], "wrench": [], "force": [], "displacement": [], "pose": [], "contact": [], "judged": [],
        "touch": [], "tray": [],
        "shape": [indenter.shape for indenter in touches],
        "radius_m": [indenter.radius_m for indenter in touches],
    }  # fmt: skip
    previous: Array | None = None
    for frame, moment in enumerate(play(unit, story) if moments is None else moments):
        displacement = moment.displacement.copy()
        before, previous = previous, displacement
        progress((frame + 1) / total)
        is_pair_lost = unit.board.alternates and not scenario.is_sent(frame, is_unlit=True)
        if is_pair_lost or not scenario.is_sent(frame):
            continue
        rows["frame"].append(frame)
        rows["wrench"].append(moment.wrench())
        rows["force"].append(moment.nodal_force())
        rows["displacement"].append(moment.nodal_displacement())
        rows["pose"].append(moment.pose_row())
        rows["contact"].append(moment.nodal_state())
        rows["judged"].append(moment.judged)
        rows["touch"].append(moment.touch)
        rows["tray"].append(np.zeros(6) if moment.tray is None else moment.tray.row())
        picture = scenario.computed_from(renderer, frame, displacement, before, moment.tray)
        _write(out / "frames" / f"{frame:06d}.png", _png(picture))
    rate_hz = unit.board.camera.rate_mhz * 1e-3
    _write(out / "truth.npz", _truth_npz(rate_hz, rows))
    _write_settings(unit, out, seed, program, faults)
    return len(rows["frame"])


def _write_settings(unit: Unit, out: Path, seed: int, program: str, faults: Sequence[Fault] = ()) -> None:
    text = (
        f'simulated = true\nboard = "{unit.board.name}"\nrate_mhz = {unit.board.camera.rate_mhz}\n'
        f'seed = {seed}\nprogram = "{program}"\n\n{unit.body_toml()}'
        f'\n[versions]\nruffini = "{__version__}"\n'
        f'numpy = "{np.__version__}"\nscipy = "{scipy.__version__}"\n'
    )
    text += settings_toml("twin", unit.twin)
    for fault in faults:
        text += "\n[[fault]]\n" + "".join(f"{key} = {inline(value)}\n" for key, value in fault.model_dump().items())
    _write(out / "recording.toml", text.encode("ascii"))


def record_balls(
    unit: TwinUnit, n: int, out: Path, *, ball_mm: float, seed: int, progress: Progress = lambda _: None
) -> int:
    """Ball presses for `ruffini cal fit --only photometric`: reference images, presses, presses.csv, presses.toml.

    The contact circle has the area of the truth's contact, as a person would mark it, with that
    person's error. Returns the number of presses.

    Raises
    ------
    InputError
        The folder is not empty or cannot be written.
    """
    _new_folder(out)
    rng, renderer = np.random.default_rng(seed), unit.renderer()
    camera = unit.board.camera
    for i in range(N_REFERENCES):
        _write(out / f"reference_{i}.png", _png(renderer.image(unit.at_rest(), rng)))
    lines = ["image,center_x_px,center_y_px,contact_radius_px"]
    for i, (indenter, pose) in enumerate(ball_presses(unit.board, n, ball_mm / 2e3, rng)):
        rig = unit.rig()
        rig.take(indenter)
        rig.advance(pose)
        assert rig.solver is not None
        name = f"press/{i:04d}.png"
        _write(out / name, _png(renderer.image(rig.displacement, rng, tray=rig.tray)))
        circle = _contact_circle_px(unit, rig.solver, pose) + rng.normal(0, MARKING_ERROR_PX, 3)
        lines.append(f"{name},{circle[0]:.2f},{circle[1]:.2f},{circle[2]:.2f}")
        progress((i + 1) / n)
    _write(out / "presses.csv", ("\n".join(lines) + "\n").encode("ascii"))
    scale = f"ball_mm = {ball_mm}\npx_per_mm = {camera.focal_mpx / camera.standoff_um:.4f}\n"
    _write(out / "presses.toml", scale.encode("ascii"))
    _write_settings(unit, out, seed, "balls")
    return n


def _contact_circle_px(unit: TwinUnit, solver: ContactSolver, pose: Pose) -> Array:
    """Centre and radius in the image of the circle with the contact's area, (3,)."""
    camera = unit.board.camera
    touching = solver.hat_force[:, 2] < 0
    radius_m = np.sqrt(hat_areas(unit.model)[touching].sum() / np.pi)
    edge_height_m = float(solver.indenter.height(radius_m, 0.0)) - pose.depth_m
    if unit.twin.lens is not None:
        return _bent_circle_px(unit, pose, radius_m, edge_height_m)
    px_per_m = camera.focal_mpx * 1e-3 / (camera.standoff_um * 1e-6 + edge_height_m)
    center = np.array([camera.center_x_mpx, camera.center_y_mpx]) * 1e-3
    return np.append(center + np.array([pose.x_m, pose.y_m]) * px_per_m, radius_m * px_per_m)


def _bent_circle_px(unit: TwinUnit, pose: Pose, radius_m: float, height_m: float) -> Array:
    """The same through a lens: centre and mean radius of what a rim of that size looks like."""
    view = View(unit.board, unit.twin.view[0] if unit.twin.view else ViewSettings(), unit.twin.lens)
    angle = np.linspace(0, 2 * np.pi, RIM_POINTS, endpoint=False)
    rim = np.stack([pose.x_m + radius_m * np.cos(angle), pose.y_m + radius_m * np.sin(angle)], axis=1)
    px = view.project(1e3 * np.column_stack([rim, np.full(RIM_POINTS, height_m)]))[0]
    center = px.mean(axis=0)
    return np.append(center, np.linalg.norm(px - center, axis=1).mean())
