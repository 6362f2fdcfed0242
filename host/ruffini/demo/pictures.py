"""Pictures of a run: force field over the frame, depth, wrench over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

AXES = ("x", "y", "z")
# Colour-blind-safe (Okabe and Ito) for x, y, z.
COLOURS = ("#D55E00", "#009E73", "#0072B2")
PRESSURE_MAP = "cividis"
CROSS = "#FF4FD8"  # on both ends of that map and on a grey picture
DARK_LEVEL, FULL_LEVEL = 100, 240  # grey levels: a picture whose brightest hundredth is darker is shown brighter
ARROW_PX = 28.0  # the longest one
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
    node_mm: Array,
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
    node_px, node_mm : (n_y, n_x, 2) float64
        Where each node is in the image, pixels, and on the pad, mm from its centre.
    force_n : (n_y, n_x, 3) float64
        Nodal force ON the pad, newtons; pressing is negative z.
    truth_n : same shape as `force_n`, optional
    z_calibrated : bool
        False shows the size of the shear in place of the normal force.
    slip : (n_y, n_x) int32, optional
        NodeSlip of each node: a ring round those that stick, a cross on those that slip.
    """
    panels = [("measured", force_n)] + ([("truth (simulated)", truth_n)] if truth_n is not None else [])
    figure, axes = _figure(5.2 * (len(panels) + 1), 4.3, ncols=len(panels) + 1, squeeze=False)
    image_axis, map_axes = axes[0][0], axes[0][1:]
    shear = np.hypot(force_n[..., 0], force_n[..., 1])
    strong = shear > max(0.15 * float(shear.max()), 1e-9)
    _show_frame(image_axis, frame_bgr, f"camera; shear, longest arrow {1e3 * shear.max():.1f} mN")
    _arrows(image_axis, node_px[strong], force_n[strong][:, :2] * ARROW_PX / max(float(shear.max()), 1e-9))
    maps = [(-f[..., 2] if z_calibrated else np.hypot(f[..., 0], f[..., 1])) * 1e3 for _, f in panels]
    high = max(float(m.max()) for m in maps)
    x, y = node_mm[..., 0], node_mm[..., 1]
    for axis, (name, _), values in zip(map_axes, panels, maps, strict=True):
        mesh = axis.pcolormesh(
            x, y, values, cmap=PRESSURE_MAP, vmin=min(0.0, float(values.min())), vmax=high, shading="gouraud"
        )
        _seen_by_camera(axis)
        what = "normal force" if z_calibrated else "size of shear"
        axis.set_title(f"{what} per node, {name}")
        figure.colorbar(mesh, ax=axis, label="mN", shrink=0.8)
    if slip is not None and slip.any():
        for value, marker, name in ((1, "o", "sticks"), (2, "x", "slips")):
            at = node_mm[slip == value]
            map_axes[0].plot(at[:, 0], at[:, 1], marker, color="white", fillstyle="none", markersize=4, label=name)
        map_axes[0].legend(fontsize=7, facecolor="grey", labelcolor="white")
    figure.suptitle(title)
    return _save(figure, path)


def _show_frame(axis: Any, frame_bgr: npt.NDArray[np.uint8], title: str) -> None:
    brightest = float(np.percentile(frame_bgr, 99))
    gain = round(FULL_LEVEL / max(brightest, 1.0)) if brightest < DARK_LEVEL else 1
    axis.imshow(np.minimum(frame_bgr[:, :, ::-1].astype(int) * gain, 255))
    axis.set_title(title if gain == 1 else f"{title}, {gain} times brighter")
    axis.set_axis_off()


def _arrows(axis: Any, at_px: Array, way_px: Array) -> None:
    axis.quiver(
        *at_px.T, *way_px.T, color="white", edgecolor="black", linewidth=0.4, width=0.005,
        angles="xy", scale_units="xy", scale=1.0,
    )  # fmt: skip


def _seen_by_camera(axis: Any, x_label: str = "x, mm", y_label: str = "y, mm") -> None:
    """Axes of the pad as the camera sees it: y points down."""
    axis.set_aspect("equal")
    axis.invert_yaxis()
    axis.set(xlabel=x_label, ylabel=y_label)


class Touched(NamedTuple):
    """Contacts that the sensor reports beside each other, and their force; NaN: not measured."""

    places_mm: list[tuple[float, float]]
    force_n: float
    true_n: float

    @property
    def label(self) -> str:
        """For a person."""
        force = "no force" if np.isnan(self.force_n) else f"{self.force_n:.2f} N"
        return f"{force}\ntrue {self.true_n:.2f} N"


