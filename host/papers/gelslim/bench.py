"""Inverse FEM: raw and ridge on the noisy surface displacement of the ten states.

Errors are relative L2 over all states, as NUMERICS has them: a state's tangential and normal nodal forces against
its own truth. The abstract that we have prints no figure, so nothing can be matched; the noise is frozen as chosen.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from papers.gelslim.method import InverseFem, Slab
from papers.recorded import Recorded
from ruffini.boards import Board

Array = npt.NDArray[np.float64]
WEIGHTS = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)


def judge(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """Figures of raw and ridge; the ridge's weight is the best one on the runs to fit."""
    raw, ridge, weight = paper_methods(board, runs)
    states = [last_frame(r) for r in runs if r.part == "judge"]
    figures: dict[str, float] = {}
    for name, g in (("raw", raw), ("ridge", ridge)):
        tangential, normal, resultant, _ = np.mean([_errors(g, *s) for s in states], axis=0)
        figures |= {f"{name}, tangential field": float(tangential), f"{name}, normal field": float(normal),
                    f"{name}, resultant": float(resultant)}  # fmt: skip
        figures[f"{name}, shear over normal, S1"] = float(_errors(g, *states[0])[3])
    figures["ridge, weight"] = weight
    return figures


def paper_methods(board: Board, runs: list[Recorded]) -> tuple[Array, Array, float]:
    """Matrices of raw and of ridge with the weight that is best on the runs to fit, and that weight."""
    pad, grid = board.pad, board.grid
    fem = InverseFem.of(
        Slab(
            (pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6), pad.modulus_pa,
            pad.poisson_1e4 * 1e-4, grid.n_x, grid.n_y, grid.n_layers,
        )
    )  # fmt: skip
    fitted = [last_frame(r) for r in runs if r.part == "fit"]
    ridges = fem.ridge(WEIGHTS)
    costs = [sum(np.mean([_errors(g, *state) for state in fitted], axis=0)[:2]) for g in ridges]
    best = int(np.argmin(costs))
    return fem.raw(), ridges[best], WEIGHTS[best]


def last_frame(recorded: Recorded) -> tuple[Array, Array]:
    """Noisy displacement and true nodal forces of a run's last frame, each (n_y, n_x, 3)."""
    frame = int(recorded.touched[-1])
    return recorded.rig["displacement_m"][frame], recorded.truth["force"][frame]


def _errors(matrix: Array, displacement: Array, force: Array) -> tuple[float, float, float, float]:
    return errors((matrix @ displacement.ravel()).reshape(force.shape), force)


def errors(found: Array, force: Array) -> tuple[float, float, float, float]:
    """Relative error of the tangential and normal field, resultant's error over the load, shear over normal force."""
    error, size = found - force, float(np.linalg.norm(force))
    shear = max(float(np.linalg.norm(force[..., :2])), 0.05 * size)  # a ball pressed straight has next to none
    total = float(np.linalg.norm(force.sum(axis=(0, 1))))
    return (
        float(np.linalg.norm(error[..., :2])) / shear,
        float(np.linalg.norm(error[..., 2]) / np.linalg.norm(force[..., 2])),
        float(np.linalg.norm(error.sum(axis=(0, 1)))) / total,
        float(np.linalg.norm(found[..., :2]) / np.linalg.norm(found[..., 2])),
    )
