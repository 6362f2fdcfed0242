"""What the pictures of the experiments have in common: colours, and how one is saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

OURS, PAPER, TRUTH, METHOD = "#0072B2", "#D55E00", "#000000", "#999999"


def plots() -> Any:
    """matplotlib.pyplot without a screen."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def save(figure: Any, path: Path, title: str) -> Path:
    """The figure with its title, closed."""
    figure.suptitle(f"{title}, SIMULATED")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plots().close(figure)
    return path
