"""Flat punches, edges and plates, and presses that come while rest is learned: does a wrong force ever pass unmarked?

A case is a frame of one press after frames of the untouched pad. It is wrong where a force component that it calls
VALID, without any flag, is off the truth by more than 0.1 N and 10 % of the true force. On gelslim's linear pad one
contact is solved for each place of a face and scaled to the forces drawn: a flat face touches all of itself at once, so
displacement and force grow together. On boards with a sprung tray each depth is solved. A row counts how many
right forces are flagged all the same: the cost of the promise.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from calibrations import calibration
from row import Row, Wanted

from ruffini.boards import find_board
from ruffini.core import Pipeline
from ruffini.core.pipeline import Frame
from ruffini.demo.main_job import DEMO_ERROR
from ruffini.errors import RuffiniError
from ruffini.sim.indenters import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.unit import PadError, TwinUnit
from ruffini.sim.units import build_unit

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

LEAST_N, SHARE = 0.1, 0.1
UNCALIBRATED, VALID = 2 | 4, 1
FORCES_N, DEEPEST_M, SOLVED_M = (0.05, 15.0), 1.0e-3, 0.2e-3
MM = 1e-3
PAD, TRAY_BOARDS = "gelslim", ("ftouch",)
TRAY_DEPTHS_M = (0.02e-3, 0.9e-3)
ZERO_FRAMES = (0, 8, 40)


class Face(NamedTuple):
    """What presses where: half width and place in mm, tilt in rad, shift over depth."""

    shape: str
    half_mm: float
    x_mm: float = 0.0
    y_mm: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    shift: float = 0.0


def _faces(rng: np.random.Generator, n: int) -> dict[str, list[Face]]:
    """Faces of each group, n of each."""

    def shape() -> str:
        return str(rng.choice(["square", "flat", "triangle", "hexagon"]))

    def at(reach: float) -> tuple[float, float]:
        return float(rng.uniform(-reach, reach)), float(rng.uniform(-reach, reach) * 0.7)

    half = [float(v) for v in rng.uniform(2, 5.5, 4 * n)]
    tilt = [(float(rng.uniform(-0.03, 0.03)), float(rng.uniform(-0.03, 0.03))) for _ in range(n)]
    return {
        "flat punches of 2 to 5.5 mm": [Face(shape(), half[i], *at(6.5 - half[i])) for i in range(n)],
        "tilted": [Face(shape(), half[n + i], *at(6.0 - half[n + i]), *tilt[i]) for i in range(n)],
        "sheared": [Face(shape(), half[2 * n + i], *at(6.0 - half[2 * n + i]), shift=0.25) for i in range(n)],
        "wide, up to 8 mm": [Face("square", float(rng.uniform(5.5, 8)), *at(1.0)) for _ in range(n)],
        "over the pad's edge": [Face("square", half[3 * n + i], *(float(s) * v for s, v in
                                zip(rng.choice([-1, 1], 2), (9.0, rng.uniform(0, 7)), strict=True))) for i in range(n)],
        "plates wider than the pad": [Face("square", float(rng.uniform(12, 16)), *at(1.0)) for _ in range(-(-n // 4))],
        "balls of 2 to 6 mm": [Face("sphere", float(rng.uniform(2, 6)), *at(4.0), shift=float(rng.choice([0, 0.25])))
                               for _ in range(n)],
    }  # fmt: skip


class Outcome(NamedTuple):
    """One press: what the force is off by, N, whether that is within the limit, and whether the frame has a flag."""

    error_n: float
    is_near: bool
    is_flagged: bool


def outcome(frame: Frame, truth_n: Array) -> Outcome:
    """A frame against the truth. A component that is not VALID counts in no error, unless a flag made it so."""
    is_flagged = bool(frame.flags & ~UNCALIBRATED)
    counts = np.array([is_flagged or v == VALID for v in frame.wrench_validity[:3]])
    error = float(np.linalg.norm((frame.wrench[:3] - truth_n)[counts]))
    return Outcome(error, error <= max(LEAST_N, SHARE * float(np.linalg.norm(truth_n))), is_flagged)


def _row(board: str, family: str, outcomes: list[Outcome]) -> Row:
    wrong = [o.error_n for o in outcomes if not (o.is_near or o.is_flagged)]
    return Row(board, family, len(outcomes), len(outcomes) - len(wrong), len(wrong), max(wrong, default=0.0),
               sum(o.is_near for o in outcomes), sum(o.is_near and o.is_flagged for o in outcomes))  # fmt: skip


def _solved(unit: TwinUnit, face: Face) -> tuple[Array, Array] | None:
    """Displacement and wrench of a face at SOLVED_M; None where it cannot press there."""
    rig = unit.rig()
    try:
        rig.take(Indenter(face.shape, face.half_mm * MM))
        x, y = face.x_mm * MM, face.y_mm * MM
        rig.advance(Pose(x, y, SOLVED_M, 0.0, face.roll, face.pitch))
        if face.shift:
            rig.advance(Pose(x + face.shift * SOLVED_M, y, SOLVED_M, 0.0, face.roll, face.pitch))
    except RuffiniError:
        return None
    return rig.displacement.copy(), rig.wrench()


class _Pad:
    """A linear pad under the core, at rest to begin with."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.board, self.rng = find_board(PAD), rng
        self.unit = TwinUnit.build(self.board, PadError(**DEMO_ERROR))
        self.renderer = self.unit.renderer()
        self.core = Pipeline(self.board, calibration(PAD))
        self.core.set_live()
        self.still(self.board.pipeline.n_rest_frames + 2)

    def picture(self, displacement: Array | None = None) -> Picture:
        return self.renderer.image(self.unit.at_rest() if displacement is None else displacement, self.rng)

    def still(self, n: int) -> list[Frame]:
        return [self.core.process(self.picture()) for _ in range(n)]


