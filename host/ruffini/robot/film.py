"""An animated picture of a world and what its pads feel, drawn without a display or a GPU."""

from __future__ import annotations

import io
import itertools
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.robot.shapes import mesh_vertices

Array = npt.NDArray[np.float64]

FRAME_MS = 60
VIEW_M = (-0.075, 0.075, -0.005, 0.145)  # x and z
FULL_N = 0.02
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
ROUND = np.array([(np.cos(turn), np.sin(turn), 0.0) for turn in np.linspace(0, 2 * np.pi, 40, endpoint=False)])
BALL = np.concatenate([ROUND * np.cos(rise) + [0, 0, np.sin(rise)] for rise in np.linspace(-1.5, 1.5, 21)])
COLORS = {"thing": "#c9a227", "table": "#888888"}


class Film:
    """Pictures of a `Gripper` or a `World` one after the other; `write` makes a GIF of them.

    Parameters
    ----------
    view_m : least and largest x and z that are seen, from y below zero.
    full_n : pressure at the end of the colours, as force on one of the board's nodes.
    """

    def __init__(self, view_m: tuple[float, float, float, float] = VIEW_M, full_n: float = FULL_N) -> None:
        self._view_m, self._full_n = view_m, full_n
        self._pictures: list[Any] = []

    def __len__(self) -> int:
        return len(self._pictures)

    def take(self, scene: Any, frames: dict[str, Any], title: str, line: Array | None = None) -> None:
        """The scene from the front, and each pad's forces: pressure as colour, shear as arrows.

        `line` : (n, 3) metres, drawn over the scene; NaN parts it.
        """
        from matplotlib.figure import Figure
        from PIL import Image

        figure = Figure(figsize=(6.4, 3.2), dpi=80)
        axes = figure.add_axes((0.02, 0.04, 0.5, 0.84))
        axes.set(xlim=self._view_m[:2], ylim=self._view_m[2:], aspect="equal")
        axes.set_axis_off()
        _draw_scene(axes, getattr(scene, "world", scene))
        if line is not None:
            axes.plot(line[:, 0], line[:, 2], color="black", lw=2, zorder=3)
        for i, (name, frame) in enumerate(frames.items()):
            _draw_pad(figure.add_axes((0.56, 0.52 - 0.46 * i, 0.4, 0.36)), name, frame, self._full_n)
        figure.suptitle(f"{title}   SIMULATED", fontsize=9)
        file = io.BytesIO()
        figure.savefig(file, format="png")
        self._pictures.append(Image.open(file).convert("P", palette=Image.Palette.ADAPTIVE, colors=64))

    def write(self, path: Path | str) -> None:
        """The pictures as an animated GIF.

        Raises
        ------
        InputError
            There are none.
        """
        if not self._pictures:
            raise InputError(f"{path}: the film has no picture: call take() after a step")
        first, *others = self._pictures
        first.save(path, save_all=True, append_images=others, duration=FRAME_MS, loop=0, optimize=True)


def surface_points(model: Any, geom: int) -> Array:
    """Points whose convex hull is about the geom, (n, 3) metres in its axes."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return mesh_vertices(model, model.geom_dataid[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.asarray(CORNERS * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.concatenate([ROUND * size[0] + [0, 0, end * size[1]] for end in (-1, 1)])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.concatenate([BALL * size[0] + [0, 0, end * size[1]] for end in (-1, 1)])
    return np.asarray(BALL * (size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0]))


def _draw_scene(axes: Any, world: Any) -> None:
    from matplotlib.patches import Polygon
    from scipy.spatial import ConvexHull

    model, data = world.model, world.data
    shapes = []  # corners or outline in the world, colour
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            axes.axhline(data.geom_xpos[geom, 2], color=COLORS["table"], lw=2)
            continue
        name, turn = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom), data.geom_xmat[geom].reshape(3, 3)
        points = surface_points(model, geom)
        shapes.append((points @ turn.T + data.geom_xpos[geom], COLORS.get((name or "").split("_")[0], "#4a6fa5")))
    for pad in world.pads.values():
        place, thick = pad.frame(data), pad.solid.unit.model.thickness_m
        box = CORNERS * [*pad.solid.half_size_m, thick / 2] - [0, 0, thick / 2]
        shapes.append((box @ place.rotation.T + place.origin, "#e07a5f"))
    for points, color in sorted(shapes, key=lambda shape: -float(shape[0][:, 1].mean())):  # far ones first
        seen = points[ConvexHull(points[:, [0, 2]]).vertices][:, [0, 2]]
        axes.add_patch(Polygon(seen, facecolor=color, edgecolor="black", lw=0.8, alpha=0.8))


def _draw_pad(axes: Any, name: str, frame: Any, full_n: float) -> None:
    force = frame.field.raw_force
    axes.imshow(-force[..., 2], cmap="magma", vmin=0, vmax=full_n, origin="lower")
    step = (slice(None, None, 3), slice(None, None, 3))
    rows, columns = np.mgrid[: force.shape[0], : force.shape[1]]
    axes.quiver(columns[step], rows[step], force[..., 0][step], force[..., 1][step], color="white", scale=3 * full_n)
    axes.set_xticks([])
    axes.set_yticks([])
    contacts = frame.contacts.contacts
    state = contacts[0].slip_state or "touched" if contacts else "nothing touches"
    axes.set_title(f"{name}: {np.linalg.norm(frame.wrench.values[:3]):.2f} N, {state}", fontsize=8)
