"""How far forces err, and how often the truth lies within the stated sigma, under one fault at a time. SIMULATED.

    python tests/bench/faults_stated.py --table docs/results/accuracy.md
    python tests/bench/faults_stated.py --lists  # what fem.finite_strain.LINEAR_GROWTH should be, by lists of contacts

Contacts that nothing was chosen on. Errors are with the pad's own material, shares on the pads of coverage.py, whose
material is off by what a fit leaves. In rows "not fitted" errors are on the pad that is off; a sigma speaks of many
pads, so shares are on pads that are off either way, with E drawn as the board states it (pad.stiffness_sigma_1e3), and
in the row of E with all off that `touches.UNMEASURED` assumes. At finite strain both are on the pad's own material. The
calibration knows the noise as `cal fit` measures it on untouched frames. The board's integers get nodes, not pictures,
so flags are not judged. --table replaces the rows of that document's section SECTION. The first time, finite strain
takes a quarter of an hour of one core.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from gels import with_row

from ruffini.bench import states
from ruffini.bench.bad_nodes import BadNodes
from ruffini.bench.coverage import RESIDUAL_ERRORS, WRENCH_AXES, Coverage, Stated, drawn_modulus
from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.ifem import MODEL_ERRORS, Methods, Scores
from ruffini.bench.states import LIGHT_N, UNSEEN, Recipe, State, make_states
from ruffini.boards import find_board
from ruffini.estimators.noise.stage import Power, long_share, planes, power_of
from ruffini.estimators.operator.gauge import gauge_nodes
from ruffini.fem.finite_strain import LINEAR_GROWTH
from ruffini.fem.touches import UNMEASURED
from ruffini.fem.uncertainty import TWO_SIGMA
from ruffini.files import write_whole
from ruffini.sim.settings import Strain
from ruffini.sim.unit import PadError
from ruffini.tables import aligned

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

Array = npt.NDArray[np.float64]

SECTION = "## Faults and the stated uncertainty"
COLUMNS = ("fault", "tangential", "normal", "total", "shear inside, within 1, 2 sigma", "normal inside", "wrench",
           "commit", "date")  # fmt: skip
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/faults_stated.py", ":!*.md")
DEPTHS_MM = (0.3, 0.6, 1.0)
LISTS = ("JUDGED", "TUNED", "FRESH", "MORE")  # of bench.states
N_REST = 20
SEED = 29
BESIDE = 0.7  # correlation with the next node
HOLE_MM = 3.3
CORRELATION_NODES = float(np.sqrt(-1 / (4 * np.log(BESIDE))))


WHITE_NOISE = Disturbance(WHITE_UM)
CORRELATED_NOISE = Disturbance(correlated_um=WHITE_UM, correlation_nodes=CORRELATION_NODES)


def opposite(error: PadError) -> PadError:
    """As far off the other way, with the board's modulus."""
    return PadError(poisson=2 - error.poisson, thickness=2 - error.thickness)


# As `touches.MaterialSpread.pads` has them.
UNMEASURED_PADS = (
    *(PadError(poisson=1 + sign * np.sqrt(2) * UNMEASURED.poisson) for sign in (-1, 1)),
    *(PadError(thickness=1 + sign * np.sqrt(2) * UNMEASURED.thickness) for sign in (-1, 1)),
)


@dataclass(frozen=True)
class Fault:
    """What happens to the true displacement (n_y, n_x, 3) m; wrong: the pad's error, where no material was fitted."""

    name: str
    observe: Callable[[Array, Methods, np.random.Generator], Array]
    wrong: PadError | None = None
    strain: Strain = "linear"  # of the truth, and of what the board is calibrated for
    noise: Disturbance = WHITE_NOISE  # that the calibration has seen at rest


def _with(disturbance: Disturbance) -> Callable[[Array, Methods, np.random.Generator], Array]:
    return lambda u, methods, rng: u + disturbance.draw(u.shape, rng)


def _hole(u: Array, methods: Methods, rng: np.random.Generator) -> Array:
    return BadNodes(WHITE_UM, hole_mm=HOLE_MM).observe(u, methods.step_mm, rng)


def _zeroed(u: Array, methods: Methods, rng: np.random.Generator) -> Array:
    """Any constant of the depth picture goes; the rim's mean, which sinks with a press, becomes zero instead.

    As [depth] `gauge = "margin"` makes it.
    """
    u = WHITE(u, methods, rng)
    return u - [0.0, 0.0, u[gauge_nodes(methods.board), 2].mean()]


WHITE = _with(WHITE_NOISE)
CORRELATED = _with(CORRELATED_NOISE)
FAULTS = (
    Fault("none", WHITE),
    Fault(f"correlation of {BESIDE} with the next node", CORRELATED, noise=CORRELATED_NOISE),
    Fault(f"{HOLE_MM} mm under the contact not measured", _hole),
    Fault("depth off by any constant, zeroed at the rim", _zeroed),
    *(Fault(f"{name}, not fitted", WHITE, error) for name, error in MODEL_ERRORS.items()),
    Fault("finite strain, calibrated for it", WHITE, strain="finite"),
)  # fmt: skip


@cache
def on_pad(
    board: str, error: PadError | None, strain: Strain = "linear", contacts: tuple[Recipe, ...] = UNSEEN
) -> list[State]:
    """The contacts that are heavy enough, on one pad of a board; None: as the board has it."""
    made = make_states(find_board(board), contacts, DEPTHS_MM, error, truth=strain)
    return [s for s in made if s.resultant_n >= LIGHT_N]