def _press_rows(pad: _Pad, rng: np.random.Generator, n_faces: int, n_forces: int) -> Iterator[Row]:
    for group, faces in _faces(rng, n_faces).items():
        outcomes = []
        for face in faces:
            solved = _solved(pad.unit, face)
            if solved is None:
                continue
            displacement, wrench = solved
            for force_n in np.exp(rng.uniform(*np.log(FORCES_N), n_forces)):
                scale = min(force_n / -wrench[2], DEEPEST_M / SOLVED_M)
                frame = pad.core.process(pad.picture(displacement * scale))
                outcomes.append(outcome(frame, wrench[:3] * scale))
                pad.still(2)
        yield _row(PAD, group, outcomes)


def _untouched_row(pad: _Pad, n: int) -> Row:
    flagged = sum(bool(f.flags) for f in pad.still(n))
    return Row(PAD, "untouched, not flagged", n, n - flagged, flagged, n_good=n, n_flagged=flagged)


def _zero_rows(pad: _Pad, rng: np.random.Generator, n: int) -> Iterator[Row]:
    """A press that begins in any frame of learning rest and stays."""
    outcomes = []
    for _ in range(n):
        asked = int(rng.choice(ZERO_FRAMES))
        n_learned = asked or pad.board.pipeline.n_rest_frames
        solved = _solved(pad.unit, Face("sphere" if rng.random() < 0.5 else "square", float(rng.uniform(2, 5))))
        assert solved is not None
        displacement, wrench = solved
        scale = float(rng.uniform(0.3, 4)) / -wrench[2]
        pad.core.zero(asked)
        pad.still(int(rng.integers(0, n_learned)))
        for _ in range(n_learned + 2):
            frame = pad.core.process(pad.picture(displacement * scale))
        outcomes.append(outcome(frame, wrench[:3] * scale))
        pad.still(2)
    yield _row(PAD, "zeroed with a press in it", outcomes)


def _tray_row(name: str, rng: np.random.Generator, n: int) -> Row:
    board = find_board(name)
    unit = build_unit(board)
    renderer, outcomes = unit.renderer(), []
    with Pipeline(board, calibration(name)) as core:
        rig = unit.rig()
        for _ in range(board.pipeline.n_rest_frames + 2):
            core.process(renderer.image(rig.displacement, rng, tray=rig.tray))
        for _ in range(n):
            rig = unit.rig()
            depth = float(np.exp(rng.uniform(*np.log(TRAY_DEPTHS_M))))
            tilt = rng.uniform(-0.02, 0.02, 2) * rng.integers(0, 2)
            try:
                rig.take(Indenter(str(rng.choice(["square", "flat"])), float(rng.uniform(2, 6)) * MM))
                rig.advance(Pose(*rng.uniform(-2e-3, 2e-3, 2), depth, 0.0, *tilt))
            except RuffiniError:
                continue
            frame = core.process(renderer.image(rig.displacement, rng, tray=rig.tray))
            outcomes.append(outcome(frame, rig.wrench()[:3]))
    return _row(name, "flat punches through the elastomer", outcomes)


def rows(seed: int, quick: bool, is_wanted: Wanted) -> Iterator[Row]:
    """One row for each family."""
    rng = np.random.default_rng([seed, 26])
    if is_wanted(PAD):
        pad = _Pad(rng)
        yield _untouched_row(pad, 40 if quick else 400)
        yield from _press_rows(pad, rng, 2 if quick else 8, 5 if quick else 8)
        yield from _zero_rows(pad, rng, 4 if quick else 16)
    for name in filter(is_wanted, TRAY_BOARDS):
        yield _tray_row(name, np.random.default_rng([seed, 26, *name.encode()]), 6 if quick else 30)
