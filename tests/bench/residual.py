"""What the forces do not explain, on gelslim's twin: ordinary presses beside a patch that has slid. SIMULATED.

    python tests/bench/residual.py

Displacements of `bench ifem` on the board's own pad and on one that is 3 % off, with the noise that the
calibration is made for; then 3 x 3 and 5 x 5 nodes are moved along x. Numbers are standard deviations.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.bench.states import JUDGED, State, make_states
from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise
from ruffini.sim.unit import PadError

SIGMA_M = (5e-6, 5e-6, 20e-6)
DEPTH_MM = 0.6
OFF = PadError(modulus=1.03, poisson=0.97, thickness=1.03)
CORNER = (4, 6)  # row and column of the patch

Array = npt.NDArray[np.float64]


class Bench:
    """The board's own integers on one displacement after the other."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline, self._rng = pipeline, np.random.default_rng(1)
        self._shape = (pipeline.layout.node_n_y, pipeline.layout.node_n_x, 3)

    def left(self, u: Array | float, slid_m: float = 0.0, n: int = 0) -> Array:
        """What is left at each node along each axis; `n` x `n` nodes are moved along x."""
        seen = u + self._rng.normal(size=self._shape) * SIGMA_M
        row, column = CORNER
        seen[row : row + n, column : column + n, 0] += slid_m
        steps = np.clip(np.round(seen / DISPLACEMENT_LSB_M), -32767, 32767).astype(np.int16)
        self._pipeline.solve(steps.reshape(1, -1, 3))
        return np.asarray(self._pipeline.residual() / 64.0)


def words(left: Array) -> str:
    """Per axis the root mean square of all nodes, and the largest node."""
    size = np.sqrt(np.mean(left**2, axis=2))
    row, column = np.unravel_index(np.argmax(size), size.shape)
    rms = " ".join(f"{v:5.2f}" for v in np.sqrt(np.mean(left**2, axis=(0, 1))))
    return f"rms x, y, z {rms}   largest node {size.max():5.1f} at row {row}, column {column}"


def main() -> None:
    board = find_board("gelslim")
    kind = make_operator(board, method="support", noise=Noise(SIGMA_M))
    file = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata})
    states: dict[str, list[State]] = {
        "the board's pad": make_states(board, JUDGED, (DEPTH_MM,)),
        "3 % off": make_states(board, JUDGED, (DEPTH_MM,), OFF),
    }
    with Pipeline(board, file.data) as pipeline:
        bench = Bench(pipeline)
        print(f"{'untouched':44}{words(bench.left(0.0))}")
        for pad, pressed in states.items():
            for state in pressed:
                name = f"{pad}: {state.recipe.name}, {state.resultant_n:.2f} N"
                print(f"{name:44}{words(bench.left(state.displacement))}")
        for name, u in (("untouched", 0.0), ("pressed", states["the board's pad"][0].displacement)):
            for n in (3, 5):
                for slid_um in (20, 50, 100):
                    text = f"{name}, {n} x {n} nodes slid by {slid_um} um"
                    print(f"{text:44}{words(bench.left(u, slid_um * 1e-6, n))}")


if __name__ == "__main__":
    main()
