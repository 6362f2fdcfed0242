"""Depth from the markers' motion against depth from light: the same touches, the same pad, the same solve. SIMULATED.

Judged on contacts of the twin that nothing was fitted on. First the depth, by several ways to estimate it from the same
noisy markers; then the forces. `--board` is any board with a printed lattice whose window is its pad.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg as la
from threadpoolctl import threadpool_limits

from ruffini.bench.ifem import Scores
from ruffini.bench.states import FRESH, JUDGED, TUNED, State, make_states
from ruffini.boards import Board, find_board, parse_board
from ruffini.estimators.operator.fit import board_slab, make_operator, second_pass
from ruffini.estimators.operator.gauge import gauge_nodes, gauge_uncertainty_m
from ruffini.estimators.operator.marker_depth import DISCREPANCY, MarkerDepth, View
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.operators import ForcePrior, Noise
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]

NOISE_M, TILT_M = (5e-6, 5e-6, 20e-6), 30e-6  # the defaults of cal operator
DEPTHS_MM = (0.4, 0.8)
SEED = 20_270_205
STAGES = '["difference", "markers", "displacement", "operator", "support", "wrench", "contacts"]'


def without_light(board: Board) -> Board:
    """The same board, its depth from the markers."""
    text = board.text[: board.text.index("stages = ")] + f"stages = {STAGES}\n"
    return parse_board(text.replace("[depth]\n", '[depth]\nsource = "markers"\n'), board.name)


def rms(values: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate([v.ravel() for v in values])))))


class Pad:
    """Compliance (3 n, 3 n) of a board's pad, and the linear map from nodal forces to what the nodes see."""

    def __init__(self, board: Board, view: View) -> None:
        condensed = condense(board_slab(board))
        blocks = [spd_inverse(b) for b in surface_stiffness(condensed)]
        self.compliance = dense_from_blocks(condensed.bases, blocks)
        n = len(self.compliance) // 3
        interpolated = np.kron(*view.at_nodes) @ np.kron(*view.at_markers)
        sight = np.zeros((n, 2, n, 3))
        for axis in range(2):
            sight[:, axis, :, axis] = interpolated
            sight[:, axis, :, 2] = -interpolated * view.place_m[..., axis].ravel() / view.standoff_m
        self.seen = sight.reshape(2 * n, 3 * n) @ self.compliance
        x, y = (view.place_m.reshape(-1, 2) / (view.place_m[1, 1] - view.place_m[0, 0])).T
        prior = ForcePrior()
        distance2 = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
        near = np.exp(-distance2 / (2 * prior.length_nodes**2))
        self.prior = np.kron(near, np.diag(np.square(prior.sigma_n)))

    def depth(self, seen: Array, noise: Array, free: npt.NDArray[np.bool_]) -> Array:
        """u_z with the operator's prior of forces on the `free` nodes and none elsewhere."""
        keep = np.repeat(free.ravel(), 3)
        prior, sight = self.prior[np.ix_(keep, keep)], self.seen[:, keep]
        cause = la.solve(sight @ prior @ sight.T + noise, seen.ravel(), assume_a="pos")
        return np.asarray((self.compliance[2::3, keep] @ prior @ sight.T @ cause).reshape(free.shape))


def depths(board: Board, states: list[State], fitted: MarkerDepth, seen: list[Array]) -> dict[str, dict[str, float]]:
    """Error of the depth by each way, micrometres."""
    threshold_n, pad = board.contact.threshold_un * 1e-6, Pad(board, fitted.view)
    noise = fitted.view.noise_covariance(NOISE_M)
    everywhere = np.ones(seen[0].shape[:2], dtype=bool)
    off: dict[str, list[tuple[Array, Array]]] = {}
    for state, d in zip(states, seen, strict=True):
        true, pressed = state.displacement[..., 2], state.force[..., 2] < -threshold_n
        for name, uz in (
            ("none (u_z itself)", np.zeros_like(true)),
            ("best for the operator's prior of forces", pad.depth(d, noise, everywhere)),
            ("best over simulated touches (the board's)", fitted.displacement(d)[..., 2]),
            ("prior of forces, contact area known", pad.depth(d, noise, state.force[..., 2] < -1e-4)),
        ):
            off.setdefault(name, []).append(((uz - true), pressed))
    return {
        name: {"pressed_um": 1e6 * rms([e[p] for e, p in rows]), "all_um": 1e6 * rms([e for e, _ in rows]),
               "mean_um": 1e6 * rms([np.array([e.mean()]) for e, _ in rows])}
        for name, rows in off.items()
    }  # fmt: skip


