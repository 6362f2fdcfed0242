"""Curves of `ruffini.bench.resolution`: response over spatial frequency, lines told apart over their distance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ruffini.bench.resolution import ENOUGH, HALF, named

LINES = {"default": ("-", 2.0), "raw": ("--", 1.0), "exact": (":", 1.0)}
WORDS = {"default": "board", "raw": "iFEM raw", "exact": "true nodal forces"}


def curves(path: Path, results: list[dict[str, Any]]) -> Path:
    """One colour a board, one kind of line a method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 5))
    for number, result in enumerate(results):
        for name, (dashes, width) in LINES.items():
            found = result["methods"][name]
            drawn = {"linestyle": dashes, "linewidth": width, "color": f"C{number}"}
            label = f"{named(result)}: {WORDS[name]}"
            left.plot(result["frequency_per_mm"], found["response"][found["worse_axis"]], **drawn)
            right.plot(result["distance_mm"], 100 * np.array(found["apart"]), label=label, **drawn)
        limit = result["node_limit_per_mm"]
        left.axvline(limit, color=f"C{number}", linewidth=0.6)
        left.annotate("1 / (2 steps)", (limit, 0.98), rotation=90, va="top", ha="right", fontsize=7, color=f"C{number}")
    left.axhline(HALF, color="grey", linewidth=0.6)
    left.set(
        xlabel="spatial frequency, 1/mm", ylabel="response of the normal force field", ylim=(0, 1.1), xlim=(0, None)
    )
    right.axhline(100 * ENOUGH, color="grey", linewidth=0.6)
    right.set(xlabel="distance of two lines, mm", ylabel="told apart, % of noisy repeats at the worst place")
    noise = "/".join(f"{v:g}" for v in results[0]["noise_um"])
    figure.suptitle(f"Resolution of the normal force field, SIMULATED, noise {noise} um", fontsize=11)
    figure.legend(*right.get_legend_handles_labels(), loc="lower center", ncols=len(results), fontsize=8)
    figure.tight_layout(rect=(0, 0.14, 1, 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    plt.close(figure)
    return path
