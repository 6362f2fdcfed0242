"""Studies for who designs a pad: force over displacement at several hardnesses and thicknesses, and where it collapses.

As the stereo fingertip's paper chose its rubber (its Fig. 5 and 6). A press is led by displacement, so that what is
beyond a collapse is seen too: the force falls although the tool goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import RuffiniError
from ruffini.sim.indenters import Indenter, shore_a_modulus
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.unit import PadError, TwinUnit
from ruffini.sim.units import build_unit

Array = npt.NDArray[np.float64]

FALL = 0.02  # of the largest force so far, by which a press is called a collapse
N_STEPS = 24


@dataclass(frozen=True)
class Curve:
    """One body: displacement of the tool (mm) and its force (N); where it ended early, why.

    collapse_n : force from which on it gives way without more; None where it never does.
    """

    label: str
    modulus_pa: float
    thickness_mm: float
    depth_mm: Array
    force_n: Array
    ended: str = ""

    @property
    def collapse_n(self) -> float | None:
        highest = np.maximum.accumulate(self.force_n)
        fallen = np.flatnonzero(self.force_n < (1 - FALL) * highest)
        return float(highest[fallen[0]]) if fallen.size else None

    def depth_at(self, force_n: float) -> float | None:
        """Displacement (mm) at which the force is first reached; None where it never is."""
        reached = np.flatnonzero(self.force_n >= force_n)
        if not reached.size:
            return None
        i = int(reached[0])
        before = (self.depth_mm[i - 1], self.force_n[i - 1]) if i else (0.0, 0.0)
        part = (force_n - before[1]) / (self.force_n[i] - before[1])
        return float(before[0] + part * (self.depth_mm[i] - before[0]))


def study(
    board: Board,
    *,
    shore_a: Sequence[float],
    thickness_mm: Sequence[float],
    indenter: Indenter,
    depth_mm: float,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Curve]:
    """A curve of the board as it is, one for each hardness at its thickness, one for each thickness at its modulus.

    Raises
    ------
    InputError
        A hardness or thickness cannot be, or the board has no body to press.
    """
    own = board.pad.modulus_pa
    bodies = [("as it is", 1.0, 1.0)]
    bodies += [(f"Shore A {s:g}", shore_a_modulus(s) / own, 1.0) for s in shore_a]
    bodies += [(f"{t:g} mm", 1.0, t * 1e3 / board.pad.thickness_um) for t in thickness_mm]
    curves = []
    for i, (label, modulus, thickness) in enumerate(bodies):
        unit = _unit(board, modulus, thickness)
        depths, forces, ended = _pressed(unit, indenter, depth_mm)
        curves.append(
            Curve(label, own * modulus, board.pad.thickness_um * 1e-3 * thickness, depths, forces, ended)
        )  # fmt: skip
        progress((i + 1) / len(bodies))
    return curves


def _unit(board: Board, modulus: float, thickness: float) -> Unit:
    unit = build_unit(board, PadError(thickness=thickness) if thickness != 1 else None)
    if type(unit) is TwinUnit:  # a linear slab's compliance goes with 1 / E: nothing is solved again
        model = replace(unit.model, modulus_pa=unit.model.modulus_pa * modulus)
        return replace(unit, model=model, compliance=unit.compliance / modulus)
    return unit if modulus == 1 else build_unit(board, PadError(modulus=modulus, thickness=thickness))


def _pressed(unit: Unit, indenter: Indenter, depth_mm: float) -> tuple[Array, Array, str]:
    """Displacement and force of a press, as far as the body's model goes."""
    rig = unit.rig()
    rig.take(indenter)
    depths, forces = [0.0], [0.0]
    for depth in depth_mm * (np.arange(N_STEPS) + 1) / N_STEPS:
        try:
            rig.advance(Pose(0.0, 0.0, float(depth) * 1e-3))
        except RuffiniError as error:
            return np.array(depths), np.array(forces), str(error)
        depths.append(float(depth))
        forces.append(float(np.linalg.norm(rig.wrench()[:3])))
    return np.array(depths), np.array(forces), ""


def picture(path: Path, board: Board, curves: list[Curve], force_n: float) -> None:
    """Hardnesses on the left, thicknesses on the right; a dot where a body collapses, a line at the wanted force."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), sharey=True)
    for axis, title, wanted in zip(axes, ("hardness", "thickness"), ("Shore", "mm"), strict=True):
        for curve in curves:
            if curve.label != "as it is" and wanted not in curve.label:
                continue
            style = {"color": "black", "linestyle": "--"} if curve.label == "as it is" else {}
            axis.plot(curve.depth_mm, curve.force_n, label=curve.label, **style)
            if (collapse := curve.collapse_n) is not None:
                i = int(np.argmax(curve.force_n >= collapse))
                axis.plot(curve.depth_mm[i], curve.force_n[i], "o", color="black", markersize=5)
        axis.axhline(force_n, color="grey", linewidth=0.8)
        axis.set(title=title, xlabel="displacement of the tool, mm", xlim=(0, None), ylim=(0, 2.5 * force_n))
        axis.legend()
    axes[0].set_ylabel("force, N")
    figure.suptitle(f"{board.name}, SIMULATED: dots are collapses, the line is {force_n:g} N")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    plt.close(figure)
