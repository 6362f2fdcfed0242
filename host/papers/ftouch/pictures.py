"""Fig. 7, 8 and 10 of the sprung tray's paper, drawn from runs on the twin. SIMULATED."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from papers.ftouch.played import Played
from ruffini.estimators.wrench.model import AXES

# Fig. 7: what is applied, and which condition of Table II that is; the last one is twisted both ways.
RESPONSES = (
    ("+Fx -Ty", 11, 1), ("-Fy -Tx", 13, 1), ("-Fx +Fy +Tx +Ty", 16, 1), ("-Fx -Fy -Tx +Ty", 14, 1),
    ("-Fz +Tx", 7, 1), ("-Fz +Ty", 5, 1), ("-Fz -Tx", 3, 1), ("+Tz", 17, 1), ("-Tz", 17, -1),
)  # fmt: skip
ARROW = 6.0  # times the shift
RING = 8.0  # times the change of the radius
OURS, PAPER, TRUTH = "#0072B2", "#D55E00", "#000000"
UNITS = ("N", "N", "N", "N mm", "N mm", "N mm")


def draw(out: Path, sets: Mapping[str, Sequence[Played]]) -> list[Path]:
    """Those that the runs are enough for."""
    out.mkdir(parents=True, exist_ok=True)
    loads = [group for group in sets.values() if "condition" in group[0].recorded.run.chosen]  # the largest last
    shown = [group[0] for group in sets.values() if group[0].recorded.part == "show"]
    made = []
    if loads:
        made += [_responses(out / "fig7_responses.png", loads[-1]), _traces(out / "fig8_traces.png", loads[0])]
    if shown:
        made.append(_objects(out / "fig10_objects.png", shown))
    return made


def _plots() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 9, "axes.titlesize": 9, "figure.dpi": 110})
    return plt


def _save(figure: Any, path: Path) -> Path:
    figure.savefig(path)
    _plots().close(figure)
    return path


def _responses(path: Path, loads: Sequence[Played]) -> Path:
    """Nine loads: the targets at rest, their shift as arrows, their change of size as rings, all enlarged."""
    plt = _plots()
    figure, axes = plt.subplots(3, 3, figsize=(9, 7.5), constrained_layout=True)
    for axis, (title, condition, sign) in zip(axes.ravel(), RESPONSES, strict=True):
        p = next(p for p in loads if p.recorded.run.chosen["condition"] == condition)
        strongest = np.abs(p.truth / np.abs(p.truth).max(axis=0).clip(1e-9)).sum(axis=1)
        if condition == RESPONSES[-1][1]:
            strongest = sign * p.truth[:, 5]
        t = int(np.argmax(strongest))
        picture = p.recorded.picture(int(p.recorded.touched[0]) + t)
        axis.imshow(picture[..., ::-1], alpha=0.55)
        for (dx, dy, da), (x, y, radius) in zip(p.features[t], p.places_px, strict=True):
            axis.annotate("", (x + ARROW * dx, y + ARROW * dy), (x, y),
                          arrowprops={"arrowstyle": "-|>", "color": "white", "lw": 1.8})  # fmt: skip
            grown = radius + RING * da / (2 * np.pi * radius)
            axis.add_patch(plt.Circle((x, y), max(grown, 2), fill=False, color="yellow", lw=1.4))
            axis.add_patch(plt.Circle((x, y), radius, fill=False, color="white", lw=0.8, ls=":"))
        said = p.truth[t]
        numbers = ", ".join(f"{n} {said[i]:+.2g} {UNITS[i]}" for i, n in enumerate(AXES) if n in title)
        axis.set(xticks=[], yticks=[])
        axis.set_title(f"{title}\n{numbers}", fontsize=7.5)
        axis.set(xlim=(0, picture.shape[1]), ylim=(picture.shape[0], 0))
    figure.suptitle(f"Fig. 7, SIMULATED: shifts x {ARROW:.0f} (arrows), change of radius x {RING:.0f} (yellow)")
    return _save(figure, path)


def _traces(path: Path, loads: Sequence[Played]) -> Path:
    """Six components over all loads one after the other."""
    plt = _plots()
    figure, axes = plt.subplots(6, 1, figsize=(11, 11), constrained_layout=True, sharex=True)
    rate_hz = 30.0
    for i, axis in enumerate(axes):
        lines = {name: np.concatenate([getattr(p, name)[:, i] for p in loads]) for name in ("truth", "paper", "ours")}
        time_s = np.arange(len(lines["truth"])) / rate_hz
        for name, colour, width in (("paper", PAPER, 0.8), ("ours", OURS, 1.0), ("truth", TRUTH, 0.7)):
            label = {"paper": "paper's method", "ours": "ruffini", "truth": "truth"}[name]
            axis.plot(time_s, lines[name], color=colour, lw=width, label=label, ls="--" if name == "truth" else "-")
        axis.set_ylabel(f"{AXES[i]}, {UNITS[i]}")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower right", ncols=3)
    axes[-1].set_xlabel("s, loads one after the other")
    figure.suptitle("Fig. 8, SIMULATED: other loads by hand on the connector")
    return _save(figure, path)


def _objects(path: Path, shown: Sequence[Played]) -> Path:
    """Three objects: picture, depth of the same frame, and the wrench over the press."""
    plt = _plots()
    figure, axes = plt.subplots(len(shown), 3, figsize=(12, 3.3 * len(shown)), constrained_layout=True, squeeze=False)
    for row, p in zip(axes, shown, strict=True):
        deepest = int(np.argmin(p.truth[:, 2]))
        row[0].imshow(p.recorded.picture(int(p.recorded.touched[0]) + deepest)[..., ::-1])
        row[0].set(title=p.recorded.run.settings.what, xticks=[], yticks=[])
        if p.depth_um is not None:
            image = row[1].imshow(p.depth_um, cmap="cividis")
            figure.colorbar(image, ax=row[1], label="um")
        row[1].set(title="depth of the same frame", xticks=[], yticks=[])
        time_s = np.arange(len(p.truth)) / 30.0
        torque = row[2].twinx()
        for i, name in enumerate(AXES):
            axis = row[2] if i < 3 else torque
            colour = ("#D55E00", "#009E73", "#0072B2")[i % 3]
            axis.plot(time_s, p.ours[:, i], color=colour, ls="-" if i < 3 else "--", lw=1.2, label=name)
            axis.plot(time_s, p.truth[:, i], color="black", lw=0.5)
        row[2].set(title="wrench (black: truth)", xlabel="s", ylabel="N")
        torque.set_ylabel("N mm")
        row[2].legend(loc="upper left", bbox_to_anchor=(1.22, 1.0), fontsize=8)
        torque.legend(loc="lower left", bbox_to_anchor=(1.22, 0.0), fontsize=8)
    figure.suptitle("Fig. 10, SIMULATED: shape and wrench from the same frame")
    return _save(figure, path)
