"""The free constant of depth from light, by a table."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.fixed import I64, Saturations, round_shift
from mirror.pinhole_nodes import lift

Tensors = dict[str, npt.NDArray[np.generic]]


class DepthGauge:
    """The kind `gauge` of a calibration."""

    def __init__(self, tensors: Tensors, metadata: dict[str, str]) -> None:
        self.weight = tensors["gauge.weight"].astype(np.int64)
        self.shift = int(metadata["gauge.shift"])

    def lifted(self, board: Board, u: I64, depth: I64, saturations: Saturations) -> tuple[I64, I64]:
        """Displacement (node rows, node columns, 3) and depth, 1/8 um, with their constant."""
        total = (self.weight * u.reshape(-1, 3)).sum(keepdims=True)
        c = saturations.int16(round_shift(total, self.shift))
        lifted = lift(board, u, np.broadcast_to(c, u.shape[:2]), saturations)
        return lifted, saturations.int16(depth + c)
