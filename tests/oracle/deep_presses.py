"""Pad's numbers from CalculiX's presses: `cal fit --only material` at linear and at finite strain. SIMULATED.

    python tests/oracle/deep_presses.py [--table docs/results/accuracy.md]

The board states other numbers than the pad has (BELIEVED). Both fits get the presses LOGGED, as a calibration log has
them; with each fitted pad the board's integers measure the other presses.
"""

from __future__ import annotations

import argparse
import datetime
from dataclasses import dataclass
from pathlib import Path

import compare
import numpy as np
import numpy.typing as npt
from oracle import JUDGED, KEPT, KEPT_BOARD, commit, with_row
from presses import NEO_HOOKE, PRESSES

from ruffini.bench.fitted import CELL
from ruffini.bench.states import State
from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.errors import InputError
from ruffini.estimators.material.fit import fit_material, log_of_touches
from ruffini.estimators.material.model import MaterialLog
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import Material, board_slab, make_operator
from ruffini.fem.operators import Noise
from ruffini.files import write_whole

Array = npt.NDArray[np.float64]

SECTION = "## Pad's numbers from deep presses"
COLUMNS = ("fit", "E, nu, thickness off by", "force along z, rms", "their mean", "commit", "date")
# 0.3 to 1.0 mm deep. Of the others those are judged that are no copies of these.
LOGGED = ("ball", "flat", "cylinder", "ball off centre", "ball, no friction", "edge")
COPIES = ("ball aside",)
DEEPEST_MM = 1.2
BELIEVED = (1 / 1.06, 1.01, 1.04)  # the board's E, nu and thickness over the pad's: both make forces too small
NOISE = Noise((5e-6, 5e-6, 20e-6), long_share=(0.0, 0.0, 0.0))
SEED = 3


@dataclass(frozen=True)
class Presses:
    """States on the neo-Hookean pad, each with the name of its press: to fit to, and to judge on."""

    logged: list[tuple[str, State]]
    judged: list[tuple[str, State]]


def kept_presses(board: Board) -> Presses:
    """What CalculiX has solved.

    Raises
    ------
    InputError
        A press is not in the kept file.
    """
    out = Presses([], [])
    for press in PRESSES:
        if press.exponent != NEO_HOOKE or press.name in COPIES:
            continue
        states = compare.kept_press(KEPT, board, press)
        if states is None:
            raise InputError(f"{KEPT}: has no {press.name}: run `make oracle` with --keep first")
        chosen = out.logged if press.name in LOGGED else out.judged
        chosen += [(press.name, one.state) for one in states if one.state.depth_mm <= DEEPEST_MM]
    return out


def believing(board: Board) -> Board:
    """The board, stating the numbers of BELIEVED."""
    pad, (modulus, poisson, thickness) = board.pad, BELIEVED
    numbers = {
        "modulus_pa": round(pad.modulus_pa * modulus), "poisson_1e4": round(pad.poisson_1e4 * poisson),
        "thickness_um": round(pad.thickness_um * thickness),
    }  # fmt: skip
    return board.model_copy(update={"pad": pad.model_copy(update=numbers)})


def log_of(board: Board, presses: list[tuple[str, State]]) -> MaterialLog:
    """Displacements with noise beside a load cell's wrench."""
    rng, places = np.random.default_rng(SEED), node_places(board_slab(board), board.observed)
    u = np.array([s.displacement + rng.normal(size=s.displacement.shape) * NOISE.sigma_m for _, s in presses])
    wrench = np.array([places.wrench(s.force, np.zeros(2)) + rng.normal(size=6) * CELL for _, s in presses])
    # A load cell reads forces where the nodes have gone: (X + u) x F.
    wrench[:, 3:] += [np.cross(s.displacement, s.force).sum(axis=(0, 1)) for _, s in presses]
    names = [name for name, _ in presses]
    return log_of_touches(u.reshape(len(u), -1, 3), wrench, np.array([names.index(name) for name in names]))


def fitted(board: Board, presses: list[tuple[str, State]], *, is_finite: bool) -> Material:
    """What the fit makes of a log of these presses on a board that states other numbers."""
    return fit_material(believing(board), log_of(board, presses), NOISE, is_finite=is_finite).material


def errors(board: Board, material: Material, presses: list[tuple[str, State]], *, is_finite: bool = True) -> Array:
    """Relative error of each press's force along z, by the integers of the board that states BELIEVED."""
    board = believing(board)
    kind = make_operator(board, method="support", noise=NOISE, material=material, is_finite=is_finite)
    file = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata})
    rng, out = np.random.default_rng(SEED + 1), []
    with Pipeline(board, file.data) as pipeline:
        for _, state in presses:
            seen = state.displacement + rng.normal(size=state.displacement.shape) * NOISE.sigma_m
            steps = np.round(seen / DISPLACEMENT_LSB_M).astype(np.int16).reshape(1, -1, 3)
            force_n = pipeline.solve(steps).reshape(state.force.shape) * (board.field.force_lsb_un * 1e-6)
            out.append(force_n[..., 2].sum() / state.force[..., 2].sum() - 1)
    return np.array(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    chosen = parser.parse_args()
    board = find_board(KEPT_BOARD)
    presses, true, believed = kept_presses(board), board_slab(board), board_slab(believing(board))
    own, stated = (Material(slab.modulus_pa, slab.poisson, slab.thickness_m) for slab in (true, believed))
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    text = None if chosen.table is None else chosen.table.read_text()
    print(f"SIMULATED by CalculiX: fitted to {len(presses.logged)} states, judged on {len(presses.judged)} others")
    linear, finite = (fitted(board, presses.logged, is_finite=at_finite) for at_finite in (False, True))
    for name, material, is_finite in (
        ("none: what the board states", stated, True),
        ("linear strain, and the operator, too", linear, False),
        ("linear strain", linear, True),
        ("`--strain finite`", finite, True),
        ("none: the pad's own numbers", own, True),
    ):
        off = ", ".join(f"{100 * (m / o - 1):+.1f}" for m, o in zip(material, own, strict=True)) + " %"
        error = 100 * errors(board, material, presses.judged, is_finite=is_finite)
        cells = (name, off, f"{np.sqrt((error**2).mean()):.1f} %", f"{error.mean():+.1f} %", at, date)
        print(f"  {name:38}{off:24}{cells[2]:>8}{cells[3]:>9}", flush=True)
        text = None if text is None else with_row(text, f"| {' | '.join(cells)} |", SECTION, COLUMNS)
    if text is not None:
        write_whole(chosen.table, text.encode())


if __name__ == "__main__":
    main()
