"""Simulated recordings on disk: frames, truth and settings that `ruffinid --camera replay:` plays.

    frames/000000.png ...   what the camera saw
    recording.toml          simulated = true, rate, board, seed, settings, versions
    truth.npz               time_s (t,), wrench (t, 6) N and N m about the pad's centre,
                            force (t, n_y, n_x, 3) N on the board's node grid (whole pad),
                            displacement (t, n_y, n_x, 3) m at the board's nodes,
                            pose (t, 4) x, y, depth (m), turn (rad), NaN where nothing touches,
                            judged (t,) bool, touch (t,) number of the touch or -1
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from ruffini import __version__
from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.contact import ContactSolver, transfer_forces, wrench_of
from ruffini.sim.optics import Renderer, TwinSettings, load_twin
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.programs import Touch, ball_presses

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class PadError:
    """How far the simulated pad's true numbers are from the board's, as factors."""

    modulus: float = 1.0
    poisson: float = 1.0
    thickness: float = 1.0


@dataclass
class TwinUnit:
    """One simulated sensor: its pad's compliance and its camera."""

    board: Board
    twin: TwinSettings
    model: PadModel
    compliance: Array

    @classmethod
    def build(cls, board: Board, error: PadError | None = None, *, progress: Progress = lambda _: None) -> TwinUnit:
        """Solve the pad's mechanics (seconds)."""
        error = error or PadError()
        pad = board.pad
        model = PadModel(
            size_x_m=pad.size_x_um * 1e-6,
            size_y_m=pad.size_y_um * 1e-6,
            thickness_m=pad.thickness_um * 1e-6 * error.thickness,
            modulus_pa=pad.modulus_pa * error.modulus,
            poisson=min(pad.poisson_1e4 * 1e-4 * error.poisson, 0.4999),
        )
        return cls(board, load_twin(board), model, surface_compliance(model, progress=progress))

    def solver(self, touch: Touch) -> ContactSolver:
        """A fresh contact of the touch's indenter with this pad."""
        return ContactSolver(self.model, self.compliance, touch.indenter, self.twin.unit.friction_1e3 * 1e-3)

    def at_nodes(self, displacement: Array) -> Array:
        """Surface displacement at the board's nodes, (n_y, n_x, 3)."""
        grid, shape = self.board.grid, self.model.shape
        x = np.linspace(self.model.node_x()[0], self.model.node_x()[-1], grid.n_x)
        y = np.linspace(self.model.node_y()[0], self.model.node_y()[-1], grid.n_y)
        field = displacement.reshape(*shape, 3)
        return np.stack(
            [RectBivariateSpline(self.model.node_y(), self.model.node_x(), field[:, :, c])(y, x) for c in range(3)],
            axis=-1,
        )


