"""One contact sheared until it slides: what the board says of it beside the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.slip import INCIPIENT, JUDGED, SLIDING, STEP_MM, default_pipeline, simulate, watch
from ruffini.boards import Board
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit

SHOWN = JUDGED[1]
MAPS_AT = (0.35, 0.6, 0.85, 1.0)  # of the shear that slides
FREE, STICKS, SLIPS = "#ffffff", "#2166ac", "#d6604d"


def shear_until_it_slides(path: Path, board: Board) -> Path:
    """Four moments as maps, true above and the board's below; the way of shear, friction and share under them."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap

    unit = TwinUnit.build(board, twin=load_twin(board).with_pad(strain="linear", is_relaxing=False))
    run = simulate(unit, SHOWN)
    with default_pipeline(board) as pipeline:
        seen = watch(pipeline, run, Disturbance(white_um=WHITE_UM), np.random.default_rng(13))
    gross = run.gross or len(run.share) - 1
    load = run.shear_n / run.shear_n[gross]
    frames = [run.first_shear + int(np.argmax(load[run.first_shear :] >= part * 0.999)) for part in MAPS_AT]
    figure = plt.figure(figsize=(11, 8.2))
    grid = figure.add_gridspec(3, len(frames), height_ratios=(1, 1, 1.5))
    colours = ListedColormap([FREE, STICKS, SLIPS])
    truth = np.where(run.touched > 0.5, np.where(run.slipping > 0.5 * run.touched, 2, 1), 0)
    for column, t in enumerate(frames):
        for row, (name, plane) in enumerate((("truth", truth), ("board", seen.nodes))):
            axis = figure.add_subplot(grid[row, column])
            axis.imshow(plane[t], cmap=colours, vmin=0, vmax=2, interpolation="nearest")
            axis.set(xticks=[], yticks=[])
            if column == 0:
                axis.set_ylabel(name)
            if row == 0:
                axis.set_title(f"{100 * load[t]:.0f} % of the load that slides", fontsize=9)
    axis = figure.add_subplot(grid[2, :])
    way = np.maximum(np.arange(len(load)) - run.first_shear + 1, 0) * STEP_MM
    shown = slice(run.first_shear, None)
    friction = np.where(seen.column("friction_1e3") > 0, 1e-3 * seen.column("friction_1e3"), np.nan)
    sigma = 1e-3 * seen.column("friction_sigma_1e3")
    axis.plot(way[shown], run.share[shown], color="black", label="slipping share, true")
    axis.plot(way[shown], 1e-3 * seen.column("slip_share_1e3")[shown], color=SLIPS, label="slipping share, board")
    axis.plot(way[shown], 1e-3 * seen.column("shear_ratio_1e3")[shown], color=STICKS, label="|F_t| / F_n, board")
    axis.fill_between(way[shown], (friction - sigma)[shown], (friction + sigma)[shown], color="#1b7837", alpha=0.2)
    axis.plot(way[shown], friction[shown], color="#1b7837", label="friction, board, with its sigma")
    axis.axhline(SHOWN.friction, color="#1b7837", linestyle=":", label="friction, true")
    state = seen.column("slip_state")
    for value, words in ((INCIPIENT, "incipient"), (SLIDING, "slides")):
        first = int(np.argmax(state >= value))
        axis.axvline(way[first], color="grey", linewidth=0.8)
        axis.annotate(f"board: {words}", (way[first], 0.02), rotation=90, fontsize=8, ha="right")
    axis.axvline(way[gross], color="black", linewidth=0.8, linestyle="--")
    axis.annotate("true: slides", (way[gross], 0.6), rotation=90, fontsize=8, ha="right")
    axis.set(xlabel="way of the indenter sideways, mm", ylim=(0, 1.25))
    axis.legend(loc="upper left", fontsize=8)
    figure.suptitle(f"{board.name}, SIMULATED: {SHOWN.name}; noise 5/5/20 um; blue sticks, red slips", fontsize=11)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
