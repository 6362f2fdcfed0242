"""Depth at each patch, by the board's map and by four routes, against the twin's gel. SIMULATED.

    python tests/bench/contact_depth.py --calibration contact.safetensors --recording RUNS... --picture depth.png

RUNS are folders of presses of `ruffini reproduce --only recordings`, such as `test`, of which nothing is fitted. Of
each press the frame whose told gel depth is nearest to 1.2 mm. `map` is the DEPTH that the board sends, read where the
patch is seen; every other route's mean over the told area is the told depth:

    density      fall of the density, smoothed
    phi          potential of the flow's curl-free part (stage helmholtz), its lowest place zero
    flat         the same everywhere
    kind         flat, or a parabola where the contact is told Hertzian

By shape: RMS error in mm over the patches that touch; of the map also elsewhere, and over all frames of the press.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from contact_frame import decomposed
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter, map_coordinates

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.core.pipeline import ModelledRow
from ruffini.frames import read_frames

Array = npt.NDArray[np.float64]
DEPTH_MM = 1.2
HERTZIAN = 2
ROUTES = ("map", "density", "phi", "flat", "kind")


def potential(fall: Array) -> Array:
    """phi of Laplace phi = -fall with no slope across the border, from its lowest place."""
    n_y, n_x = fall.shape
    wave = 4 - 2 * np.cos(np.pi * np.arange(n_x) / n_x)[None, :] - 2 * np.cos(np.pi * np.arange(n_y) / n_y)[:, None]
    wave[0, 0] = np.inf
    phi = np.asarray(idctn(dctn(fall, norm="ortho") / wave, norm="ortho"))
    return phi - phi.min()


def maps(flow: Array, away: Array, radius: float, kind: int) -> dict[str, Array]:
    """Shapes of the depth; flow in steps (n_y, n_x, 2), away from the middle and radius of the contact in steps."""
    edged = np.pad(flow, ((1, 1), (1, 1), (0, 0)), mode="edge")
    fall = (edged[1:-1, 2:, 0] - edged[1:-1, :-2, 0] + edged[2:, 1:-1, 1] - edged[:-2, 1:-1, 1]) / 2
    flat = np.ones_like(fall)
    parabola = np.maximum(1 - (away / radius) ** 2 / 2, 0)  # of a ball that touches within the radius
    return {"density": np.maximum(gaussian_filter(fall, 1), 0), "phi": potential(fall), "flat": flat,
            "kind": parabola if kind == HERTZIAN else flat}  # fmt: skip


class Seen(NamedTuple):
    """One frame: what is told, the flow (n_y, n_x, 2) um, told map (n_y, n_x) mm at the patches, truth there."""

    told: ModelledRow
    middle_um: tuple[int, int]
    flow: Array
    told_mm: Array
    true_mm: Array
    touches: npt.NDArray[np.bool_]


def lattice_um(board: Board) -> tuple[Array, Array]:
    """Places of the patches from the pad's corner, (n_y, n_x) each."""
    assert board.markers is not None
    m = board.markers
    x, y = np.meshgrid(m.first_x_um + m.pitch_x_um * np.arange(m.n_x), m.first_y_um + m.pitch_y_um * np.arange(m.n_y))
    return x.astype(float), y.astype(float)


def at_patches(board: Board, core: Pipeline, flow_um: Array) -> Array:
    """The map in mm where the patches are seen: negative is out of the pad."""
    x, y = lattice_um(board)
    c, step = board.camera, core.layout.depth_step_px
    cells = []
    for at, size, center, moved in ((y, board.pad.size_y_um, c.center_y_mpx, flow_um[..., 1]),
                                    (x, board.pad.size_x_um, c.center_x_mpx, flow_um[..., 0])):  # fmt: skip
        px = (center + (at - size / 2 + moved) * c.focal_mpx / c.standoff_um) * 1e-3
        cells.append((px - (step - 1) / 2) / step)
    return np.asarray(map_coordinates(core.raw("depth") * -125e-6, cells, order=1, mode="nearest"))