def coverage(board: Board, states: list[State], fitted: MarkerDepth, seen: list[Array]) -> dict[str, float]:
    """How the board's depth keeps to what is stated of it: shares of nodes within one and two sigma."""
    threshold_n = board.contact.threshold_un * 1e-6
    off = [fitted.displacement(d)[..., 2] - s.displacement[..., 2] for s, d in zip(states, seen, strict=True)]
    pressed = [s.force[..., 2] < -threshold_n for s in states]
    out = {"stated_um": 1e6 * fitted.sigma_m, "gauge_um": 1e6 * fitted.gauge_m,
           "over_touches": rms([e[p] for e, p in zip(off, pressed, strict=True)]) / fitted.sigma_m * DISCREPANCY,
           "gauge_over_stated": rms([np.array([e.mean()]) for e in off]) / fitted.gauge_m}  # fmt: skip
    for name, keep in (("pressed", pressed), ("elsewhere", [~p for p in pressed])):
        over = np.concatenate([np.abs(e[k]) for e, k in zip(off, keep, strict=True)]) / fitted.sigma_m
        out |= {f"{name}_within_1": float((over < 1).mean()), f"{name}_within_2": float((over < 2).mean())}
    return out


def from_light(board: Board, state: State, view: View, rng: np.random.Generator) -> Array:
    """Displacement with a depth of its own: white noise, and zero on the gauge's nodes."""
    far = replace(view, standoff_m=1e3)  # its perspective is corrected
    u = far.seen(state.displacement[None], rng.normal(size=view.marker_m.shape) * NOISE_M[:2])[0]
    depth = state.displacement[..., 2] - state.displacement[gauge_nodes(board), 2].mean()
    return np.concatenate([u, (depth + rng.normal(size=depth.shape) * NOISE_M[2])[..., None]], axis=-1)


def forces(
    board: Board, blind: Board, states: list[State]
) -> tuple[dict[str, dict[str, float]], MarkerDepth, list[Array]]:
    """Scores of both sources of depth, the fitted depth, and what the nodes saw."""
    rng = np.random.default_rng(SEED)
    light = make_operator(board, method="support", noise=Noise(NOISE_M, gauge_uncertainty_m(board), TILT_M))
    markers = make_operator(blind, method="support", noise=Noise(NOISE_M, tilt_m=TILT_M))
    fitted = markers.marker_depth
    assert light.support is not None and markers.support is not None and fitted is not None  # noqa: PT018
    view = fitted.view
    white = [rng.normal(size=view.marker_m.shape) * NOISE_M[:2] for _ in states]
    seen = [view.seen(s.displacement[None], w)[0] for s, w in zip(states, white, strict=True)]
    step_mm = tuple(float(v) for v in (view.place_m[1, 1] - view.place_m[0, 0]) * 1e3)
    rows = {}
    for name, solve, u in (
        ("light", second_pass(board, light.matrix, light.support), [from_light(board, s, view, rng) for s in states]),
        ("markers", second_pass(blind, markers.matrix, markers.support), [fitted.displacement(d) for d in seen]),
    ):
        scores, ratio = Scores(), []
        for state, one in zip(states, u, strict=True):
            force, _ = solve(one)
            scores.add(state, force, (step_mm[0], step_mm[1]))
            ratio.append(force[..., 2].sum() / state.force[..., 2].sum())
        means = scores.means()
        rows[name] = {k: means[k] for k in ("tangential", "normal", "shape", "peak")} | {
            "fz_over_true": float(np.mean(ratio)), "fz_spread": float(np.std(ratio)),
        }  # fmt: skip
    return rows, fitted, seen


def run(board: Board, states: list[State]) -> dict[str, Any]:
    blind = without_light(board)
    rows, fitted, seen = forces(board, blind, states)
    return {"simulated": True, "states": len(states), "depth": depths(blind, states, fitted, seen),
            "stated": coverage(blind, states, fitted, seen), "force": rows}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--development", action="store_true", help="other states than the judged ones")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    board = find_board(args.board)
    with threadpool_limits(limits=1):
        result = run(board, make_states(board, (*TUNED, *FRESH) if args.development else JUDGED, DEPTHS_MM))
    if args.json:
        print(json.dumps(result))
        return
    print(f"{args.board}, SIMULATED, {result['states']} states, markers with {NOISE_M[0] * 1e6:.0f} um of noise")
    print(f"{'depth from the markers':44}{'pressed um':>12}{'all um':>9}{'mean um':>9}")
    for name, row in result["depth"].items():
        print(f"{name:44}{row['pressed_um']:12.0f}{row['all_um']:9.0f}{row['mean_um']:9.1f}")
    said = result["stated"]
    print(f"{'stated to the operator':44}{said['stated_um']:12.0f}{'':9}{said['gauge_um']:9.1f}")
    for name in ("pressed", "elsewhere"):
        within = [100 * said[f"{name}_within_{n}"] for n in (1, 2)]
        print(f"{'nodes ' + name:18}{within[0]:.0f} % within one stated sigma, {within[1]:.0f} % within two")
    print(f"off by {said['over_touches']:.2f} times what simulated touches are; gauge by "
          f"{said['gauge_over_stated']:.2f} of what is stated")  # fmt: skip
    print(f"{'force, depth from':20}{'tangential':>12}{'normal':>9}{'shape':>9}{'peak':>9}  F_z over true")
    for name, row in result["force"].items():
        print(
            f"{name:20}{row['tangential']:12.2f}{row['normal']:9.2f}{row['shape']:9.2f}{row['peak']:9.2f}"
            f"  {row['fz_over_true']:.2f} +- {row['fz_spread']:.2f}"
        )


if __name__ == "__main__":
    main()
