"""Force, place, angle and area of the fingertip's judged presses, drawn. SIMULATED."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ruffini.bench.experiments.stereo_pins import Played

WHOLE, PARTIAL, TRUTH = "#0072B2", "#D55E00", "#000000"
PANELS = (
    (0, "force, N"),
    (1, "way, mm"),
    (2, "X, mm"),
    (4, "roll, degrees"),
    (5, "pitch, degrees"),
    (6, "area, mm$^2$"),
)


def draw(out: Path, played: Sequence[Played]) -> list[Path]:
    """What ours says against what was, on presses that nothing was fitted on."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    out.mkdir(parents=True, exist_ok=True)
    runs = [p for p in played if p.name in ("any", "upright", "centred") and len(p.truth)]
    figure, panels = plt.subplots(2, 3, figsize=(12, 7.5))
    for panel, (quantity, name) in zip(panels.flat, PANELS, strict=True):
        for is_whole, colour in ((True, WHOLE), (False, PARTIAL)):
            rows = [p.is_known & (p.is_whole == is_whole) for p in runs]
            truth = np.concatenate([p.truth[k, quantity] for p, k in zip(runs, rows, strict=True)])
            ours = np.concatenate([p.ours[k, quantity] for p, k in zip(runs, rows, strict=True)])
            panel.plot(truth, ours, ".", color=colour, ms=3, label="whole face" if is_whole else "part of the face")
        low, high = panel.get_xlim()
        panel.plot([low, high], [low, high], color=TRUTH, lw=0.8)
        panel.set(xlabel=f"true {name}", ylabel="ours")
    panels.flat[0].legend(fontsize=8)
    figure.suptitle("Stereo fingertip, unseen tools, places and angles, SIMULATED")
    figure.tight_layout()
    path = out / "unseen.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return [path]
