"""An animated picture of a gripper and what its pads feel, drawn without a display or a GPU."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ruffini.errors import InputError

FRAME_MS = 60
VIEW_M = (-0.075, 0.075, -0.005, 0.145)  # x and z
FULL_N = 0.02  # nodal force at the end of the colours
COLORS = {"thing": "#c9a227", "table": "#888888"}


class Film:
    """Pictures of `Gripper`s one after the other; `write` makes a GIF of them."""

    def __init__(self) -> None:
        self._pictures: list[Any] = []

    def __len__(self) -> int:
        return len(self._pictures)

    def take(self, gripper: Any, frames: dict[str, Any], title: str) -> None:
        """The scene from the front, and each pad's forces: pressure as colour, shear as arrows."""
        from matplotlib.figure import Figure
        from PIL import Image

        figure = Figure(figsize=(6.4, 3.2), dpi=80)
        axes = figure.add_axes((0.02, 0.04, 0.5, 0.84))
        _draw_scene(axes, gripper.world)
        for i, (name, frame) in enumerate(frames.items()):
            _draw_pad(figure.add_axes((0.56, 0.52 - 0.46 * i, 0.4, 0.36)), name, frame)
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


def _draw_scene(axes: Any, world: Any) -> None:
    from matplotlib.patches import Polygon

    axes.set_xlim(*VIEW_M[:2])
    axes.set_ylim(*VIEW_M[2:])
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.axhline(0, color=COLORS["table"], lw=2)
    model, data = world.model, world.data
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom)
        size, turn = model.geom_size[geom], data.geom_xmat[geom].reshape(3, 3)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * size
        else:
            half = size[1] if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER else size[0]
            angle = np.linspace(0, 2 * np.pi, 40)
            round_ = np.column_stack([size[0] * np.cos(angle), 0 * angle, half * np.sin(angle)])
            flat = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * [size[0], 0, half]
            corners = flat if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER else round_
        seen = (corners @ turn.T + data.geom_xpos[geom])[:, [0, 2]]
        axes.add_patch(Polygon(seen, facecolor=COLORS.get(name or "", "#4a6fa5"), edgecolor="black", lw=0.8))
    for pad in world.pads.values():
        place = pad.frame(data)
        half, thick = pad.solid.half_size_m[0], pad.solid.unit.model.thickness_m
        along = place.rotation[:, 0] if abs(place.rotation[2, 0]) > 0.5 else place.rotation[:, 1]
        corners = [place.origin + s * half * along - t * thick * place.rotation[:, 2] for s, t in
                   ((-1, 0), (1, 0), (1, 1), (-1, 1))]  # fmt: skip
        axes.add_patch(Polygon(np.array(corners)[:, [0, 2]], facecolor="#e07a5f", edgecolor="black", lw=0.8))


def _draw_pad(axes: Any, name: str, frame: Any) -> None:
    force = frame.field.raw_force
    axes.imshow(-force[..., 2], cmap="magma", vmin=0, vmax=FULL_N, origin="lower")
    step = (slice(None, None, 3), slice(None, None, 3))
    rows, columns = np.mgrid[: force.shape[0], : force.shape[1]]
    axes.quiver(columns[step], rows[step], force[..., 0][step], force[..., 1][step], color="white", scale=3 * FULL_N)
    axes.set_xticks([])
    axes.set_yticks([])
    contacts = frame.contacts.contacts
    state = contacts[0].slip_state or "touched" if contacts else "nothing touches"
    axes.set_title(f"{name}: {np.linalg.norm(frame.wrench.values[:3]):.2f} N, {state}", fontsize=8)
