"""A camera that sees only part of the pad: contacts inside its window, across the border, beyond it. SIMULATED.

The window is cut into a board's own pad, nothing else changes. Judged are the forces of the seen nodes, also where the
contact goes on unseen, and whether the frames of contacts that go on say so, and only those.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.disturbance import HALF_WHITE_UM, WHITE_UM, Disturbance
from ruffini.bench.states import Recipe, State, Touch, make_states
from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.operator.error_model import N_TOUCHES, node_places
from ruffini.estimators.operator.fit import board_slab, make_operator
from ruffini.fem.operators import Noise
from ruffini.tables import aligned
from ruffini.wire.covariance import full_covariance

Array = npt.NDArray[np.float64]

MARGIN_UM = 3000  # of the pad that the camera does not see, on each side
NOISE = Noise((5e-6, 5e-6, 20e-6), gauge_m=100e-6, tilt_m=30e-6)

# For a pad of about 20 x 16 mm.
RECIPES = {
    "inside": (
        Recipe("ball", (Touch("sphere", 5, -1.2, 0.8),)),
        Recipe("flat sheared", (Touch("flat", 2.2, 2.0, -0.6, shift=(-0.1, 0.1)),)),
        Recipe("ball sliding", (Touch("sphere", 6, 1.0, 0.9, shift=(0.8, -0.4)),)),
    ),
    "across": (
        Recipe("ball at the side", (Touch("sphere", 6, 7.2, -0.8),)),
        Recipe("flat sheared", (Touch("flat", 2.0, 0.8, -5.1, shift=(0.1, 0.1)),)),
        Recipe("ball sheared", (Touch("sphere", 7, -6.8, 3.0, shift=(0.1, -0.1)),)),
        Recipe("ball at the corner", (Touch("sphere", 5, 6.6, 4.7),)),
    ),
    "inside and beyond": (
        Recipe("flat, ball beyond", (Touch("flat", 2.0, 1.5, 0.3), Touch("sphere", 4, -8.6, -1.0))),
        Recipe("ball, flat beyond", (Touch("sphere", 5, -1.5, -0.4), Touch("flat", 1.2, 8.6, 0.6))),
    ),
}  # fmt: skip


def narrowed(board: Board, margin_um: int = MARGIN_UM) -> Board:
    """The board with a window that ends this far inside its pad."""
    pad = board.pad
    window = {
        "min_x_um": margin_um, "min_y_um": margin_um,
        "max_x_um": pad.size_x_um - margin_um, "max_y_um": pad.size_y_um - margin_um,
    }  # fmt: skip
    text = board.text
    for key, value in window.items():
        text = re.sub(rf"(?m)^{key}\s*=\s*\d+", f"{key} = {value}", text)
    return parse_board(text, f"{board.name}, seen in part")


def run(board: Board, *, n_seeds: int) -> dict[str, Any]:
    """Errors of the seen nodes by where the contact lies, of the papers' raw estimate and of the default."""
    part = narrowed(board)
    raw = make_operator(part, method="raw", noise=NOISE).matrix
    kind = make_operator(part, method="support", noise=NOISE, n_touches=N_TOUCHES)
    file = container.pack(kind.tensors, {**container.base_metadata(part), **kind.metadata})
    out: dict[str, Any] = {"margin_mm": MARGIN_UM * 1e-3, "noise_um": WHITE_UM, "rows": {}}
    with Pipeline(part, file.data) as pipeline:
        for where, recipes in RECIPES.items():
            # Truth on the whole pad; the estimators get the seen nodes of it.
            states = make_states(board, recipes, (0.6,))
            out["rows"][where] = _judge(part, pipeline, raw, states, n_seeds)
    return out


def _judge(part: Board, pipeline: Pipeline, raw: Array, states: list[State], n_seeds: int) -> dict[str, float]:
    places = node_places(board_slab(part), part.observed)
    lsb_n = part.field.force_lsb_un * 1e-6
    scores: list[dict[str, float]] = []
    within: list[Array] = []
    for i, state in enumerate(states):
        true = state.force[part.observed]
        for seed in range(n_seeds):
            rng = np.random.default_rng((13, i, seed))
            noise = Disturbance(WHITE_UM, HALF_WHITE_UM if seed % 2 else (0.0, 0.0, 0.0))
            u = (state.displacement + noise.draw(state.displacement.shape, rng))[part.observed]
            steps = np.clip(np.round(u / DISPLACEMENT_LSB_M), -32767, 32767).astype(np.int16)
            force = pipeline.solve(steps.reshape(1, -1, 3)).reshape(true.shape) * lsb_n
            _, upper = pipeline.sigma()
            error = places.wrench(force - true, np.zeros(2))
            within.append(np.abs(error) / np.sqrt(np.diag(full_covariance(upper))))
            says = any(contact.reaches_border for contact in pipeline.contacts())
            linear = (raw @ u.ravel()).reshape(true.shape)
            scores.append({
                "tangential": _relative(force - true, true, slice(0, 2)), "normal": _relative(force - true, true, 2),
                "resultant_n": float(np.linalg.norm(error[:3])), "says_so": float(says),
                "raw_resultant_n": float(np.linalg.norm((linear - true).sum(axis=(0, 1)))),
            })  # fmt: skip
    ratio = np.array(within)
    covered = {f"wrench_within_{k}": float(100 * np.mean(ratio < k)) for k in (1, 2)}
    return {**{k: float(np.mean([s[k] for s in scores])) for k in scores[0]}, **covered, "frames": len(scores)}


def _relative(error: Array, true: Array, axes: slice | int) -> float:
    """Relative L2 error of the components; where there is next to none, against 5 % of the whole force."""
    size = max(float(np.linalg.norm(true[..., axes])), 0.05 * float(np.linalg.norm(true)))
    return float(np.linalg.norm(error[..., axes])) / size


def table(result: dict[str, Any]) -> str:
    """The rows as text."""
    lines = [
        f"window {result['margin_mm']:g} mm inside the pad, 0.6 mm, noise 5/5/20 um (every second frame half of it "
        "again correlated); errors of the seen nodes",
        *aligned(
            ("contacts", "tangential", "normal", "resultant", "raw", "says so", "wrench within 1, 2 sigma"), [
            (
                where, f"{r['tangential']:.3f}", f"{r['normal']:.3f}", f"{1e3 * r['resultant_n']:.1f} mN",
                f"{1e3 * r['raw_resultant_n']:.0f} mN", f"{100 * r['says_so']:.0f} %",
                f"{r['wrench_within_1']:.0f}, {r['wrench_within_2']:.0f} %",
            )
            for where, r in result["rows"].items()
        ]),
    ]  # fmt: skip
    return "\n".join(lines)
