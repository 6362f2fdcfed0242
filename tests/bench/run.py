"""One table: every stage of the frame path on one core, and peers on the same input in the same run.

The input is a picture of the board's own dots, at rest and with a coloured dent, and a calibration
made from the board's own numbers. What is measured is time; accuracy has its own evaluation.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from ruffini.boards import Board, find_board
from ruffini.calibrate.container import base_metadata, pack, write
from ruffini.calibrate.operator import make_operator
from ruffini.evaluate.flow import evaluate as evaluate_flow
from ruffini.evaluate.flow import table as flow_table
from ruffini.fem.operators import Noise

Array = npt.NDArray[np.float64]
DENT_RADIUS_UM = 2500.0
DENT_DEPTH_UM = 500.0
FLOW_FIELDS = 8  # of each texture
COLOUR_OF_SLOPE = 0.5  # relative change of blue per slope along x, of green along y


def dot_places(board: Board) -> Array:
    """Image places of the untouched markers, (n, 2) pixels."""
    camera, m = board.camera, board.markers
    px_per_um = camera.focal_mpx / 1000 / camera.standoff_um
    x = (m.first_x_um + np.arange(m.n_x) * m.pitch_x_um - board.pad.size_x_um / 2) * px_per_um
    y = (m.first_y_um + np.arange(m.n_y) * m.pitch_y_um - board.pad.size_y_um / 2) * px_per_um
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    center = np.array([camera.center_x_mpx, camera.center_y_mpx]) / 1000
    return np.asarray(grid + center)


def picture(board: Board, *, is_pressed: bool) -> npt.NDArray[np.uint8]:
    """A noisy frame: dots, and under pressure a coloured dent that drags the dots inwards."""
    rng = np.random.default_rng(int(is_pressed))
    camera = board.camera
    px_per_um = camera.focal_mpx / 1000 / camera.standoff_um
    center = np.array([camera.width_px, camera.height_px]) / 2 - 0.5
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    radius = DENT_RADIUS_UM * px_per_um
    inside = np.maximum(1 - ((x - center[0]) ** 2 + (y - center[1]) ** 2) / radius**2, 0)
    steepness = 4 * DENT_DEPTH_UM / DENT_RADIUS_UM / radius * inside * is_pressed
    change = np.stack([(x - center[0]) * steepness, (y - center[1]) * steepness, 0 * x], axis=2)
    level = 120 * (1 + COLOUR_OF_SLOPE * change)
    dot_radius = board.markers.diameter_um / 2 * px_per_um
    for place in dot_places(board):
        away = place - center
        pull = 0.05 * is_pressed * max(1 - float(away @ away) / radius**2, 0)
        distance = np.hypot(x - place[0] + pull * away[0], y - place[1] + pull * away[1])
        level *= 1 - 0.6 * np.clip(dot_radius + 0.5 - distance, 0, 1)[..., None]
    noisy = level + rng.normal(0, 1, level.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def make_data(board: Board, folder: Path) -> None:
    """Everything that ruffini_bench reads."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "board.toml").write_text(board.text)
    (folder / "rest.bgr").write_bytes(picture(board, is_pressed=False).tobytes())
    (folder / "pressed.bgr").write_bytes(picture(board, is_pressed=True).tobytes())
    kind = make_operator(board, method="support", noise=Noise((5e-6, 5e-6, 2e-5)))
    axis = np.linspace(-1, 1, 65)
    q_y, q_x = np.meshgrid(axis, axis, indexing="ij")
    length = np.minimum(np.hypot(q_x, q_y), 0.97)
    slope = np.stack([q_x, q_y], axis=2) / np.sqrt(1 - length**2)[..., None]
    unmix = np.zeros((13, 17, 2, 3), np.int16)
    unmix[..., 0, 0] = unmix[..., 1, 1] = round(4096 / COLOUR_OF_SLOPE)
    tables: dict[str, npt.NDArray[Any]] = {
        **kind.tensors,
        "photometric.unmix": unmix,
        "photometric.slope": np.clip(np.round(slope * 4096), -32767, 32767).astype(np.int16),
    }
    write(folder / "calibration.safetensors", pack(tables, {**base_metadata(board), **kind.metadata}))


