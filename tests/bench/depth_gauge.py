"""Means to fix the depth's free constant, on contacts of the twin that nothing was fitted on. SIMULATED.

Of each [depth] gauge: how far the mean depth is off, what is stated of it to the operator and whether that holds, and
the forces of the same noisy displacements with the constant so found, solved by an operator made for that uncertainty.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini.bench.ifem import Scores
from ruffini.bench.states import FRESH, JUDGED, TUNED, State, make_states
from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.depth_gauge import AXES, DepthGauge, LitNodes
from ruffini.calibrate.gauge import USUAL, gauge_nodes, gauge_uncertainty_m
from ruffini.calibrate.operator import board_slab, make_operator, second_pass

Array = npt.NDArray[np.float64]

DEPTHS_MM = (0.4, 0.8)
SEED = 20_270_401
GAUGES = ("margin", "mean", *AXES)


def with_gauge(board: Board, gauge: str) -> Board:
    """The same board with another gauge."""
    return parse_board(board.text.replace(f'gauge = "{board.depth.gauge}"', f'gauge = "{gauge}"'), board.name)


def constant(board: Board, table: DepthGauge | None, u: Array) -> Array:
    """What each displacement (k, n_y, n_x, 3) lacks by the board's gauge, metres."""
    if table is not None:
        return table.constant(u)
    return -np.asarray(u[:, gauge_nodes(board)[board.observed], 2].mean(axis=1))


def judge(board: Board, states: list[State]) -> dict[str, float]:
    """One gauge."""
    u, lit = np.array([s.displacement for s in states]), LitNodes(board, board_slab(board), USUAL)
    seen = lit.seen(u, np.random.default_rng(SEED))
    stated_m = 0.0 if board.depth.has_gauge_table else gauge_uncertainty_m(board)
    kind = make_operator(board, method="support", noise=replace(USUAL, gauge_m=stated_m))
    stated_m = kind.gauge.gauge_m if kind.gauge else stated_m
    off = (found := constant(board, kind.gauge, seen)) - lit.mean(u)
    assert kind.support is not None
    solve, scores, total = second_pass(board, kind.matrix, kind.support), Scores(), []
    step = (lit.view.place_m[1, 1] - lit.view.place_m[0, 0]) * 1e3
    for state, one, c in zip(states, seen, found, strict=True):
        place = lit.view.place_m / lit.view.standoff_m
        force, _ = solve(one + np.concatenate([place * c, np.full((*place.shape[:2], 1), c)], axis=-1))
        scores.add(state, force, (float(step[0]), float(step[1])))
        total.append(force[..., 2].sum() - state.force[..., 2].sum())
    means = scores.means()
    return {
        "off_um": 1e6 * float(np.sqrt(np.mean(off**2))), "stated_um": 1e6 * stated_m,
        "within_1": float(np.mean(np.abs(off) < stated_m)), "within_2": float(np.mean(np.abs(off) < 2 * stated_m)),
        "tangential": means["tangential"], "normal": means["normal"],
        "fz_off_mn": 1e3 * float(np.sqrt(np.mean(np.square(total)))),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--development", action="store_true", help="other states than the judged ones")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    board = find_board(args.board)
    with threadpool_limits(limits=1):
        states = make_states(board, (*TUNED, *FRESH) if args.development else JUDGED, DEPTHS_MM)
        rows = {gauge: judge(with_gauge(board, gauge), states) for gauge in GAUGES}
    if args.json:
        print(json.dumps({"simulated": True, "states": len(states), "gauges": rows}))
        return
    print(f"{args.board}, SIMULATED, {len(states)} states")
    print("gauge      off um  stated  within 1, 2 sigma  tangential  normal  F_z off by mN")
    for name, r in rows.items():
        within = f"{100 * r['within_1']:10.0f} %{100 * r['within_2']:5.0f} %"
        forces = f"{r['tangential']:12.2f}{r['normal']:8.2f}{r['fz_off_mn']:10.0f}"
        print(f"{name:10}{r['off_um']:7.1f}{r['stated_um']:8.1f}{within}{forces}")


if __name__ == "__main__":
    main()
