"""Pictures of a run: force field over the frame, depth, wrench over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.device.results import Contact

Array = npt.NDArray[np.float64]

AXES = ("x", "y", "z")
# Colour-blind-safe (Okabe and Ito) for x, y, z.
COLOURS = ("#D55E00", "#009E73", "#0072B2")
PRESSURE_MAP = "cividis"
# Legends stand above the axes, where no curve can run through them.
ABOVE: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "borderaxespad": 0.2,
    "ncols": 3,
    "frameon": False,
}


def _figure(width: float, height: float, **layout: Any) -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update({"font.size": 10, "axes.titlesize": 11, "figure.dpi": 110})
    return plt.subplots(figsize=(width, height), constrained_layout=True, **layout)


def _save(figure: Any, path: Path) -> Path:
    from matplotlib import pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)
    return path


def field_over_frame(
    path: Path,
    frame_bgr: npt.NDArray[np.uint8],
    node_px: Array,
    force_n: Array,
    *,
    title: str,
    truth_n: Array | None = None,
    z_calibrated: bool = True,
    slip: npt.NDArray[np.int32] | None = None,
) -> Path:
    """Shear arrows over the camera image, normal force beside it (and the truth's, where known).

    Parameters
    ----------
    node_px : (n_y, n_x, 2) float64
        Where each node is in the image, pixels.
    force_n : (n_y, n_x, 3) float64
        Nodal force ON the pad, newtons; pressing is negative z.
    truth_n : same shape, optional
    z_calibrated : bool
        False shows the size of the shear in place of the normal force.
    slip : (n_y, n_x) int32, optional
        NodeSlip of each node: a ring round those that stick, a cross on those that slip.
    """
    panels = [("measured", force_n)] + ([("truth (simulated)", truth_n)] if truth_n is not None else [])
    figure, axes = _figure(5.2 * (len(panels) + 1), 4.3, ncols=len(panels) + 1, squeeze=False)
    image_axis, map_axes = axes[0][0], axes[0][1:]
    image_axis.imshow(frame_bgr[:, :, ::-1])
    shear = np.hypot(force_n[..., 0], force_n[..., 1])
    strong = shear > max(0.15 * float(shear.max()), 1e-9)
    longest_px = 28.0
    unit = longest_px / max(float(shear.max()), 1e-9)
    image_axis.quiver(
        node_px[strong][:, 0],
        node_px[strong][:, 1],
        force_n[strong][:, 0] * unit,
        force_n[strong][:, 1] * unit,
        color="white",
        edgecolor="black",
        linewidth=0.4,
        width=0.005,
        angles="xy",
        scale_units="xy",
        scale=1.0,
    )
    image_axis.set_title(f"shear, longest arrow {1e3 * shear.max():.1f} mN")
    image_axis.set_axis_off()
    maps = [(-f[..., 2] if z_calibrated else np.hypot(f[..., 0], f[..., 1])) * 1e3 for _, f in panels]
    high = max(float(m.max()) for m in maps)
    x, y = node_px[..., 0], node_px[..., 1]
    for axis, (name, _), values in zip(map_axes, panels, maps, strict=True):
        mesh = axis.pcolormesh(
            x, y, values, cmap=PRESSURE_MAP, vmin=min(0.0, float(values.min())), vmax=high, shading="gouraud"
        )
        axis.set_aspect("equal")
        axis.invert_yaxis()
        axis.set_axis_off()
        what = "normal force" if z_calibrated else "size of shear"
        axis.set_title(f"{what} per node, {name}")
        figure.colorbar(mesh, ax=axis, label="mN", shrink=0.8)
    if slip is not None and slip.any():
        for value, marker, name in ((1, "o", "sticks"), (2, "x", "slips")):
            at = node_px[slip == value]
            map_axes[0].plot(at[:, 0], at[:, 1], marker, color="white", fillstyle="none", markersize=4, label=name)
        map_axes[0].legend(fontsize=7, facecolor="grey", labelcolor="white")
    figure.suptitle(title)
    return _save(figure, path)


def contacts_beside_frame(
    path: Path,
    frame_bgr: npt.NDArray[np.uint8],
    true_force_n: Array,
    size_mm: tuple[float, float],
    contacts: Sequence[Contact],
    *,
    title: str,
) -> Path:
    """The camera image, and the contacts on the pad over the true force of its nodes.

    `true_force_n` (n_y, n_x, 3) newtons lies evenly over the pad of `size_mm`; of a tube the pad is the unrolled skin.
    """
    figure, (left, right) = _figure(11.0, 4.3, ncols=2)
    left.imshow(frame_bgr[:, :, ::-1])
    left.set_axis_off()
    x, y = (np.linspace(-0.5, 0.5, n) * size for n, size in zip(true_force_n.shape[1::-1], size_mm, strict=True))
    size = 1e3 * np.linalg.norm(true_force_n, axis=-1)
    shown = right.pcolormesh(x, y, size, cmap=PRESSURE_MAP, shading="gouraud")
    figure.colorbar(shown, ax=right, label="true force per node (simulated), mN", shrink=0.8)
    for i, contact in enumerate(contacts):
        at = np.array(contact.center) * 1e3
        right.plot(*at, "+", color="white", markersize=14, markeredgewidth=2)
        force = contact.force[np.isfinite(contact.force)]
        if force.size == 0:  # of its place alone
            continue
        beside = (8, 8) if i % 2 == 0 else (-48, 8)  # two that touch each other have two labels
        right.annotate(f"{np.linalg.norm(force):.2f} N", at, beside, textcoords="offset points", color="white")
    right.set_aspect("equal")
    right.invert_yaxis()
    right.set(xlabel="x, mm", ylabel="y, mm")
    figure.suptitle(title + ("; white crosses: measured" if contacts else ""))
    return _save(figure, path)


def depth_map(
    path: Path, depth_um: Array, *, title: str, place_mm: Array | None = None, truth: tuple[Array, Array] | None = None
) -> Path:
    """Depth of the surface, micrometres, over the image and along its deepest row.

    `place_mm` (n_y, n_x, 2) is where on the pad each cell looks (cells are counted without it). `truth` is the true
    surface: places (n_y, n_x, 2) in mm from the pad's centre and u_z (n_y, n_x) in micrometres.
    """
    row = int(np.unravel_index(int(depth_um.argmin()), depth_um.shape)[0])
    unit = "cell" if place_mm is None else "mm"
    x, y = np.indices(depth_um.shape)[::-1] if place_mm is None else np.moveaxis(place_mm, -1, 0)
    figure, (left, right) = _figure(11.0, 4.0, ncols=2)
    shown = left.pcolormesh(x, y, depth_um, cmap="viridis_r", shading="gouraud")
    left.set_aspect("equal")
    left.invert_yaxis()
    left.set(xlabel=f"x, {unit}", ylabel=f"y, {unit}")
    figure.colorbar(shown, ax=left, label="u_z, micrometres", shrink=0.85)
    left.plot(x[row], y[row], color="white", linewidth=0.8, linestyle="--")
    right.plot(x[row], depth_um[row], color=COLOURS[2], label="measured")
    if truth is not None:
        places, u_z = truth
        nearest = int(np.abs(places[..., 1].mean(axis=1) - y[row].mean()).argmin())
        right.plot(places[nearest, :, 0], u_z[nearest], "k.", markersize=4, label="truth, nearest node row (simulated)")
    right.set(xlabel=f"x, {unit}, along the dashed row", ylabel="u_z, micrometres")
    right.grid(alpha=0.3)
    right.legend(**ABOVE)
    figure.suptitle(title)
    return _save(figure, path)


def wrench_over_time(path: Path, time_s: Array, wrench: Array, *, title: str, truth: Array | None = None) -> Path:
    """Force (N) and moment (N mm) over time, the truth dashed.

    `wrench` and `truth` are (n, 6): force then moment about the undeformed pad centre; NaN where
    not measured.
    """
    groups = [(0, "force, N"), (3, "moment, N mm")]
    groups = [(offset, label) for offset, label in groups if np.isfinite(wrench[:, offset : offset + 3]).any()]
    figure, rows = _figure(10.0, 3.0 * len(groups), nrows=len(groups), sharex=True, squeeze=False)
    axes = rows[:, 0]
    for axis, (offset, label) in zip(axes, groups, strict=True):
        for i, colour in enumerate(COLOURS):
            if np.isnan(wrench[:, offset + i]).all():
                axis.plot([], [], color=colour, label=f"{AXES[i]} not measured")
                continue
            axis.plot(time_s, wrench[:, offset + i], color=colour, label=AXES[i])
            if truth is not None:
                axis.plot(time_s, truth[:, offset + i], color="black", linewidth=0.9, linestyle="--")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.legend(**ABOVE)
    axes[-1].set_xlabel("time, s")
    figure.suptitle(title + ("   (dashed: simulated truth)" if truth is not None else ""))
    return _save(figure, path)
