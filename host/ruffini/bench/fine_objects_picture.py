"""Pictures of `ruffini.bench.fine_objects`: object, pressure, nodal forces in truth, by the board and by iFEM raw."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.fine_objects import METHODS, Measured, indenter_of
from ruffini.boards import Board
from ruffini.sim.pose import surface_height

Array = npt.NDArray[np.float64]

WORDS = {"default": "board", "raw": "iFEM raw"}
FRAME_MS, HELD_FRAMES = 140, 8
LEAST_ARROW = 0.06  # of the longest


def sheet(path: Path, board: Board, objects: dict[str, list[Measured]]) -> Path:
    """A column for each object, its last moment."""
    plt = _pyplot()
    figure, axes = plt.subplots(5, len(objects), figsize=(3.3 * len(objects), 12.2), squeeze=False)
    for column, (name, touch) in enumerate(objects.items()):
        _draw(axes[:, column], board, name, touch[-1], _scales(touch))
    errors = "(off by: relative error, along the pad and normal)"
    figure.suptitle(f"{board.name}, SIMULATED: object, its pressure, nodal forces\n{errors}", fontsize=11)
    figure.tight_layout(rect=(0, 0, 1, 0.99))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)
    return path


def animation(path: Path, board: Board, name: str, touch: list[Measured]) -> Path:
    """All moments of one object; the format follows from the file's name (.webp or .gif)."""
    from PIL import Image

    plt, frames = _pyplot(), []
    for moment in touch:
        figure, axes = plt.subplots(1, 4, figsize=(11.0, 2.7), dpi=75, constrained_layout=True)
        _draw([None, *axes], board, name, moment, _scales(touch))
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
        plt.close(figure)
        frames.append(Image.open(buffer).convert("RGB"))
    frames += [frames[-1]] * HELD_FRAMES
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, quality=60, method=6)
    return path


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def _scales(touch: list[Measured]) -> tuple[float, float, float]:
    """Highest pressure, and highest normal and tangential true force at a node, of a whole touch."""
    pressure = max(float(m.moment.pressure_pa.max()) for m in touch)
    normal = max(float(-m.true[..., 2].min()) for m in touch)
    return pressure, normal, max(float(np.linalg.norm(m.true[..., :2], axis=-1).max()) for m in touch)


def _title(board: Board, measured: Measured, method: str) -> str:
    """Method, its normal force, and the relative errors of its nodal forces."""
    errors = measured.errors(board, method)
    normal_n = -measured.found[method][..., 2].sum()
    return f"{WORDS[method]}, {normal_n:.2f} N: off by {errors['tangential']:.2f}, {errors['normal']:.2f}"


def _draw(axes: Any, board: Board, name: str, measured: Measured, scales: tuple[float, float, float]) -> None:
    """Object (unless its axis is None), pressure, truth, and each method."""
    pressure, normal_n, shear_n = scales
    size = (board.pad.size_x_um * 1e-3, board.pad.size_y_um * 1e-3)
    extent = (-size[0] / 2, size[0] / 2, size[1] / 2, -size[1] / 2)
    if axes[0] is not None:
        lines = [np.linspace(-s / 2, s / 2, 300) for s in size]
        place = np.stack([axis.ravel() for axis in np.meshgrid(*lines)], axis=1) * 1e-3
        height = 1e3 * surface_height(indenter_of(name), measured.moment.pose, place).reshape(300, 300)
        axes[0].imshow(height, cmap="gray_r", vmin=height.min(), vmax=height.min() + 1.2, extent=extent, aspect="equal")
        axes[0].set_title(f"{name}, {measured.moment.state.resultant_n:.1f} N", fontsize=9)
    axes[1].imshow(measured.moment.pressure_pa, cmap="cividis", vmin=0, vmax=pressure, extent=extent)
    axes[1].set_title(f"simulated pressure, at most {1e-3 * pressure:.0f} kPa", fontsize=9)
    rows, columns = board.observed
    lines = [np.linspace(-0.5, 0.5, n)[part] * s for n, part, s in (
        (board.grid.n_x, columns, size[0]), (board.grid.n_y, rows, size[1]))]  # fmt: skip
    x, y = np.meshgrid(*lines)
    half = [0.5 * (line[1] - line[0]) for line in lines]
    nodes_extent = (x[0, 0] - half[0], x[0, -1] + half[0], y[-1, 0] + half[1], y[0, 0] - half[1])
    fields = {f"true nodal force, {-measured.true[..., 2].sum():.2f} N": measured.true}
    fields |= {_title(board, measured, method): measured.found[method] for method in METHODS}
    for axis, (title, force) in zip(axes[2:], fields.items(), strict=True):
        axis.imshow(-force[..., 2], cmap="cividis", vmin=0, vmax=normal_n, extent=nodes_extent, interpolation="nearest")
        is_long = np.linalg.norm(force[..., :2], axis=-1) > LEAST_ARROW * shear_n
        axis.quiver(
            x[is_long], y[is_long], force[is_long, 0], force[is_long, 1], color="white", angles="xy",
            scale=shear_n / (4 * half[0]), scale_units="xy", width=0.003,
        )  # fmt: skip
        axis.set_title(title, fontsize=9)
    for axis in axes[0 if axes[0] is not None else 1 :]:
        axis.set(xticks=[], yticks=[], xlim=extent[:2], ylim=extent[2:])
