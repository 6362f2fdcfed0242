"""Means to fix the depth's free constant, on contacts of the twin that nothing was fitted on. SIMULATED.

Of each [depth] gauge: how far the mean depth is off, what is stated of it to the operator and whether that holds, and
the forces of the same noisy displacements with the constant so found, solved by an operator made for that uncertainty.
Then the same constants on rendered pictures, displacement as the core measures it with colours of its own ball presses.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from accuracy import calibrate
from threadpoolctl import threadpool_limits

from ruffini.bench.ifem import Scores
from ruffini.bench.states import FRESH, JUDGED, TUNED, State, make_states
from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.operator.depth_gauge import AXES, DepthGauge, LitNodes, fit_depth_gauge
from ruffini.estimators.operator.fit import board_slab, make_operator, second_pass
from ruffini.estimators.operator.gauge import USUAL, gauge_nodes, gauge_uncertainty_m
from ruffini.frames import read_frames
from ruffini.sim import programs
from ruffini.sim.recording import TwinUnit, record_touches

Array = npt.NDArray[np.float64]

DEPTHS_MM = (0.4, 0.8)
JUDGED_SEED, DEVELOPMENT_SEED = 20_270_401, 770_201
N_PRESSES = 16
GAUGES = ("margin", "mean", *AXES)


def with_gauge(board: Board, gauge: str) -> Board:
    """The same board with another gauge."""
    return parse_board(board.text.replace(f'gauge = "{board.depth.gauge}"', f'gauge = "{gauge}"'), board.name)


def constant(board: Board, table: DepthGauge | None, u: Array) -> Array:
    """What each displacement (k, n_y, n_x, 3) lacks by the board's gauge, metres."""
    if table is not None:
        return table.constant(u)
    return -np.asarray(u[:, gauge_nodes(board)[board.observed], 2].mean(axis=1))


def rms_um(values: Array) -> float:
    return 1e6 * float(np.sqrt(np.mean(np.square(values))))


def judge(board: Board, states: list[State], seed: int) -> dict[str, float]:
    """One gauge."""
    u, lit = np.array([s.displacement for s in states]), LitNodes(board, board_slab(board), USUAL)
    seen = lit.seen(u, np.random.default_rng(seed))
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
        "off_um": rms_um(off), "stated_um": 1e6 * stated_m,
        "within_1": float(np.mean(np.abs(off) < stated_m)), "within_2": float(np.mean(np.abs(off) < 2 * stated_m)),
        "tangential": means["tangential"], "normal": means["normal"],
        "fz_off_mn": 1e3 * float(np.sqrt(np.mean(np.square(total)))),
    }  # fmt: skip


def rendered(board: Board, seed: int) -> dict[str, float]:
    """Of each gauge: how far the mean depth is off on pictures, micrometres; of none: the mean depth."""
    unit = TwinUnit.build(board)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = container.pack(calibrate(unit, folder / "balls", seed), container.base_metadata(board))
        story = programs.sheared_and_turned(board, N_PRESSES, np.random.default_rng(seed + 5))
        record_touches(unit, story, folder / "touches", seed=seed + 6, program="sheared_and_turned")
        truth, seen = np.load(folder / "touches" / "truth.npz"), []
        with Pipeline(board, file.data) as pipeline:
            for image, is_judged in zip(read_frames(folder / "touches"), truth["judged"], strict=True):
                pipeline.process(image)
                if is_judged:
                    seen.append(pipeline.raw("displacement") * DISPLACEMENT_LSB_M)
    seen_z = (slice(None), *board.observed, 2)
    u, true = np.array(seen), truth["displacement"][truth["judged"]][seen_z].mean(axis=(1, 2))
    out = {"none": rms_um(true)}
    for gauge in GAUGES:
        other = with_gauge(board, gauge)
        table = fit_depth_gauge(other, board_slab(other), USUAL) if other.depth.has_gauge_table else None
        out[gauge] = rms_um(u[..., 2].mean(axis=(1, 2)) + constant(other, table, u) - true)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--development", action="store_true", help="other states than the judged ones")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    board = find_board(args.board)
    with threadpool_limits(limits=1):
        states = make_states(board, (*TUNED, *FRESH) if args.development else JUDGED, DEPTHS_MM)
        seed = DEVELOPMENT_SEED if args.development else JUDGED_SEED
        rows = {gauge: judge(with_gauge(board, gauge), states, seed) for gauge in GAUGES}
        pictures = rendered(board, seed)
    if args.json:
        print(json.dumps({"simulated": True, "states": len(states), "gauges": rows, "rendered_off_um": pictures}))
        return
    print(f"{args.board}, SIMULATED, {len(states)} states")
    print("gauge      off um  stated  within 1, 2 sigma  tangential  normal  F_z off by mN")
    for name, r in rows.items():
        within = f"{100 * r['within_1']:10.0f} %{100 * r['within_2']:5.0f} %"
        forces = f"{r['tangential']:12.2f}{r['normal']:8.2f}{r['fz_off_mn']:10.0f}"
        print(f"{name:10}{r['off_um']:7.1f}{r['stated_um']:8.1f}{within}{forces}")
    print(
        f"{N_PRESSES} rendered presses, mean depth off by, um: "
        + ", ".join(f"{k} {v:.1f}" for k, v in pictures.items())
    )


if __name__ == "__main__":
    main()