class _FrameWriter:
    """PNG files one after the other; what is written stays valid."""

    def __init__(self, folder: Path) -> None:
        if folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder} is not empty: choose another --out")
        self.folder = folder
        self.count = 0
        (folder / "frames").mkdir(parents=True, exist_ok=True)

    def add(self, image: npt.NDArray[np.uint8], name: str | None = None) -> None:
        import cv2

        path = self.folder / (name or f"frames/{self.count:06d}.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        encoded, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        temporary = path.with_suffix(".tmp")
        try:
            assert encoded
            temporary.write_bytes(data.tobytes())
            temporary.replace(path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise InputError(f"{path}: cannot be written: {error.strerror}: frames before it are valid") from error
        self.count += name is None


def record_touches(
    unit: TwinUnit, story: Iterable[Touch | int], out: Path, *, seed: int, program: str, progress: Progress = lambda _: None
) -> int:
    """Play a story and write the recording. Returns the number of frames."""
    steps = list(story)
    total = sum(s if isinstance(s, int) else len(s.poses) for s in steps)
    writer, rng = _FrameWriter(out), np.random.default_rng(seed)
    renderer = Renderer(unit.board, unit.twin, unit.model)
    grid = unit.board.grid
    rows: dict[str, list[npt.ArrayLike]] = {k: [] for k in ("wrench", "force", "displacement", "pose", "judged", "touch")}
    nothing = np.zeros((unit.model.shape[0] * unit.model.shape[1], 3))
    touch_number = -1

    def add(force: Array, displacement: Array, pose: list[float], judged: bool, touch: int) -> None:
        writer.add(renderer.image(displacement, rng))
        rows["wrench"].append(wrench_of(unit.model, force))
        rows["force"].append(transfer_forces(unit.model, force, grid.n_x, grid.n_y).astype(np.float32))
        rows["displacement"].append(unit.at_nodes(displacement).astype(np.float32))
        rows["pose"].append(pose)
        rows["judged"].append(judged)
        rows["touch"].append(touch)
        progress(writer.count / total)

    for step in steps:
        if isinstance(step, int):
            for _ in range(step):
                add(nothing, nothing, [np.nan] * 4, False, -1)
            continue
        touch_number += 1
        solver = unit.solver(step)
        for pose, judged in zip(step.poses, step.judged, strict=True):
            solver.advance(pose)
            place = [pose.x_m, pose.y_m, pose.depth_m, pose.turn_rad]
            add(solver.force, solver.displacement, place, judged, touch_number)
    rate_hz = unit.board.camera.rate_mhz * 1e-3
    arrays = {k: np.asarray(v) for k, v in rows.items()}
    np.savez_compressed(out / "truth.npz", time_s=np.arange(writer.count) / rate_hz, **arrays)
    _write_settings(unit, out, seed, program)
    return writer.count


def _write_settings(unit: TwinUnit, out: Path, seed: int, program: str) -> None:
    m = unit.model
    (out / "recording.toml").write_text(
        f'simulated = true\nboard = "{unit.board.name}"\nrate_mhz = {unit.board.camera.rate_mhz}\n'
        f'seed = {seed}\nprogram = "{program}"\nversion = "{__version__}"\n'
        f"modulus_pa = {m.modulus_pa!r}\npoisson = {m.poisson!r}\nthickness_m = {m.thickness_m!r}\n",
        encoding="ascii",
    )


def record_balls(
    unit: TwinUnit, n: int, out: Path, *, ball_mm: float, seed: int, progress: Progress = lambda _: None
) -> int:
    """Ball presses for `ruffini cal photometric`: reference images, presses, presses.csv, presses.toml.

    The contact circle is where the truth's nodal pressure ends, as a person would mark it, with the
    marker's error of half a pixel.
    """
    writer, rng = _FrameWriter(out), np.random.default_rng(seed)
    renderer = Renderer(unit.board, unit.twin, unit.model)
    camera = unit.board.camera
    px_per_mm = camera.focal_mpx / camera.standoff_um
    nothing = np.zeros((unit.model.shape[0] * unit.model.shape[1], 3))
    for i in range(8):
        writer.add(renderer.image(nothing, rng), f"reference_{i}.png")
    lines = ["image,center_x_px,center_y_px,contact_radius_px"]
    node_x, node_y = np.meshgrid(unit.model.node_x(), unit.model.node_y())
    for i, (indenter, pose) in enumerate(ball_presses(unit.board, n, ball_mm / 2e3, rng)):
        solver = unit.solver(Touch(indenter, [pose], [True]))
        for part in (0.5, 1.0):
            solver.advance(replace(pose, depth_m=part * pose.depth_m))
        writer.add(renderer.image(solver.displacement, rng), f"press/{i:04d}.png")
        touching = solver.force[:, 2] < 0
        area = touching.sum() * (unit.model.node_x()[1] - unit.model.node_x()[0]) * (
            unit.model.node_y()[1] - unit.model.node_y()[0]
        )
        edge = np.hypot(node_x.ravel() - pose.x_m, node_y.ravel() - pose.y_m)
        depth_mm = float(solver.displacement[touching, 2][edge[touching].argmax()] * 1e3)
        scale = camera.focal_mpx * 1e-3 / (camera.standoff_um * 1e-3 + depth_mm)
        radius = np.sqrt(area / np.pi) * 1e3 * scale + rng.normal(0, 0.5)
        center_x = camera.center_x_mpx * 1e-3 + pose.x_m * 1e3 * scale + rng.normal(0, 0.5)
        center_y = camera.center_y_mpx * 1e-3 + pose.y_m * 1e3 * scale + rng.normal(0, 0.5)
        lines.append(f"press/{i:04d}.png,{center_x:.2f},{center_y:.2f},{radius:.2f}")
        progress((i + 1) / n)
    (out / "presses.csv").write_text("\n".join(lines) + "\n", encoding="ascii")
    (out / "presses.toml").write_text(f"ball_mm = {ball_mm}\npx_per_mm = {px_per_mm:.4f}\n", encoding="ascii")
    _write_settings(unit, out, seed, "balls")
    return n
