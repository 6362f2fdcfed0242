"""Fig. 4 to 6, Table I and Fig. 8 of the contact-model paper, drawn from runs on the twin. SIMULATED."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from papers.contact_glitter.played import Played
from papers.drawing import METHOD, OURS, PAPER, TRUTH, plots, save

COLOURS = {"triangle": "#E69F00", "flat": "#0072B2", "square": "#009E73", "sphere": "#CC79A7"}


def draw(out: Path, played: Sequence[Played], result: dict[str, Any]) -> list[Path]:
    """Those that the runs are enough for."""
    out.mkdir(parents=True, exist_ok=True)
    made = [_factors(out / "fig4_to_6_factors.png", played), _forces(out / "table1_forces.png", result)]
    made.append(_press(out / "fig8_presses.png", played))
    made.append(_hardness(out / "fig8_hardness.png", played))
    return made


def _factors(path: Path, played: Sequence[Played]) -> Path:
    plt = plots()
    figure, axes = plt.subplots(1, 3, figsize=(13, 4))
    for p in played:
        if p.recorded.set_name != "calibration":
            continue
        colour = COLOURS[p.shape]
        if p.shore_a >= 90:
            axes[0].plot(p.gel_mm, p.fall, color=colour, lw=1)
            root = np.sqrt(p.of("effective_area_um2") * 1e-6) * p.of("gel_depth_um") * 1e-3
            axes[1].plot(root, -p.truth[:, 2], color=colour, lw=1)
        axes[2].plot(p.shore_a, p.told.stiffness_pa_um * 1e-3, "o", color=colour, ms=2 + 0.4 * p.radius_mm, mfc="none")
    labels = (("gel depth, mm", "fall of the density", "Fig. 4: Shore A 90"),
              ("sqrt(S) d, mm2", "normal force, N", "Fig. 5: Shore A 90"),
              ("Shore A", "H_m, N/mm3", "Fig. 6: larger mark, larger object"))  # fmt: skip
    for axis, (x, y, title) in zip(axes, labels, strict=True):
        axis.set(xlabel=x, ylabel=y, title=title)
    for shape, colour in COLOURS.items():
        axes[0].plot([], [], color=colour, label=shape)
    axes[0].legend(fontsize=8)
    return save(figure, path, "Why single factors fail")


def _forces(path: Path, result: dict[str, Any]) -> Path:
    plt = plots()
    figure, axes = plt.subplots(1, 3, figsize=(13, 4))
    rows = result["forces"]
    x = np.arange(len(rows))
    for axis, what, unit in zip(axes, ("fn", "ft", "moment"), ("N", "N", "N m"), strict=True):
        bars = [(f"{what}_paper", "paper", PAPER), (f"{what}_method", "its method on the twin", METHOD),
                (what, "ours, against the truth", OURS)]  # fmt: skip
        for k, (name, label, colour) in enumerate(bars):
            if all(name in row for row in rows.values()):
                axis.bar(x + 0.27 * (k - 1), [r[name] for r in rows.values()], 0.25, label=label, color=colour)
        axis.set_xticks(x, list(rows))
        axis.set_ylabel(f"{what}, RMSE, {unit}")
        axis.margins(y=0.3)  # for the legend
        axis.legend(fontsize=8)
    return save(figure, path, "Table I")


def _press(path: Path, played: Sequence[Played]) -> Path:
    plt = plots()
    figure, axes = plt.subplots(1, 3, figsize=(13, 4))
    shown = [p for p in played if p.recorded.part == "judge" and not p.recorded.set_name.endswith("shear")]
    for shape in COLOURS:
        for p in [q for q in shown if q.shape == shape][-3:]:
            travel = p.recorded.truth["pose"][p.recorded.touched, 2] * 1e3
            told = (-p.wrench[:, 2], p.of("gel_depth_um") * 1e-3, p.of("shore_q4") / 16)
            true = (-p.truth[:, 2], p.gel_mm, np.full(len(travel), p.shore_a))
            for axis, ours, truth in zip(axes, told, true, strict=True):
                axis.plot(travel, ours, color=COLOURS[shape], lw=1)
                axis.plot(travel, truth, color=TRUTH, lw=0.7, ls=":")
    for axis, label in zip(axes, ("normal force, N", "gel depth, mm", "Shore A, from the third frame on"), strict=True):
        axis.set(xlabel="travel, mm", ylabel=label)
    return save(figure, path, "Fig. 8: presses in no fit, truth dotted")


def _hardness(path: Path, played: Sequence[Played]) -> Path:
    plt = plots()
    figure, axis = plt.subplots(figsize=(6, 5))
    for p in played:
        if p.recorded.part == "judge" and p.told.hardness_validity == 1:
            axis.errorbar(p.shore_a, p.told.shore_q4 / 16, p.told.shore_sigma_q4 / 16, fmt="o", ms=4, lw=0.7,
                          color=COLOURS.get(p.shape, METHOD))  # fmt: skip
    axis.plot([20, 95], [20, 95], color=TRUTH, lw=0.8)
    for shape, colour in COLOURS.items():
        axis.plot([], [], "o", color=colour, label=shape)
    axis.set(xlabel="Shore A", ylabel="told, with its stated sigma")
    axis.legend(fontsize=8)
    return save(figure, path, "Fig. 8(f): hardness of presses in no fit, kind inferred")
