"""Faults of light, camera and coating at places and sizes drawn by chance, in states drawn by chance. SIMULATED.

    python tests/bench/drawn_faults.py --board gelslim --calibration FILE --states 30
    python tests/bench/drawn_faults.py --coarse --states 40     # the tests' pad: 160x120 pixels, markers 2 mm apart
    python tests/bench/drawn_faults.py --board stereo-fingertip --calibration FILE --states 40 --full-scale-n 1
    python tests/bench/drawn_faults.py --board contact-glitter --calibration FILE --deepest-mm 2

`ruffini bench health` shows each fault once, in the middle; here every state has each fault for one frame. Every fourth
state is untouched, in the others a ball or a flat punch presses and shears. A force that is wrong is counted where it
is more so than in the good frame before.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.bench.health import wrong_by
from ruffini.bench.picture_faults import Picture, painted
from ruffini.boards import find_board
from ruffini.core import Pipeline
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import Conditions
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.units import build_unit

SEED = 4711
N_LEARN, N_SAME, N_BETWEEN, N_BACK = 12, 4, 3, 60  # frames: after rest; of a state; of none after it, at least and most
EVERY_UNTOUCHED, FLAT_SHARE, STEPS, SHEAR_STEPS = 4, 0.3, 3, 2
TEAR_UM, LEAK, SPOTS = (500, 1000, 1500, 2000, 3000), (0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.3), (
    0.02, 0.05, 0.1, 0.2, 0.3, 0.5)  # fmt: skip

State = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64] | None]


class Tally(NamedTuple):
    """Of one fault: frames, those with a flag, those with an unmarked wrong force, the worst of these in newtons."""

    n: int = 0
    flagged: int = 0
    wrong: int = 0
    worst_n: float = 0.0


class Pad:
    """A unit's pictures, with the camera's noise."""

    def __init__(self, unit: Unit, deepest_m: float, rng: np.random.Generator) -> None:
        self._unit, self._rng, self._renderer, self._deepest_m = unit, rng, unit.renderer(), deepest_m

    def rest(self) -> State:
        rig = self._unit.rig()
        return rig.displacement.copy(), rig.tray

    def pressed(self) -> tuple[State, npt.NDArray[np.float64]]:
        """Somewhere, by something; with the true wrench."""
        rng, rig = self._rng, self._unit.rig()
        shape = "flat" if rng.random() < FLAT_SHARE else "sphere"
        rig.take(Indenter(shape, float(rng.uniform(1.5e-3, 6e-3 if shape == "sphere" else 3e-3))))
        x, y, depth = rng.uniform(-5e-3, 5e-3), rng.uniform(-3e-3, 3e-3), rng.uniform(0.2e-3, self._deepest_m)
        for i in range(STEPS):
            rig.advance(Pose(x, y, depth * (i + 1) / STEPS))
        shear = rng.uniform(0, 0.4e-3)
        for i in range(SHEAR_STEPS):
            rig.advance(Pose(x + shear * (i + 1) / SHEAR_STEPS, y, depth))
        return (rig.displacement.copy(), rig.tray), np.asarray(rig.wrench())

    def picture(self, state: State, conditions: Conditions | None = None) -> Picture:
        return self._renderer.image(state[0], self._rng, conditions=conditions, tray=state[1])

    def faults(self, state: State) -> dict[str, Callable[[], Picture]]:
        """Each as it would look now, at a place of its own."""
        rng = self._rng

        def torn(radius_um: int) -> Picture:
            at = int(rng.uniform(-7000, 7000)), int(rng.uniform(-5000, 5000))
            return self.picture(state, Conditions(tear_um=(*at, radius_um)))

        def spotted(share: float) -> Picture:
            return painted(share)(self.picture(state), np.random.default_rng(int(rng.integers(10**9))))

        def column(level: int) -> Picture:
            picture = self.picture(state).copy()
            picture[:, rng.integers(picture.shape[1])] = level
            return picture

        return (
            {f"hole, radius {1e-3 * r:g} mm": lambda r=r: torn(r) for r in TEAR_UM}
            | {f"daylight, {v:g} of the level": lambda v=v: self.picture(state, Conditions(leak=v)) for v in LEAK}
            | {f"spots on {100 * s:g} %": lambda s=s: spotted(s) for s in SPOTS}
            | {"column white": lambda: column(255), "column black": lambda: column(0)}
        )


def measure(
    unit: Unit, calibration: bytes, n_states: int, seed: int, full_scale_n: float, deepest_m: float
) -> dict[str, Tally]:
    """Every fault in every state; "none": the good frames."""
    pad, tallies = Pad(unit, deepest_m, np.random.default_rng(seed)), {"none": Tally()}
    rest = pad.rest()
    with Pipeline(unit.board, calibration) as pipeline:
        pipeline.set_live()
        for _ in range(unit.board.pipeline.n_rest_frames + N_LEARN):
            pipeline.process(pad.picture(rest))
        for k in range(n_states):
            state, truth = pad.pressed() if k % EVERY_UNTOUCHED else (rest, np.zeros(6))
            for _ in range(N_SAME):
                frame = pipeline.process(pad.picture(state))
                _count(tallies, "none", bool(frame.flags), 0.0)
            usual_n = wrong_by(pipeline, frame, truth, full_scale_n)
            for name, make in pad.faults(state).items():
                frame = pipeline.process(make())
                wrong_n = wrong_by(pipeline, frame, truth, full_scale_n)
                _count(tallies, name, bool(frame.flags), wrong_n if wrong_n > usual_n else 0.0)
                pipeline.process(pad.picture(state))
            for i in range(N_BETWEEN + N_BACK):
                if not pipeline.process(pad.picture(rest)).flags and i >= N_BETWEEN:
                    break
            print(f"state {k + 1} of {n_states}", end="\r", file=sys.stderr, flush=True)
    return tallies


def _count(tallies: dict[str, Tally], name: str, is_flagged: bool, wrong_n: float) -> None:
    was = tallies.get(name, Tally())
    tallies[name] = Tally(was.n + 1, was.flagged + is_flagged, was.wrong + (wrong_n > 0), max(was.worst_n, wrong_n))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--board")
    which.add_argument("--coarse", action="store_true")
    parser.add_argument("--calibration", type=Path, help="of --board")
    parser.add_argument("--states", type=int, default=30)
    parser.add_argument("--full-scale-n", type=float, default=4.0)
    parser.add_argument("--deepest-mm", type=float, default=1.1)
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    if given.board and not given.calibration:
        parser.error("--board needs --calibration FILE")
    with tempfile.TemporaryDirectory() as folder:
        if given.coarse:
            sys.path[:0] = [str(Path(__file__).parents[1] / name) for name in ("e2e", "support")]
            from tiny_sensor import make_sensor
            from tiny_twin import make_twin

            twin = make_twin(make_sensor(Path(folder) / "sensor"), Path(folder) / "twin")
            unit, calibration = twin.unit, twin.calibration
        else:
            unit, calibration = build_unit(find_board(given.board)), given.calibration.read_bytes()
        full_scale_n, deepest_m = given.full_scale_n, 1e-3 * given.deepest_mm
        tallies = measure(unit, calibration, given.states, given.seed, full_scale_n, deepest_m)
    print(f"{unit.board.name}, SIMULATED, {given.states} states, full scale {full_scale_n:g} N, seed {given.seed}")
    print(f"{'':28}{'frames':>8}{'flagged':>9}{'wrong, unmarked':>17}{'worst, N':>10}")
    for name, tally in tallies.items():
        print(f"{name:28}{tally.n:8}{100 * tally.flagged / tally.n:7.0f} %{tally.wrong:17}{tally.worst_n:10.2f}")


if __name__ == "__main__":
    main()