def on_fitted_pads(board: str, contacts: tuple[Recipe, ...] = UNSEEN) -> list[State]:
    """On pads that are off by what a fit leaves, each contact with a modulus of its own."""
    all_pads = [s for error in RESIDUAL_ERRORS for s in on_pad(board, error, contacts=contacts)]
    rng = np.random.default_rng(SEED)
    return [replace(s, force=drawn_modulus(rng) * s.force) for s in all_pads]


def on_pads_as_stated(board: str, wrong: PadError) -> list[State]:
    """On four pads that were not measured: Poisson's ratio or thickness is off as much as this one's, either way.

    Of a pad whose modulus is wrong, UNMEASURED_PADS. The modulus is drawn for each contact as the board states it.
    """
    pads = UNMEASURED_PADS if replace(wrong, modulus=1.0) == PadError() else 2 * (wrong, opposite(wrong))
    rng, sigma = np.random.default_rng(SEED), find_board(board).pad.stiffness_sigma_1e3 * 1e-3
    return [replace(s, force=drawn_modulus(rng, sigma) * s.force) for error in pads for s in on_pad(board, error)]


def measured_share(board: str, noise: Disturbance) -> tuple[float, float, float] | None:
    """The share of correlated noise as `cal fit` measures it, on N_REST untouched frames."""
    found, rng = find_board(board), np.random.default_rng(SEED)
    shape = (found.grid.n_y, found.grid.n_x, 3)
    frames = [noise.draw(shape, rng).reshape(-1, 3) for _ in range(N_REST)]
    return long_share(Power.mean([power_of(frame, planes(found), shape) for frame in frames]))


def growth_on(methods: Methods, contacts: tuple[Recipe, ...]) -> list[float]:
    """Of shear, normal force and wrench: LINEAR_GROWTH with which 95 % of the truths lie within two sigma."""
    counted = coverage_of(methods, FAULTS[0], on_fitted_pads(methods.board.name, contacts))
    parts = {"shear": ("shear inside",), "normal": ("normal inside",), "wrench": WRENCH_AXES}
    return [
        getattr(LINEAR_GROWTH, name)
        * float(np.quantile(np.concatenate([counted.columns[c].ratio for c in columns]), TWO_SIGMA) / 2) ** 2
        for name, columns in parts.items()
    ]


def coverage_of(methods: Methods, fault: Fault, pads: list[State]) -> Coverage:
    board = methods.board
    counted = Coverage(methods.places, board.field.force_lsb_un * 1e-6, board.contact.threshold_un * 1e-6)
    for i, state in enumerate(pads):
        counted.add(_stated(methods, fault, i, state), state.force)
    return counted


def _stated(methods: Methods, fault: Fault, i: int, state: State) -> Stated:
    u = fault.observe(state.displacement, methods, np.random.default_rng((SEED, i)))
    return methods.stated(u, is_fitted=fault.wrong is None, strain=fault.strain)


def judge(methods: Methods, fault: Fault) -> list[str]:
    """The cells of one row."""
    board, scores = methods.board, Scores()
    same = on_pad(board.name, fault.wrong, fault.strain)
    for i, state in enumerate(same):
        scores.add(state, _stated(methods, fault, i, state).force, methods.step_mm)
    if fault.wrong is not None:
        pads = on_pads_as_stated(board.name, fault.wrong)
    else:
        pads = same if fault.strain == "finite" else on_fitted_pads(board.name)
    counted = coverage_of(methods, fault, pads)
    means, columns = scores.means(), counted.summary()

    def within(*names: str) -> str:
        return ", ".join(f"{np.mean([columns[name][f'within_{k}'] for name in names]):.0f}" for k in (1, 2)) + " %"

    return [
        fault.name, f"{means['tangential']:.2f}", f"{means['normal']:.2f}", f"{1e3 * means['resultant_n']:.0f} mN",
        within("shear inside"), within("normal inside"), within(*WRENCH_AXES),
    ]  # fmt: skip


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--only", default="", metavar="TEXT", help="only faults whose name has this")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    parser.add_argument("--lists", action="store_true", help="print the growth that other lists of contacts ask for")
    given = parser.parse_args(words)
    if given.lists:
        with contextlib.closing(Methods(find_board(given.board), long_share=(0.0, 0.0, 0.0))) as methods:
            found = {name: growth_on(methods, getattr(states, name)) for name in LISTS}
        found["geometric mean"] = np.exp(np.mean(np.log(list(found.values())), axis=0)).tolist()
        print("\n".join(aligned(("", "shear", "normal", "wrench"), [
            (name, *(f"{v:.2f}" for v in row)) for name, row in found.items()
        ], "  ")))  # fmt: skip
        return 0
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    if not (faults := [one for one in FAULTS if given.only in one.name]):
        parser.error(f"--only {given.only}: no fault has this in its name: {', '.join(one.name for one in FAULTS)}")
    for strain, noise in dict.fromkeys((one.strain, one.noise) for one in faults):
        share = measured_share(given.board, noise)
        with contextlib.closing(Methods(find_board(given.board), strain, long_share=share)) as methods:
            for fault in (one for one in faults if (one.strain, one.noise) == (strain, noise)):
                row = f"| {' | '.join((*judge(methods, fault), at, date))} |"
                print(row, flush=True)
                if given.table is not None:
                    text = with_row(given.table.read_text(), row, SECTION, COLUMNS)
                    write_whole(given.table, text.encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
