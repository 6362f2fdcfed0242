"""The benchmark's fields as the iFEM 2.0 paper shows them (its Figs. 1, 4 and 5b): truth above, methods below."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.ifem import Methods
from ruffini.bench.objects import has_paper, paper_states
from ruffini.bench.states import JUDGED, State, make_states
from ruffini.boards import Board

Array = npt.NDArray[np.float64]

SHOWN = ("ball sliding", "flat twisted", "two balls", "ball at the edge")  # of a board without the paper's bench
DEPTH_MM = 0.6
METHODS = ("default", "optimal", "ridge", "sparse", "raw")
FIG_4 = ("S5", "S6", "S9", "S10")
FIG_5 = ("steel_ball", "screw_m8", "screw_m6", "usb_plug", "shell")
FIG_1 = ("rigid_soft",)


def pictures(path: Path, board: Board) -> list[Path]:
    """`path`: methods beside the truth; of the paper's board also the objects, and a ball with a rigid core.

    Normal force as colour, shear as arrows; one column a state, its noise the same for all methods.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    methods = Methods(board)
    try:
        if not has_paper(board):
            shown = make_states(board, tuple(r for r in JUDGED if r.name in SHOWN), (DEPTH_MM,))
            return [_fields(path, methods, shown, METHODS)]
        states = {s.recipe.name: s for s in paper_states(board, quick=False)}
        sheets = (
            ("", FIG_4, METHODS),
            ("-objects", FIG_5, ("default", "raw")),
            ("-rigid-soft", FIG_1, ("default", "raw")),
        )
        return [
            _fields(path.with_stem(path.stem + suffix), methods, [states[name] for name in names], shown_methods)
            for suffix, names, shown_methods in sheets
        ]
    finally:
        methods.close()


def _fields(path: Path, methods: Methods, states: list[State], names: tuple[str, ...]) -> Path:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    estimates, rows = methods.all(), 1 + len(names)
    size = (max(3.1 * len(states), 4.5), 2.5 * rows + 0.6)
    figure, axes = plt.subplots(rows, len(states), figsize=size, squeeze=False)
    for column, state in enumerate(states):
        noise = Disturbance(white_um=WHITE_UM).draw(methods.shape, np.random.default_rng((9, column)))
        fields = {"truth": state.force, **{name: estimates[name](state.displacement + noise) for name in names}}
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
                what = state.recipe.name.replace("_", " ")
                axis.set_title(f"{what}\npeak {high:.0f} mN, {state.resultant_n:.1f} N", fontsize=9)
    noise_um = "/".join(f"{v:g}" for v in WHITE_UM)
    figure.suptitle(f"{methods.board.name}, SIMULATED: nodal forces, noise {noise_um} um", fontsize=11)
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.15 / size[1]))
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
