"""The animation of README.md, from the output of `make run`: python docs/moving_picture.py out/run docs/field.webp

Every second frame of the recording goes through the device's arithmetic with the calibration of the run.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.core import Pipeline
from ruffini.demo.view import node_pixels
from ruffini.frames import read_frames

matplotlib.use("Agg")
from matplotlib import pyplot as plt

STEP = 2  # of the recording's frames
LONGEST_ARROW_PX = 28.0
FRAME_MS = 60
MAX_BYTES = 400_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="folder of `make run`")
    parser.add_argument("out", type=Path, help="WebP to write")
    options = parser.parse_args()
    file = container.read(options.run / "calibration.safetensors")
    board = find_board(container.board_of(file, None).name)
    truth = np.load(options.run / "recording" / "truth.npz")["force"]
    frames, measured = [], []
    with Pipeline(board, file.data) as pipeline:
        for image in read_frames(options.run / "recording"):
            pipeline.process(image)
            frames.append(image)
            measured.append(pipeline.force_n())
    rows, columns = board.observed
    true = truth[:, rows, columns]
    force = np.array(measured)
    pressed = np.flatnonzero(-true[..., 2].sum(axis=(1, 2)) > 0)
    shown = range(max(pressed[0] - 4, board.pipeline.n_rest_frames), min(pressed[-1] + 4, len(frames)), STEP)
    pictures = animate(frames, force, true, node_pixels(board), shown)
    pictures[0].save(
        options.out, save_all=True, append_images=pictures[1:], duration=FRAME_MS, loop=0, quality=45, method=6
    )
    if options.out.stat().st_size > MAX_BYTES:
        raise SystemExit(f"{options.out}: {options.out.stat().st_size} bytes, more than {MAX_BYTES}: raise STEP")


def animate(frames, force, true, node_px, shown) -> list[Image.Image]:
    high = 1e3 * max(float(-f[shown][..., 2].min()) for f in (force, true))
    longest_n = float(np.hypot(force[shown][..., 0], force[shown][..., 1]).max())
    pictures = []
    for i in shown:
        figure, axes = plt.subplots(1, 3, figsize=(9.0, 2.7), dpi=80, constrained_layout=True)
        shear = np.hypot(force[i, ..., 0], force[i, ..., 1])
        strong = shear > 0.1 * longest_n
        axes[0].imshow(frames[i][:, :, ::-1])
        axes[0].quiver(
            *node_px[strong].T, *(force[i][strong][:, :2] * LONGEST_ARROW_PX / longest_n).T, color="white",
            edgecolor="black", linewidth=0.4, width=0.005, angles="xy", scale_units="xy", scale=1.0,
        )  # fmt: skip
        axes[0].set_title(f"shear, longest arrow {1e3 * shear.max():.0f} mN", fontsize=9)
        for axis, name, values in ((axes[1], "measured", force[i]), (axes[2], "truth (simulated)", true[i])):
            total = -values[..., 2].sum()
            axis.pcolormesh(
                node_px[..., 0], node_px[..., 1], -1e3 * values[..., 2], cmap="cividis", vmin=0, vmax=high,
                shading="gouraud",
            )  # fmt: skip
            axis.set_aspect("equal")
            axis.invert_yaxis()
            axis.set_title(f"normal force {total:.2f} N, {name}", fontsize=9)
        for axis in axes:
            axis.set_axis_off()
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
        plt.close(figure)
        pictures.append(Image.open(buffer).convert("RGB"))
    return pictures


if __name__ == "__main__":
    main()
