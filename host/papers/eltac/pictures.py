"""Fig. 9, 10, 11, 12 and 13 of the electroluminescent skin's paper, drawn from runs on the twin. SIMULATED."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from papers.drawing import METHOD, OURS, PAPER, TRUTH, plots, save
from papers.eltac.played import Played

SHOWN_N = 10.0


def draw(out: Path, played: Sequence[Played], result: dict[str, Any]) -> list[Path]:
    """Those that the runs are enough for."""
    out.mkdir(parents=True, exist_ok=True)
    made = [_places(out / "fig9_places.png", result), _where(out / "fig10_points.png", played)]
    made.append(_forces(out / "fig11_forces.png", played, result))
    made.append(_loops(out / "fig12_trials_loops.png", played, result))
    return made


def _places(path: Path, result: dict[str, Any]) -> Path:
    plt = plots()
    figure, axis = plt.subplots(figsize=(7, 4))
    rows = {k: v for k, v in result["places"].items() if "paper" in v}
    x = np.arange(len(rows))
    bars = (
        ("paper", "paper, measured by hand", PAPER),
        ("method_noted", "its method on the twin, measured by hand", METHOD),
        ("ours", "ours, against the truth", OURS),
    )
    for k, (name, label, colour) in enumerate(bars):
        axis.bar(x + 0.27 * (k - 1), [row[name] for row in rows.values()], 0.25, label=label, color=colour)
    axis.set_xticks(x, [f"indenter {k}" for k in rows])
    axis.set_ylabel("mean error of the place, mm")
    axis.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)  # above: the bars are as high
    return save(figure, path, "Fig. 9, a part of its 42 sets" if result["quick"] else "Fig. 9, 42 sets")


def _where(path: Path, played: Sequence[Played]) -> Path:
    plt = plots()
    figure, axis = plt.subplots(figsize=(9, 4.5))
    for p in played:
        if p.name.startswith("locate") and len(p.touches[-1]):
            found = p.touches[-1][0]
            axis.plot([p.place[0], found[0]], [p.place[1], found[1]], color=OURS, lw=1)
            axis.plot(*p.place, "o", color=TRUTH, ms=4, mfc="none")
            axis.plot(*found, ".", color=OURS, ms=4)
        if p.name == "force":
            axis.plot(*p.place, "s", color=PAPER, ms=9, mfc="none")
            axis.annotate(str(int(p.recorded.run.key[-4:]) + 1), p.place, xytext=(6, 4), textcoords="offset points")
    axis.set_xlabel("round the tube, mm")
    axis.set_ylabel("along it, mm")
    axis.margins(y=0.1)  # for the numbers
    axis.set_aspect("equal")
    return save(figure, path, "Fig. 10: points 1 to 10 (squares), 42 touches (rings) and where they are told (dots)")


def _forces(path: Path, played: Sequence[Played], result: dict[str, Any]) -> Path:
    plt = plots()
    runs = [p for p in played if p.name == "force"]
    figure, axes = plt.subplots(2, 5, figsize=(13, 5.5), sharex=True, sharey=True, squeeze=False)
    for axis, p in zip(axes.ravel(), runs, strict=False):
        used = p.cell < SHOWN_N
        axis.plot([0, SHOWN_N], [0, SHOWN_N], color=TRUTH, lw=0.8)
        quadratic = np.polyval(result["curve"], p.level)
        axis.plot(p.cell[used], quadratic[used], ".", color=METHOD, ms=4, label="the paper's method")
        axis.plot(p.cell[used], p.ours[used], ".", color=OURS, ms=4, label="ours")
        axis.set_title(f"point {int(p.recorded.run.key[-4:]) + 1}", fontsize=9)
    axes[0, 0].legend(fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("load cell, N")
    for row in axes:
        row[0].set_ylabel("told, N")
    return save(figure, path, "Fig. 11: 1 to 8 on pyramids, 9 and 10 between")


def _loops(path: Path, played: Sequence[Played], result: dict[str, Any]) -> Path:
    plt = plots()
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2))
    trials = [p for p in played if p.name == "repeat"]  # none in the quick subset
    for p in trials:
        used = p.cell < SHOWN_N
        axes[0].plot(p.level[used], p.cell[used], ".-", ms=4, lw=0.8, label=f"trial {p.recorded.run.chosen['trial']}")
    axes[0].set_xlabel("brightness, green + blue")
    axes[0].set_ylabel("load cell, N")
    if trials:
        axes[0].legend(fontsize=8)
    for p in (p for p in played if p.name == "loops"):
        speed = float(str(p.recorded.run.chosen["speed_um_s"])) * 1e-3
        axes[1].plot(p.way * 1e3, p.cell, lw=1, label=f"{speed:g} mm/s")
        used = p.load < SHOWN_N
        axes[2].plot(p.load[used], np.polyval(result["curve"], p.level)[used], ".", color=METHOD, ms=3)
        axes[2].plot(p.load[used], p.ours[used], ".", color=OURS, ms=3)
    axes[1].set_xlabel("way, mm")
    axes[1].set_ylabel("load cell, N")
    axes[1].legend(fontsize=8)
    axes[2].plot([0, SHOWN_N], [0, SHOWN_N], color=TRUTH, lw=0.8)
    axes[2].set_xlabel("load, N, down and up")
    axes[2].set_ylabel("told, N: ours blue, one quadratic grey")
    return save(figure, path, "Fig. 12 and 13: five trials, loops at five speeds")
