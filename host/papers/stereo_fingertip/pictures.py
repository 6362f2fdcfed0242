"""Force, place, angle and area of the fingertip's judged presses, drawn. SIMULATED."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from papers.stereo_fingertip.played import AREA, Played

WHOLE, PARTIAL, TRUTH = "#0072B2", "#D55E00", "#000000"
PANELS = (
    (0, "force, N"),
    (1, "way, mm"),
    (2, "X, mm"),
    (4, "roll, degrees"),
    (5, "pitch, degrees"),
    (AREA, "area where it is told, mm$^2$"),
)
TESTS = (
    ("test_force", 0, "force, N"),
    ("test_x", 2, "X, mm"),
    ("test_y", 3, "Y, mm"),
    ("test_angle", 4, "roll, degrees"),
)


def draw(out: Path, played: Sequence[Played]) -> list[Path]:
    """What ours says against what was, on presses that nothing was fitted on; the paper's tests over force."""
    import matplotlib

    matplotlib.use("Agg")
    out.mkdir(parents=True, exist_ok=True)
    return [_unseen(out, played), _tests(out, played)]


def _tests(out: Path, played: Sequence[Played]) -> Path:
    """Errors of the paper's tests over force: Tables A1 to A3, Fig. 19."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 4, figsize=(15, 4))
    for panel, (name, quantity, what) in zip(panels.flat, TESTS, strict=True):
        for p in played:
            if p.name == name and len(p.truth):
                is_aside, at = name in ("test_x", "test_y"), float(p.truth[-1, quantity])
                look = {"label": f"{at:+.0f} mm", "color": plt.get_cmap("turbo")(0.5 + at / 13)} if is_aside else {}
                panel.plot(p.truth[:, 0], np.abs(p.off[:, quantity]), ".-", lw=0.8, ms=4, **look)
        panel.set(xlabel="true force, N", ylabel=f"error of {what}")
        if panel.get_legend_handles_labels()[1]:
            panel.legend(fontsize=6, ncols=2)
    figure.suptitle("Stereo fingertip, the paper's tests, SIMULATED")
    figure.tight_layout()
    path = out / "paper_tests.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _unseen(out: Path, played: Sequence[Played]) -> Path:
    import matplotlib.pyplot as plt

    runs = [p for p in played if p.name in ("any", "upright", "centred", "middle") and len(p.truth)]
    figure, panels = plt.subplots(2, 3, figsize=(12, 7.5))
    for panel, (quantity, name) in zip(panels.flat, PANELS, strict=True):
        for is_whole, colour in ((True, WHOLE), (False, PARTIAL)):
            rows = [p.is_known & (p.is_whole == is_whole) for p in runs]
            truth = np.concatenate([p.truth[k, quantity] for p, k in zip(runs, rows, strict=True)])
            ours = np.concatenate([p.ours[k, quantity] for p, k in zip(runs, rows, strict=True)])
            is_told = (quantity != AREA) | (ours > 0)
            panel.plot(
                truth[is_told],
                ours[is_told],
                ".",
                color=colour,
                ms=3,
                label="whole face" if is_whole else "part of the face",
            )
        low, high = panel.get_xlim()
        panel.plot([low, high], [low, high], color=TRUTH, lw=0.8)
        panel.set(xlabel=f"true {name}", ylabel="ours")
    panels.flat[0].legend(fontsize=8)
    figure.suptitle("Stereo fingertip, unseen tools, places and angles, SIMULATED")
    figure.tight_layout()
    path = out / "unseen.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