def run_kernels(binary: Path, folder: Path) -> dict[str, dict[str, Any]]:
    """google-benchmark's results by name."""
    command = [str(binary), f"--data={folder}", "--benchmark_format=json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{binary} failed: {done.stderr.strip()}")
    return {b["name"]: b for b in json.loads(done.stdout)["benchmarks"]}


def best_ms(work: Callable[[], object], seconds: float = 1.0) -> float:
    """Median milliseconds of one call."""
    work()
    times = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times) * 1e3)


def scipy_poisson(gradient_x: Array, gradient_y: Array) -> Array:
    """The usual float Poisson solve: divergence, 2-D cosine transform, exact eigenvalues."""
    n_y, n_x = gradient_x.shape
    divergence = np.zeros((n_y, n_x), gradient_x.dtype)
    half_x = (gradient_x[:, 1:] + gradient_x[:, :-1]) / 2
    half_y = (gradient_y[1:] + gradient_y[:-1]) / 2
    divergence[:, :-1] += half_x
    divergence[:, 1:] -= half_x
    divergence[:-1] += half_y
    divergence[1:] -= half_y
    waves = scipy.fft.dctn(divergence, type=2, workers=1)
    eigenvalue = (2 - 2 * np.cos(np.pi * np.arange(n_x) / n_x))[None, :] + (
        2 - 2 * np.cos(np.pi * np.arange(n_y) / n_y)
    )[:, None]
    eigenvalue[0, 0] = 1
    waves /= -eigenvalue.astype(waves.dtype)
    waves[0, 0] = 0
    return np.asarray(scipy.fft.idctn(waves, type=2, workers=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    arguments = parser.parse_args()
    board = find_board(arguments.board)
    folder = arguments.build / "bench" / board.name
    make_data(board, folder)
    results = run_kernels(arguments.build / "ruffini_bench", folder)
    ms = {name: b["real_time"] / 1e6 for name, b in results.items()}
    frame = results["frame"]
    camera, step = board.camera, board.depth.step_px
    rng = np.random.default_rng(0)

    def poisson_ms(shape: tuple[int, int]) -> float:
        slopes = rng.normal(size=(2, *shape)).astype(np.float32)
        return best_ms(lambda: scipy_poisson(slopes[0], slopes[1]))

    cells = (camera.height_px // step, camera.width_px // step)
    n = int(results["eigen_gemv"]["n"])
    peers = {
        "markers": [
            (f"OpenCV Lucas-Kanade, {int(results[name]['points'])} points", ms[name])
            for name in ("lucas_kanade/70", "lucas_kanade/all")
        ],
        "poisson": [
            (f"scipy float32 Poisson, {shape[1]}x{shape[0]}", poisson_ms(shape))
            for shape in dict.fromkeys([cells, (camera.height_px, camera.width_px)])
        ],
        "operator": [(f"Eigen float32 {n}x{n} times vector", ms["eigen_gemv"])],
    }
    textures = evaluate_flow(None, None, n_fields=FLOW_FIELDS)["textures"]
    stages = [s for s in board.pipeline.stages if s in frame]
    gigabytes = results["memory_copy"]["bytes_per_second"] / 1e9
    if arguments.json:
        print(json.dumps({
            "board": board.name,
            "stages_ms": {s: frame[s] / 1e6 for s in stages},
            "frame_ms": ms["frame"],
            "peers_ms": {name: value for rows in peers.values() for name, value in rows},
            "memory_copy_gb_s": gigabytes,
            "flow": textures,
        }))  # fmt: skip
        return
    print(
        f"{board.name}, {camera.width_px}x{camera.height_px}, depth on {cells[1]}x{cells[0]} cells, "
        f"{int(frame['touched_nodes'])} nodes touched; one core, milliseconds"
    )
    for stage in stages:
        first, *more = [*peers.get(stage, []), ("", None)]
        print(f"  {stage:14}{frame[stage] / 1e6:8.3f}   {_peer(*first)}".rstrip())
        for peer in more:
            if peer[1] is not None:
                print(f"  {'':22}   {_peer(*peer)}")
    print(f"  {'whole frame':14}{ms['frame']:8.3f}   {1000 / ms['frame']:.0f} frames a second")
    print(flow_table({"textures": textures}))
    print(f"  memory copy   {gigabytes:8.1f}   GB/s on this machine")


def _peer(name: str, value: float | None) -> str:
    return "" if value is None else f"{value:8.3f}  {name}"


if __name__ == "__main__":
    main()
