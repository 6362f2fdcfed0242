"""All checks, as a table and as a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ruffini.sim.validation import contacts, platforms, shells, skins, solids
from ruffini.sim.validation.rows import Outcome
from ruffini.tables import aligned


def validate(*, quick: bool, progress: Callable[[float], None] = lambda _: None) -> Outcome:
    """Every check; `quick` takes coarser references and one pad for two checks."""
    out = Outcome()
    contacts.run(out, quick=quick, progress=lambda done: progress(0.5 * done))
    solids.run(out, quick=quick, progress=lambda done: progress(0.5 + 0.45 * done))
    shells.run(out)
    platforms.run(out)
    skins.run(out)
    progress(1.0)
    return out


def as_dict(out: Outcome) -> dict[str, Any]:
    """For --json."""
    return {
        "simulated": True,
        "good": all(row.is_good for row in out.rows),
        "rows": [
            {
                "check": row.check, "quantity": row.quantity, "unit": row.unit, "theory": row.theory,
                "twin": row.twin, "error": row.error, "tolerance": row.tolerance, "good": row.is_good,
            }
            for row in out.rows
        ],
    }  # fmt: skip


def as_text(out: Outcome) -> str:
    """Theory beside the twin."""
    before = [None, *(row.check for row in out.rows)]
    lines = aligned(("", "", "theory", "twin", "unit", "error", "allowed", ""), [
        (
            "" if row.check == last else row.check, row.quantity, _number(row.theory), _number(row.twin), row.unit,
            _per_cent(row.error), f"{100 * row.tolerance:g} %", "" if row.is_good else "OUTSIDE",
        )
        for row, last in zip(out.rows, before, strict=False)
    ])  # fmt: skip
    n_bad = sum(not row.is_good for row in out.rows)
    lines.append(f"{len(out.rows)} numbers, {n_bad} outside" if n_bad else f"{len(out.rows)} numbers, all within")
    return "\n".join(lines)


def _number(value: float) -> str:
    return "0" if abs(value) < 1e-9 else f"{value:.4g}"


def _per_cent(value: float) -> str:
    return "0.00 %" if abs(value) < 5e-5 else f"{100 * value:.2f} %"


def picture(out: Outcome, path: Path) -> None:
    """Lines of theory, points of the twin."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(out.curves), figsize=(4.2 * len(out.curves), 3.6))
    for axis, curve in zip(axes, out.curves, strict=True):
        axis.plot(*curve.theory, color="black", lw=1.2, label="theory")
        axis.plot(*curve.twin, "o", color="tab:orange", ms=6, label="twin")
        axis.set(title=curve.title, xlabel=curve.x_label, ylabel=curve.y_label)
        if curve.x_label.startswith("time"):
            axis.set_xscale("log")
        axis.grid(alpha=0.3)
        axis.legend()
    figure.suptitle("The digital twin beside theory, SIMULATED", fontsize=11)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
