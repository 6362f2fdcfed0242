"""Every stage of the frame path on one core, from pixels to encoded packets, and peers on the same input and run.

Without `--board`: a pad with 70 markers and 999 nodes, the default solve, seen by a 320x240 and by a 640x480 camera.
The input is a picture of the board's own dots, at rest and with a coloured dent, and a calibration made from the
board's own numbers, with its error model, without a camera map. What is measured is time, medians; accuracy has its own
evaluation. Peers take longer than a busy machine's time slice: theirs is processor time.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.container import base_metadata, pack, write
from ruffini.estimators.operator.fit import OperatorKind, make_operator
from ruffini.evaluate.flow import evaluate as evaluate_flow
from ruffini.evaluate.flow import table as flow_table
from ruffini.fem.operators import Noise

Array = npt.NDArray[np.float64]
DENT_RADIUS_UM = 2500.0
DENT_DEPTH_UM = 500.0
FLOW_FIELDS = 8  # of each texture
LEAST_FASTER = 5  # than OpenCV's DIS medium; measured 9 to 13 times
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


def picture(board: Board, *, is_pressed: bool, noise: int) -> npt.NDArray[np.uint8]:
    """A noisy frame: dots, and under pressure a coloured dent that drags the dots inwards."""
    rng = np.random.default_rng(noise)
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


LUCAS_KANADE = ("lucas_kanade/70", "lucas_kanade/all")
N_TOUCHES = 40  # for the error model: how good it is does not change its time
# Of the two boards that are measured by default: milliseconds that a frame and its photometric part may take.
WANTED_MS: dict[str, dict[str, float]] = {
    "320x240": {"whole frame": 1.5, "colour to depth": 0.6},
    "640x480": {"whole frame": 4.0},
}


# Ratios to peers that are wanted at both sizes, of the first at 320x240 only.
AT_MOST, AT_LEAST = "at most", "at least"
WANTED_RATIOS: dict[str, tuple[str, float, tuple[str, ...]]] = {
    "whole frame / Eigen product": (AT_MOST, 1.0, ("320x240",)),
    "Lucas-Kanade, 70 points / markers": (AT_LEAST, 3.0, ("320x240", "640x480")),
    "vendor's method / colour to depth": (AT_LEAST, 20.0, ("320x240", "640x480")),
}


def seventy_markers(width_px: int) -> Board:
    """gelslim's pad with 10 x 7 markers and 37 x 27 nodes, seen by a camera of `width_px` by 3/4 of it."""
    text = find_board("gelslim").text
    scale = width_px / 320
    for key, value in {
        "width_px": width_px,
        "height_px": width_px * 3 // 4,
        "focal_mpx": round(300_000 * scale),
        "center_x_mpx": round(500 * (width_px - 1)),
        "center_y_mpx": round(500 * (width_px * 3 // 4 - 1)),
    }.items():
        text = re.sub(rf"^{key} = \d+", f"{key} = {value}", text, count=1, flags=re.MULTILINE)
    head, markers = text.split("[markers]")
    head = head.replace("n_x = 31", "n_x = 37").replace("n_y = 25", "n_y = 27")
    for old, new in {
        "n_x = 19": "n_x = 10",
        "n_y = 15": "n_y = 7",
        "pitch_x_um = 1000": "pitch_x_um = 1900",
        "pitch_y_um = 1000": "pitch_y_um = 2200",
        "first_x_um = 1000": "first_x_um = 1450",
        "first_y_um = 1000": "first_y_um = 1400",
    }.items():
        markers = markers.replace(old, new)
    return parse_board(f"{head}[markers]{markers}".encode(), f"{width_px}x{width_px * 3 // 4}")


def solve_tensors(board: Board) -> OperatorKind:
    """What the default solve reads; it knows the pad, not the camera."""
    return make_operator(board, method="support", noise=Noise((5e-6, 5e-6, 2e-5)), n_touches=N_TOUCHES)


def make_data(board: Board, folder: Path, kind: OperatorKind) -> None:
    """Everything that ruffini_bench reads."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "board.toml").write_text(board.text)
    for noise, name in enumerate(("rest", "pressed", "untouched", "pressed_again")):
        pixels = picture(board, is_pressed=name.startswith("pressed"), noise=noise)
        (folder / f"{name}.bgr").write_bytes(pixels.tobytes())
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


def run_kernels(binary: Path, folder: Path, only: str = "") -> dict[str, dict[str, Any]]:
    """google-benchmark's results by name; `only`: of the benchmark of this name."""
    command = [str(binary), f"--data={folder}", "--benchmark_format=json"]
    command += [f"--benchmark_filter=^{only}$"] if only else []
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{binary} failed: {done.stderr.strip()}")
    return {b["name"]: b for b in json.loads(done.stdout)["benchmarks"]}


def best_ms(work: Callable[[], object], seconds: float = 1.0) -> float:
    """Median milliseconds of processor time of one call: what else the machine does is not counted."""
    work()
    times = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
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


def vendor_depth(pixels: npt.NDArray[np.uint8], weights: list[npt.NDArray[np.float32]]) -> Array:
    """Depth as the GelSight SDK computes it: colour and place of each pixel through a network, then Poisson.

    Its sizes (gsrobotics, utilities/reconstruction.py: 5, 64, 64, 64, 2, ReLU, float32; Poisson in float64) in numpy,
    with other weights; not its program.
    """
    n_y, n_x = pixels.shape[:2]
    y, x = np.mgrid[:n_y, :n_x]
    values = np.column_stack((pixels.reshape(-1, 3) / 255, y.ravel() / n_y, x.ravel() / n_x)).astype(np.float32)
    for i, weight in enumerate(weights):
        values = values @ weight
        if i + 1 < len(weights):
            np.maximum(values, 0, out=values)
    normal = np.clip(values.astype(float), -0.7, 0.7).reshape(n_y, n_x, 2)
    slope = -normal / np.sqrt(1 - np.square(normal).sum(axis=2, keepdims=True))
    return scipy_poisson(slope[..., 0], slope[..., 1])


def measure(build: Path, board: Board, label: str, kind: OperatorKind) -> dict[str, Any]:
    """Milliseconds of our stages and of their peers on one board's pictures."""
    folder = build / "bench" / label
    make_data(board, folder, kind)
    results = run_kernels(build / "ruffini_bench", folder)
    frame = results["frame"]
    camera, step = board.camera, board.depth.step_px
    rng = np.random.default_rng(0)

    def poisson_ms(shape: tuple[int, int]) -> float:
        slopes = rng.normal(size=(2, *shape)).astype(np.float32)
        return best_ms(lambda: scipy_poisson(slopes[0], slopes[1]))

    sizes = (5, 64, 64, 64, 2)
    weights = [rng.normal(0, 0.2, pair).astype(np.float32) for pair in itertools.pairwise(sizes)]
    pressed = picture(board, is_pressed=True, noise=1)
    vendor_ms = best_ms(lambda: vendor_depth(pressed, weights))
    cells = (camera.height_px // step, camera.width_px // step)
    n = int(results["eigen_gemv"]["n"])
    followed = {
        int(results[name]["points"]): results[name]["cpu_time"] / 1e6 for name in LUCAS_KANADE if name in results
    }
    peers: list[list[Any]] = [["markers", f"OpenCV Lucas-Kanade, {count} points", ms] for count, ms in followed.items()]
    peers += [
        ["poisson", f"scipy float32 Poisson, {shape[1]}x{shape[0]}", poisson_ms(shape)]
        for shape in dict.fromkeys([cells, (camera.height_px, camera.width_px)])
    ]
    peers.append(["operator", f"Eigen float32 {n}x{n} times vector", results["eigen_gemv"]["cpu_time"] / 1e6])
    peers.append(["poisson", f"GelSight SDK's method in numpy, {board.resolution}, colour to depth", vendor_ms])
    ours = {s: frame[s] / 1e6 for s in [*board.pipeline.stages, "packets"] if s in frame}
    depth_ms = sum(ours[s] for s in ("difference", "photometric", "poisson") if s in ours)
    whole_ms, product_ms = frame["whole_frame"] / 1e6, results["eigen_gemv"]["cpu_time"] / 1e6
    ratios = {"whole frame / Eigen product": whole_ms / product_ms}
    if "markers" in ours and 70 in followed:
        ratios["Lucas-Kanade, 70 points / markers"] = followed[70] / ours["markers"]
    if "poisson" in ours:
        ratios["vendor's method / colour to depth"] = vendor_ms / depth_ms
    return {
        "board": label,
        "size": f"{camera.width_px}x{camera.height_px}",
        "cells": f"{cells[1]}x{cells[0]}",
        "markers": 0 if board.markers is None else board.markers.n_x * board.markers.n_y,
        "nodes": n // 3,
        "touched_nodes": int(frame["touched_nodes"]),
        "packet_bytes": int(frame["packet_bytes"]),
        "stages_ms": ours,
        "sums_ms": {
            "colour to depth": depth_ms,
            "whole frame": whole_ms,
            "residual, asked": frame["residual"] / 1e6,  # besides the frame, its packet included
        },
        "wanted_ms": WANTED_MS.get(label, {}),
        "peers_ms": peers,
        "ratios": ratios,
        "memory_copy_gb_s": results["memory_copy"]["bytes_per_second"] / 1e9,
    }


def table(m: dict[str, Any]) -> str:
    """What `measure` found, as text."""
    lines = [
        f"{m['board']}: {m['size']}, {m['markers']} markers, {m['nodes']} nodes ({m['touched_nodes']} touched), "
        f"depth on {m['cells']} cells, packets of {m['packet_bytes'] / 1e3:.0f} kB; one core, median milliseconds"
    ]
    for stage, value in m["stages_ms"].items():
        first, *more = [f"{ms:8.3f}  {name}" for of, name, ms in m["peers_ms"] if of == stage] or [""]
        lines.append(f"  {stage:16}{value:8.3f}   {first}".rstrip())
        lines += [f"  {'':24}   {peer}" for peer in more]
    for name, value in m["sums_ms"].items():
        wanted = m["wanted_ms"].get(name)
        lines.append(f"  {name:16}{value:8.3f}" + (f"   wanted: at most {wanted:g}" if wanted else ""))
    for name, value in m["ratios"].items():
        sense, limit, labels = WANTED_RATIOS[name]
        is_met = value <= limit if sense == AT_MOST else value >= limit
        wanted = f"   wanted: {sense} {limit:g}: {'met' if is_met else 'NOT met'}" if m["board"] in labels else ""
        lines.append(f"  {name:36}{value:6.2f}{wanted}")
    return "\n".join([*lines, f"  {'memory copy':16}{m['memory_copy_gb_s']:8.1f}   GB/s on this machine"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("--board", help="a board's name, instead of the two")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the tables")
    arguments = parser.parse_args()
    boards = [find_board(arguments.board)] if arguments.board else [seventy_markers(320), seventy_markers(640)]
    kind = solve_tensors(boards[0])
    found = []
    for board in boards:
        label = board.name if arguments.board else f"{board.camera.width_px}x{board.camera.height_px}"
        found.append(measure(arguments.build, board, label, kind))
        if not arguments.json:
            print(table(found[-1]), flush=True)
    textures = evaluate_flow(None, None, n_fields=FLOW_FIELDS)["textures"]
    if arguments.json:
        print(json.dumps({"boards": found, "flow": textures}))
    else:
        print(flow_table({"textures": textures}))
    for name, row in textures.items():
        if row["ruffini"]["ms"] * LEAST_FASTER > row["medium"]["ms"]:
            sys.exit(f"bench: flow on {name} is not {LEAST_FASTER} times as fast as DIS medium, see the table")


if __name__ == "__main__":
    main()