def touches_on_body(
    path: Path,
    frame_bgr: npt.NDArray[np.uint8],
    true_force_n: Array,
    size_mm: tuple[float, float],
    touches: Sequence[Touched],
    *,
    title: str,
    frame_title: str,
    touches_px: Array | None = None,
    is_unrolled: bool = False,
) -> Path:
    """The camera image with the reported touches, and these over the true force of the body's nodes.

    Parameters
    ----------
    true_force_n : (n_y, n_x, 3) float64
        Newtons, evenly over `size_mm`.
    touches_px : (n, 2) float64, optional
        Where the camera sees the reported places; several views see each more than once.
    is_unrolled : bool
        True of a tube's skin: x runs round the tube.
    """
    is_wide = frame_bgr.shape[1] > 2 * frame_bgr.shape[0]
    figure, (left, right) = _figure(14.0 if is_wide else 12.5, 4.6, ncols=2, width_ratios=(2, 1) if is_wide else (1, 1))
    _show_frame(left, frame_bgr, frame_title)
    if touches_px is not None:
        left.plot(*touches_px.T, "+", color=CROSS, markersize=18, markeredgewidth=2.5)
    x, y = (np.linspace(-0.5, 0.5, n) * size for n, size in zip(true_force_n.shape[1::-1], size_mm, strict=True))
    size = 1e3 * np.linalg.norm(true_force_n, axis=-1)
    shown = right.pcolormesh(x, y, size, cmap=PRESSURE_MAP, shading="gouraud")
    figure.colorbar(shown, ax=right, label="true force per node (simulated), mN", shrink=0.8)
    for touch in touches:
        right.plot(*np.transpose(touch.places_mm), "+", color=CROSS, markersize=14, markeredgewidth=2, linestyle="none")
        is_right = np.mean(touch.places_mm, axis=0)[0] > 0.25 * size_mm[0]  # the label stays inside
        outermost = min(touch.places_mm) if is_right else max(touch.places_mm)
        right.annotate(touch.label, outermost, (-12 if is_right else 12, 0), textcoords="offset points",
                       color="white", ha="right" if is_right else "left", va="center", fontsize=9,
                       bbox={"facecolor": "black", "alpha": 0.55, "edgecolor": "none", "pad": 1.5})  # fmt: skip
    around = ("x round the tube, mm", "y along the tube, mm") if is_unrolled else ("x, mm", "y, mm")
    _seen_by_camera(right, *around)
    right.set_title("the skin, unrolled" if is_unrolled else "from above")
    figure.suptitle(f"{title}; crosses: measured places" if touches else f"{title}; no touch was reported")
    return _save(figure, path)


def depth_map(
    path: Path,
    depth_um: Array,
    *,
    title: str,
    frame_bgr: npt.NDArray[np.uint8] | None = None,
    place_mm: Array | None = None,
    truth: tuple[Array, Array] | None = None,
) -> Path:
    """Depth of the surface, micrometres, over the image and along its deepest row; beside the camera image, if given.

    `place_mm` (n_y, n_x, 2) is where on the pad each cell looks (cells are counted without it). `truth` is the true
    surface: places (n_y, n_x, 2) in mm from the pad's centre and u_z (n_y, n_x) in micrometres.
    """
    row = int(np.unravel_index(int(depth_um.argmin()), depth_um.shape)[0])
    unit = "cell" if place_mm is None else "mm"
    x, y = np.indices(depth_um.shape)[::-1] if place_mm is None else np.moveaxis(place_mm, -1, 0)
    if frame_bgr is None:
        figure, (left, right) = _figure(11.0, 4.0, ncols=2)
    else:
        figure, (image_axis, left, right) = _figure(15.5, 4.0, ncols=3)
        _show_frame(image_axis, frame_bgr, "camera")
    shown = left.pcolormesh(x, y, depth_um, cmap="viridis_r", shading="gouraud")
    _seen_by_camera(left, f"x, {unit}", f"y, {unit}")
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
    groups = [(0, "F", "force, N"), (3, "M", "moment, N mm")]
    groups = [group for group in groups if np.isfinite(wrench[:, group[0] : group[0] + 3]).any()]
    figure, rows = _figure(10.0, 3.0 * len(groups), nrows=len(groups), sharex=True, squeeze=False)
    axes = rows[:, 0]
    for axis, (offset, letter, label) in zip(axes, groups, strict=True):
        for i, colour in enumerate(COLOURS):
            if np.isnan(wrench[:, offset + i]).all():
                axis.plot([], [], color=colour, label=f"{letter}$_{AXES[i]}$ not measured")
                continue
            axis.plot(time_s, wrench[:, offset + i], color=colour, label=f"{letter}$_{AXES[i]}$")
            if truth is not None:
                axis.plot(time_s, truth[:, offset + i], color="black", linewidth=0.9, linestyle="--")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.legend(**ABOVE)
    axes[-1].set_xlabel("time, s")
    figure.suptitle(title + ("   (dashed: simulated truth)" if truth is not None else ""))
    return _save(figure, path)
