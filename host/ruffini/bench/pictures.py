"""The benchmark's fields as the iFEM 2.0 paper shows them (its Fig. 4): truth above, methods below."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.ifem import Methods
from ruffini.bench.states import JUDGED, make_states
from ruffini.boards import Board

SHOWN = ("ball sliding", "flat twisted", "two balls", "ball at the edge")
METHODS = ("default", "optimal", "ridge", "sparse", "raw")
DEPTH_MM = 0.6


def fields_beside_truth(path: Path, board: Board) -> Path:
    """Normal force as colour and shear as arrows, one row a method, one column a state; the same noise for all."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    recipes = tuple(r for r in JUDGED if r.name in SHOWN)
    states = make_states(board, recipes, (DEPTH_MM,))
    methods = Methods(board)
    estimates = methods.all()
    figure, axes = plt.subplots(1 + len(METHODS), len(states), figsize=(3.1 * len(states), 2.5 * (1 + len(METHODS))))
    for column, state in enumerate(states):
        noise = Disturbance(white_um=WHITE_UM).draw(methods.shape, np.random.default_rng((9, column)))
        fields = {"truth": state.force, **{name: estimates[name](state.displacement + noise) for name in METHODS}}
        high = -1e3 * float(state.force[..., 2].min())
        longest = max(float(np.linalg.norm(state.force[..., :2], axis=-1).max()), 1e-9)
        for row, (name, force) in enumerate(fields.items()):
            axis = axes[row][column]
            axis.imshow(-1e3 * force[..., 2], cmap="cividis", vmin=0, vmax=high, interpolation="nearest")
            axis.quiver(force[..., 0], force[..., 1], color="white", angles="xy", scale=longest / 2.5, scale_units="xy")
            axis.set(xticks=[], yticks=[])
            if column == 0:
                axis.set_ylabel(name)
            if row == 0:
                axis.set_title(f"{state.recipe.name}\npeak {high:.0f} mN, {state.resultant_n:.1f} N", fontsize=9)
    methods.close()
    figure.suptitle(f"{board.name}, SIMULATED: nodal forces at {DEPTH_MM} mm, noise 5/5/20 um", fontsize=11)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
