"""A fleet as one HTML page: each unit, their spread, who stands out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.fleet.units import Fleet, Unit
from ruffini.calibrate.report.html import Page
from ruffini.estimators.operator.fit import board_slab


def write_fleet_page(path: Path, board: Board, fleet: Fleet) -> None:
    """Table and pictures of all units."""
    import matplotlib

    matplotlib.use("Agg")
    tree = fleet.report()
    page = Page(f"{tree['fitted']} units of {board.name}")
    page.text(f"Force error of touches left out: {1e3 * tree['after_rmse_n']:.1f} mN RMS over all units, each with its "
              f"own numbers; {1e3 * tree['before_rmse_n']:.1f} mN with the board's. Worst unit "
              f"{1e3 * tree['after_worst_n']:.1f} and {1e3 * tree['before_worst_n']:.1f} mN.")  # fmt: skip
    if tree["spread"]:
        page.text("Spread between units (standard deviation): E {:.1%}, Poisson's ratio {:.2%}, thickness {:.1%}."
                  .format(*tree["spread"]))  # fmt: skip
    page.picture(_picture(board, fleet), "E, Poisson's ratio, thickness and error of each unit")
    rows: list[tuple[Any, ...]] = []
    kinds = []
    for i, unit in enumerate(fleet.units):
        rows.append(_row(unit, fleet.outliers.get(i, "")))
        kinds.append("bad" if unit.material is None or i in fleet.outliers else "")
    head = ("unit", "touches", "E, kPa", "+-", "Poisson", "+-", "thickness, mm", "+-", "before, mN", "after, mN", "")
    page.table(head, rows, kinds)
    page.write(path)


def _row(unit: Unit, why: str) -> tuple[Any, ...]:
    if unit.material is None:
        return (unit.name, *[""] * 9, unit.error)
    e, nu, h = unit.material
    e_i, nu_i, h_i = unit.interval
    return (unit.name, unit.touches, e / 1e3, e_i / 1e3, nu, nu_i, 1e3 * h, 1e3 * h_i, 1e3 * unit.before_n,
            1e3 * unit.after_n, why)  # fmt: skip


def _picture(board: Board, fleet: Fleet) -> Any:
    import matplotlib.pyplot as plt

    slab = board_slab(board)
    units = [(i, u, u.material) for i, u in enumerate(fleet.units) if u.material is not None]
    number = [i + 1 for i, _, _ in units]
    colour = ["tab:red" if i in fleet.outliers else "tab:blue" for i, _, _ in units]
    figure, axes = plt.subplots(2, 2, figsize=(10, 5.4), sharex=True)
    shown = (
        ("E, kPa", [m.modulus_pa / 1e3 for _, _, m in units], [u.interval[0] / 1e3 for _, u, _ in units],
         slab.modulus_pa / 1e3),
        ("Poisson's ratio", [m.poisson for _, _, m in units], [u.interval[1] for _, u, _ in units], slab.poisson),
        ("thickness, mm", [1e3 * m.thickness_m for _, _, m in units], [1e3 * u.interval[2] for _, u, _ in units],
         1e3 * slab.thickness_m),
    )  # fmt: skip
    for axis, (label, values, interval, nominal) in zip(axes.ravel(), shown, strict=False):
        axis.errorbar(number, values, interval, fmt="none", ecolor="grey", capsize=2)
        axis.scatter(number, values, c=colour, zorder=3)
        axis.axhline(nominal, color="black", linewidth=0.8, linestyle="--", label="board")
        axis.set(ylabel=label)
        axis.legend(frameon=False, fontsize=8)
    last = axes[1, 1]
    last.plot(number, [1e3 * u.before_n for _, u, _ in units], "x", color="grey", label="board's numbers")
    last.scatter(number, [1e3 * u.after_n for _, u, _ in units], c=colour, label="its own, touches left out")
    last.set(ylabel="force error, RMS, mN", yscale="log")
    last.legend(fontsize=8, loc="best", framealpha=0.6)
    for axis in axes[1]:
        axis.set(xlabel="unit, as in the table below")
        axis.xaxis.get_major_locator().set_params(integer=True)
    figure.tight_layout()
    return figure
