"""The `operator` kind of a calibration file, made from a board's own numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.fem.compile import DISPLACEMENT_LSB_NM, OperatorTable, compile_operator
from ruffini.fem.operators import Noise, force_operator, observed_nodes
from ruffini.fem.slab import Slab


@dataclass(frozen=True)
class OperatorKind:
    """Tensors and metadata as proto/CALIBRATION.md has them, and the float64 matrix they came from."""

    tensors: dict[str, npt.NDArray[np.generic]]
    metadata: dict[str, str]
    table: OperatorTable
    matrix: npt.NDArray[np.float64]


def board_slab(board: Board) -> Slab:
    """The pad of a board as the operator's finite-element model."""
    pad, grid = board.pad, board.grid
    return Slab(
        size_x_m=pad.size_x_um * 1e-6,
        size_y_m=pad.size_y_um * 1e-6,
        thickness_m=pad.thickness_um * 1e-6,
        n_x=grid.n_x,
        n_y=grid.n_y,
        n_layers=grid.n_layers,
        modulus_pa=float(pad.modulus_pa),
        poisson=pad.poisson_1e4 * 1e-4,
    )


def board_window_m(board: Board) -> tuple[float, float, float, float]:
    """What the camera observes: min x, min y, max x, max y from the pad's corner, metres."""
    w = board.window
    return (w.min_x_um * 1e-6, w.min_y_um * 1e-6, w.max_x_um * 1e-6, w.max_y_um * 1e-6)


def make_operator(
    board: Board,
    *,
    method: str,
    noise: Noise,
    ridge_weight: float = 1e-4,
    progress: Callable[[float], None] = lambda _: None,
) -> OperatorKind:
    """Solve and compile the inverse FEM of a board."""
    slab, window = board_slab(board), board_window_m(board)
    matrix = force_operator(
        slab, method, noise=noise, ridge_weight=ridge_weight, window_m=window, progress=progress
    )
    table = compile_operator(matrix, force_lsb_un=board.field.force_lsb_un)
    rows, columns = observed_nodes(slab, window)
    metadata = {
        "operator.n_x": str(columns.stop - columns.start),
        "operator.n_y": str(rows.stop - rows.start),
        "operator.out_shift": str(table.out_shift),
        "operator.force_lsb_un": str(table.force_lsb_un),
        "operator.displacement_lsb_nm": str(DISPLACEMENT_LSB_NM),
        "operator.method": method,
        "operator.error_1e9": str(round(table.error * 1e9)),
    }
    tensors = {"operator.entry": table.entry, "operator.shift": table.shift}
    return OperatorKind(tensors, metadata, table, matrix)