def frames_of(board: Board, calibration: bytes, run: Path) -> list[Seen]:
    """Every touched frame of a press."""
    x, y = lattice_um(board)
    with np.load(run / "truth.npz") as truth:
        z_mm, contact = truth["displacement"][..., 2] * -1e3, truth["contact"].astype(float)
    at = [y / board.pad.size_y_um * (z_mm.shape[1] - 1), x / board.pad.size_x_um * (z_mm.shape[2] - 1)]
    um_per_px = 1e3 * board.camera.standoff_um / board.camera.focal_mpx
    out = []
    with Pipeline(board, calibration) as core:
        for i, image in enumerate(read_frames(run)):
            frame = core.process(np.asarray(image, dtype=np.uint8))
            if not (frame.has_reference and (told := core.modelled()).is_touched):
                continue
            flow_um = core.features().reshape(*x.shape, 2) / 65536 * um_per_px
            profile = core.profile()
            out.append(Seen(told, (profile.center_x_um, profile.center_y_um), core.curl_free_flow_q4() / 16.0,
                            at_patches(board, core, flow_um), map_coordinates(z_mm[i], at, order=1),
                            map_coordinates(contact[i], at, order=1) > 0.99))  # fmt: skip
    return out


def by_route(board: Board, seen: Seen) -> list[float] | None:
    """RMS in mm of each route, then of the map elsewhere; None where it is told nowhere or touches no patch."""
    x, y = lattice_um(board)
    assert board.markers is not None
    pitch_um = board.markers.pitch_x_um
    away = np.hypot(x - board.pad.size_x_um / 2 - seen.middle_um[0], y - board.pad.size_y_um / 2 - seen.middle_um[1])
    radius = np.sqrt(seen.told.area_um2 / np.pi)
    if not seen.touches.any() or not (away <= radius).any():
        return None
    shapes = maps(seen.flow / pitch_um, away / pitch_um, radius / pitch_um, seen.told.kind)
    scaled = {r: one / one[away <= radius].mean() * seen.told.gel_depth_um * 1e-3 for r, one in shapes.items()}
    scaled["map"] = seen.told_mm
    off = [scaled[route] - seen.true_mm for route in ROUTES]
    return [*(rms(one[seen.touches]) for one in off), rms(off[0][~seen.touches])]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def draw(path: Path, shown: list[tuple[str, Seen]]) -> None:
    """Told above, true below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, len(shown), figsize=(3.2 * len(shown), 5), layout="constrained", squeeze=False)
    for column, (name, seen) in zip(axes.T, shown, strict=True):
        deepest = seen.true_mm.max()
        for axis, values, what in zip(column, (seen.told_mm, seen.true_mm), ("told", "true"), strict=True):
            picture = axis.imshow(values, vmin=-0.2 * deepest, vmax=deepest, cmap="viridis")
            axis.set_title(f"{name}, {what}")
            axis.set_xticks([])
            axis.set_yticks([])
        figure.colorbar(picture, ax=column, label="mm", shrink=0.8)
    figure.suptitle("depth of the gel, SIMULATED")
    figure.savefig(path, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="contact-glitter")
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--recording", type=Path, nargs="+", required=True)
    parser.add_argument("--picture", type=Path)
    args = parser.parse_args()
    board, calibration = decomposed(find_board(args.board)), args.calibration.read_bytes()
    by_shape: dict[str, list[list[float]]] = {}
    whole: dict[str, list[Array]] = {}
    shown: dict[str, Seen] = {}
    for run in sorted(run for folder in args.recording for run in folder.iterdir()):
        shape = json.loads((run / "run.json").read_text())["chosen"]["indenter"]
        frames = frames_of(board, calibration, run)
        if not frames:
            continue
        nearest = min(frames, key=lambda seen: abs(seen.told.gel_depth_um * 1e-3 - DEPTH_MM))
        if (told := by_route(board, nearest)) is not None:
            by_shape.setdefault(shape, []).append(told)
            whole.setdefault(shape, []).extend((f.told_mm - f.true_mm)[f.touches] for f in frames)
            shown.setdefault(shape, nearest)
    for shape, rows in sorted(by_shape.items()):
        of = np.sqrt(np.mean(np.square(rows), axis=0))
        each = ", ".join(f"{route} {error:.2f}" for route, error in zip((*ROUTES, "map elsewhere"), of, strict=True))
        print(f"{shape:10} {len(rows):3} presses, mm: {each}; map, all frames {rms(np.concatenate(whole[shape])):.2f}")
    if args.picture is not None:
        draw(args.picture, list(shown.items()))


if __name__ == "__main__":
    main()
