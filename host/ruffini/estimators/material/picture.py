"""The residuals of a material fit as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ruffini.estimators.material.fit import MaterialFit

AXES = (("Fx, N", 1.0), ("Fy, N", 1.0), ("Fz, N", 1.0), ("Tx, N mm", 1e3), ("Ty, N mm", 1e3), ("Tz, N mm", 1e3))


def residuals(path: Path, fit: MaterialFit, *, title: str) -> Path:
    """Error of the wrench against the reference, axis by axis, with the board's numbers and with the fitted ones."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(11, 6))
    for i, (axis, (label, unit)) in enumerate(zip(axes.ravel(), AXES, strict=True)):
        true = fit.reference[:, i] * unit
        for name, wrench, style in (("board's numbers", fit.before, "x"), ("fitted", fit.after, ".")):
            error = wrench[:, i] * unit - true
            rmse = float(np.sqrt((error**2).mean()))
            axis.plot(true, error, style, label=f"{name}, RMSE {rmse:.3g}", markersize=5)
        axis.axhline(0, color="black", linewidth=0.6)
        axis.set(xlabel=f"reference {label}", ylabel="measured - reference")
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=8)
    figure.suptitle(title)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
