"""Depth at each patch within the contact, by four routes, against the twin's gel. SIMULATED.

    python tests/bench/contact_depth.py --calibration contact.safetensors --recording RUNS...

RUNS are folders of presses of `ruffini sim reproduce --bench presses.toml`, such as `fit_01`. Of each press the frame
whose told gel depth is nearest to 1.2 mm. Every route's mean over the told area is the told depth:

    density      fall of the density, smoothed
    phi          potential of the flow's curl-free part (stage helmholtz), its lowest place zero
    flat         the same everywhere
    kind         flat, or a parabola where the contact is told Hertzian

By shape: RMS error in mm over the patches that touch.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
from contact_frame import decomposed
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter, map_coordinates

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.frames import read_frames

Array = npt.NDArray[np.float64]
DEPTH_MM = 1.2
HERTZIAN = 2
ROUTES = ("density", "phi", "flat", "kind")


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


def errors(board: Board, calibration: bytes, run: Path) -> list[float] | None:
    """RMS in mm of each route; None where it is told nowhere or touches no patch."""
    best = None
    with Pipeline(board, calibration) as core:
        for i, image in enumerate(read_frames(run)):
            frame = core.process(np.asarray(image, dtype=np.uint8))
            if not (frame.has_reference and (told := core.modelled()).is_touched):
                continue
            if best is None or abs(told.gel_depth_um * 1e-3 - DEPTH_MM) < abs(best[1].gel_depth_um * 1e-3 - DEPTH_MM):
                best = i, told, core.profile(), core.curl_free_flow_q4() / 16.0
    if best is None or board.markers is None:
        return None
    i, told, profile, flow = best
    m, n_y, n_x = board.markers, *flow.shape[:2]
    x = m.first_x_um + m.pitch_x_um * np.arange(n_x)[None, :] + np.zeros((n_y, 1))
    y = m.first_y_um + m.pitch_y_um * np.arange(n_y)[:, None] + np.zeros((1, n_x))
    with np.load(run / "truth.npz") as truth:
        z_mm, touches = truth["displacement"][i][..., 2] * 1e3, truth["contact"][i].astype(float)
    at = [y / board.pad.size_y_um * (z_mm.shape[0] - 1), x / board.pad.size_x_um * (z_mm.shape[1] - 1)]
    is_touched = map_coordinates(touches, at, order=1) > 0.99
    away = np.hypot(
        x - board.pad.size_x_um / 2 - profile.center_x_um, y - board.pad.size_y_um / 2 - profile.center_y_um
    )
    radius = np.sqrt(told.area_um2 / np.pi)
    if not is_touched.any() or not (away <= radius).any():
        return None
    true_mm = np.abs(map_coordinates(z_mm, at, order=1))
    shapes = maps(flow / m.pitch_x_um, away / m.pitch_x_um, radius / m.pitch_x_um, told.kind)
    scaled = [shapes[route] / shapes[route][away <= radius].mean() * told.gel_depth_um * 1e-3 for route in ROUTES]
    return [float(np.sqrt(np.mean((one - true_mm)[is_touched] ** 2))) for one in scaled]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="contact-glitter")
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--recording", type=Path, nargs="+", required=True)
    args = parser.parse_args()
    board, calibration = decomposed(find_board(args.board)), args.calibration.read_bytes()
    by_shape: dict[str, list[list[float]]] = {}
    for run in sorted(run for folder in args.recording for run in folder.iterdir()):
        shape = json.loads((run / "run.json").read_text())["chosen"]["indenter"]
        if (told := errors(board, calibration, run)) is not None:
            by_shape.setdefault(shape, []).append(told)
    for shape, rows in sorted(by_shape.items()):
        rms = np.sqrt(np.mean(np.square(rows), axis=0))
        each = ", ".join(f"{route} {error:.2f}" for route, error in zip(ROUTES, rms, strict=True))
        print(f"{shape:10} {len(rows):3} presses, mm: {each}")


if __name__ == "__main__":
    main()
