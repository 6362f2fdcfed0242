"""Old, moved and altered pictures of a camera, through the core: does a wrong force ever pass unmarked?

A unit is pressed into a few states; of each, frames with noise of their own are drawn as tests/bench/false_flags.py
draws them. A sequence learns rest, shows good frames of one state, then N_BAD frames with one fault. A frame is wrong
where a force component that it calls VALID, without any flag, is off the truth by more than 0.1 N and 10 % of the true
force. States whose good frames come near to that are not used: that would be another fault's business.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from calibrations import calibration
from row import Row, Wanted

from ruffini.bench import picture_faults as faults
from ruffini.boards import find_board
from ruffini.core import Pipeline
from ruffini.core.pipeline import Frame
from ruffini.estimators.skin.presses import skin_of
from ruffini.sim.indenters import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.units import build_unit

sys.path.append(str(Path(__file__).parents[1] / "bench"))
from false_flags import Drawn

Picture = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]
Show = Callable[[Picture], Frame]

N_RENDERS, N_GOOD, N_BAD, MOST_BETWEEN, N_OLD = 24, 3, 4, 12, 9
UNCALIBRATED, VALID = 2 | 4, 1
LEAST_N, SHARE = 0.1, 0.1
ZERO_FRAMES = (0, 8, 40)
N_NOTES = 3  # wrong sequences that a row names
MOST_TRIES, STEPS = 6, 3


class Press(NamedTuple):
    """Where and how a board is pressed: middle, reach and depths in m, radii of balls in m."""

    n_states: int
    radius_m: tuple[float, float]
    depth_m: tuple[float, float]
    reach_m: tuple[float, float] = (4e-3, 3e-3)
    middle_m: tuple[float, float] = (0.0, 0.0)
    shear_m: float = 0.3e-3
    capture_s: float | None = None  # of every frame: no time passes, and nothing relaxes; None: the board's rate


BOARDS = {
    "gelslim": Press(6, (2e-3, 6e-3), (0.25e-3, 0.8e-3)),
    "ftouch": Press(4, (3e-3, 6e-3), (0.3e-3, 0.9e-3)),
    "contact-glitter": Press(4, (4e-3, 9e-3), (0.6e-3, 1.8e-3)),
    "stereo-fingertip": Press(4, (4e-3, 9e-3), (0.4e-3, 1.2e-3)),
    "stereo-fingertip-thick": Press(4, (4e-3, 9e-3), (0.8e-3, 2.4e-3)),
    "eltac": Press(3, (8e-3, 15e-3), (1.2e-3, 2.4e-3), (2e-3, 4e-3), (-36e-3, 5e-3), 0.0, 0.0),
}
# How often each kind of fault is tried on a board: gelslim measures most, and has all of the frame path's stages.
CASES = {"gelslim": 15}
USUAL_CASES = 5
# What no flag can tell (proto/PROMISES.md): targets that ride on a sprung tray move with the camera as under a load.
UNTOLD = {"ftouch": "moved"}


@dataclass
class State:
    """Frames of a pad that is held still, and its true force, N."""

    draw: Drawn
    force_n: Array

    def frame(self) -> Picture:
        return self.draw.frame()

    @property
    def limit_n(self) -> float:
        return max(LEAST_N, SHARE * float(np.linalg.norm(self.force_n)))


def wrong_by(frame: Frame, state: State) -> float:
    """Largest error of a force component that passes unmarked, newtons; 0: none that counts."""
    if frame.flags & ~UNCALIBRATED:
        return 0.0
    error = np.abs(frame.wrench[:3] - state.force_n) * (np.array(frame.wrench_validity[:3]) == VALID)
    return float(error.max()) if error.max() > state.limit_n else 0.0


def states_of(unit: Unit, name: str, press: Press, seed: int) -> Iterator[State]:
    """The untouched one, then pressed ones without end."""
    rng, renderer = np.random.default_rng([seed, *name.encode()]), unit.renderer()

    def state(rig_displacement: Array, tray: object, force_n: Array) -> State:
        pictures = [renderer.image(rig_displacement, rng, tray=tray) for _ in range(N_RENDERS)]  # type: ignore[arg-type]
        return State(Drawn(pictures, np.random.default_rng(int(rng.integers(2**32)))), force_n)

    rig = unit.rig()
    yield state(rig.displacement.copy(), rig.tray, np.zeros(3))
    while True:
        rig = unit.rig()
        rig.take(Indenter("sphere", float(rng.uniform(*press.radius_m))))
        x, y = np.array(press.middle_m) + rng.uniform(-1, 1, 2) * press.reach_m
        depth, shear = rng.uniform(*press.depth_m), rng.uniform(0, press.shear_m)
        for i in range(STEPS):
            rig.advance(Pose(float(x), float(y), float(depth) * (i + 1) / STEPS))
        if shear:
            rig.advance(Pose(float(x + shear), float(y), float(depth)))
        yield state(rig.displacement.copy(), rig.tray, _force_n(unit, np.asarray(rig.wrench()), x))


def _force_n(unit: Unit, wrench: Array, x_m: float) -> Array:
    """What the board measures of a wrench: a tube tells the force into its skin as -z."""
    if unit.twin.shape.kind != "tube":
        return np.asarray(wrench[:3])
    angle = x_m * 1e6 / skin_of(unit.board).radius_um
    return np.array([0.0, 0.0, wrench[:2] @ np.array([np.cos(angle), np.sin(angle)])])


# A fault's pictures: of the state that is shown, and of one that was shown before.
Case = Callable[[State, list[Picture], np.random.Generator], Iterator[Picture]]


def _each(
    make: Callable[[np.random.Generator], tuple[str, faults.Fault]],
) -> Callable[[np.random.Generator], tuple[str, Case]]:
    """The same fault on each frame."""

    def drawn(rng: np.random.Generator) -> tuple[str, Case]:
        name, fault = make(rng)
        return name, lambda now, _, lot: (fault(now.frame(), lot) for _ in range(N_BAD))

    return drawn


def _ring(rng: np.random.Generator) -> tuple[str, Case]:
    n = int(rng.integers(2, 9))
    return f"ring of {n}", lambda _, old, __: (old[-n:][i % n] for i in range(n + 2))


def _torn(rng: np.random.Generator) -> tuple[str, Case]:
    start, part, ago = rng.uniform(0, 0.8), rng.uniform(0.1, 0.9), int(rng.integers(1, 6))
    stop = min(start + part, 1.0)
    if rng.random() < 0.5:
        start, stop = (0.0, stop) if rng.random() < 0.5 else (start, 1.0)
    across = (0.0, 1.0) if rng.random() < 0.7 else ((0.0, 0.5) if rng.random() < 0.5 else (0.5, 1.0))

    def case(now: State, old: list[Picture], lot: np.random.Generator) -> Iterator[Picture]:
        return (faults.torn(old[-ago], start, stop, *across)(now.frame(), lot) for _ in range(N_BAD))

    return f"torn {start:.2f} to {stop:.2f}, columns {across[0]:g} to {across[1]:g}, {ago} ago", case


def _zoomed(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    zoom = 1 + float(rng.choice([-1, 1])) * float(np.exp(rng.uniform(np.log(2e-3), np.log(0.05))))
    return f"zoom {zoom:.4f}", faults.moved(zoom=zoom)


def _shifted(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    way, angle = np.exp(rng.uniform(np.log(0.3), np.log(15))), rng.uniform(0, 2 * np.pi)
    shift = float(way * np.cos(angle)), float(way * np.sin(angle))
    return f"shift {shift[0]:.2f} {shift[1]:.2f} px", faults.moved(shift)


def _turned(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    turn = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.1), np.log(8))))
    return f"turn {turn:.2f} deg", faults.moved(turn_deg=turn)


def _moved_at_random(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    shift, zoom = rng.uniform(-6, 6, 2), 1 + rng.uniform(-0.03, 0.03)
    turn = rng.uniform(-3, 3)
    return (f"shift {shift[0]:.1f} {shift[1]:.1f} zoom {zoom:.3f} turn {turn:.1f}",
            faults.moved((float(shift[0]), float(shift[1])), float(zoom), float(turn)))  # fmt: skip


def _posterised(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    n, copied = int(rng.integers(1, 6)), bool(rng.random() < 0.3)
    return f"{n} low bits {'copied' if copied else 'lost'}", faults.posterised(n, is_replicated=copied)


def _compressed(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    quality = int(rng.integers(8, 80))
    return f"JPEG {quality}", faults.compressed(quality)


def _toned(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    gamma = 1 + float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.01), np.log(0.3))))
    return f"gamma {gamma:.3f}", faults.toned(gamma)


def _black(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    level = float(rng.choice([-1, 1]) * np.round(np.exp(rng.uniform(np.log(2), np.log(30)))))
    return f"black level {level:+g}", faults.toned(black=level)


def _slipped(rng: np.random.Generator) -> tuple[str, faults.Fault]:
    start = rng.uniform(0, 0.8)
    stop = min(1.0, start + rng.uniform(0.05, 0.8))
    columns, rows = (int(rng.integers(1, 20)) * int(rng.choice([-1, 1])), 0) if rng.random() < 0.7 else (
        0, int(rng.integers(1, 12)) * int(rng.choice([-1, 1])))  # fmt: skip
    return f"slip {start:.2f} to {stop:.2f} by {columns} {rows} px", faults.slipped(start, stop, columns, rows)


KINDS = {
    "old: ring of buffers": _ring,
    "old: torn": _torn,
    "moved: zoom": _each(_zoomed),
    "moved: shift": _each(_shifted),
    "moved: turn": _each(_turned),
    "moved: all at once": _each(_moved_at_random),
    "altered: low bits": _each(_posterised),
    "altered: JPEG": _each(_compressed),
    "altered: gamma": _each(_toned),
    "altered: black level": _each(_black),
    "altered: slipped rows": _each(_slipped),
}


@dataclass
class Tally:
    tried: int = 0
    wrong: int = 0
    worst_n: float = 0.0
    notes: list[str] = field(default_factory=list)

    def add(self, worst_n: float, label: str) -> None:
        """Count a sequence; `worst_n` is what wrong_by says of its worst frame."""
        self.tried += 1
        if worst_n:
            self.wrong += 1
            self.worst_n = max(self.worst_n, worst_n)
            self.notes.append(f"{label}: {worst_n:.2f} N")


def rows(seed: int, quick: bool, is_wanted: Wanted) -> Iterator[Row]:
    """A row for each kind of fault on each board."""
    for name in filter(is_wanted, BOARDS):
        yield from board_rows(name, BOARDS[name], seed, quick)


def board_rows(name: str, press: Press, seed: int, quick: bool) -> Iterator[Row]:
    """Sequences of one board."""
    try:
        file = calibration(name)
    except subprocess.CalledProcessError as error:
        yield Row(name, "none", 0, 0, 0, note=f"not tried: no calibration, {shlex.join(error.cmd[3:])} failed")
        return
    unit = build_unit(find_board(name))
    n_cases = 2 if quick else CASES.get(name, USUAL_CASES)
    source = states_of(unit, name, press, seed)
    rest = next(source)
    with Pipeline(unit.board, file) as pipeline:
        pipeline.set_live()

        def show(picture: Picture) -> Frame:
            return pipeline.process(picture, press.capture_s)

        for _ in range(unit.board.pipeline.n_rest_frames + N_GOOD):
            show(rest.frame())
        pressed: list[State] = []
        n_tries = 0
        while len(pressed) < (2 if quick else press.n_states) and n_tries < MOST_TRIES * press.n_states:
            state, n_tries = next(source), n_tries + 1
            if _is_right(show, rest, state):
                pressed.append(state)
        if not pressed:
            yield Row(name, "pressed states", 1, 0, 1, note="no pressed state whose good frames are right")
            return
        for k, (kind, draw) in enumerate(KINDS.items()):
            if kind.startswith(UNTOLD.get(name, "-")):
                continue
            rng = np.random.default_rng([seed, k, *name.encode()])
            tally = Tally()
            for i in range(n_cases * (3 if kind.startswith("old") else 2)):
                label, case = draw(rng)
                now = rest if i % 2 else pressed[int(rng.integers(len(pressed)))]
                before = pressed[int(rng.integers(len(pressed)))] if i % 2 else rest
                _sequence(show, rest, now, before, label, case, kind.startswith("old"), rng, tally)
            note = f"{len(pressed)} states; " + "; ".join(tally.notes[:N_NOTES])
            yield Row(name, kind, tally.tried, tally.tried - tally.wrong, tally.wrong, tally.worst_n, note=note)
        rng = np.random.default_rng([seed, len(KINDS), *name.encode()])
        yield _zero_row(name, pipeline, show, rest, pressed, rng, 2 * n_cases)


def _zero_row(
    name: str, pipeline: Pipeline, show: Show, rest: State, pressed: list[State], rng: np.random.Generator, n: int
) -> Row:
    """A press that begins in any frame of learning rest and stays; afterwards rest is learned from good frames."""
    tally = Tally()
    for _ in range(n):
        asked, now = int(rng.choice(ZERO_FRAMES)), pressed[int(rng.integers(len(pressed)))]
        n_learned = asked or pipeline.board.pipeline.n_rest_frames
        n_free = int(rng.integers(0, n_learned))
        pipeline.zero(asked)
        for _ in range(n_free):
            show(rest.frame())
        errors = [wrong_by(show(now.frame()), now) for _ in range(n_learned + 2)]
        tally.add(max(errors), f"{asked} frames, pressed from frame {n_free} on, {np.round(now.force_n, 2).tolist()} N")
        pipeline.zero(0)
        for _ in range(pipeline.board.pipeline.n_rest_frames + N_GOOD):
            show(rest.frame())
    return Row(name, "rest: zeroed with a press in it", tally.tried, tally.tried - tally.wrong, tally.wrong,
               tally.worst_n, note=f"{len(pressed)} states; " + "; ".join(tally.notes[:N_NOTES]))  # fmt: skip


def _is_right(show: Show, rest: State, state: State) -> bool:
    """Whether good frames of a state are well within the limit, without a flag."""
    good = [show(state.frame()) for _ in range(N_GOOD)]
    is_right = all(
        not f.flags & ~UNCALIBRATED
        and (np.abs(f.wrench[:3] - state.force_n) * (np.array(f.wrench_validity[:3]) == VALID)).max()
        < state.limit_n / 2
        for f in good
    )
    _go_back(show, rest)
    return is_right


def _go_back(show: Show, rest: State) -> None:
    """Good untouched frames until none is flagged."""
    for i in range(MOST_BETWEEN):
        if not show(rest.frame()).flags & ~UNCALIBRATED and i >= N_GOOD:
            break


def _sequence(
    show: Show, rest: State, now: State, before: State, label: str, case: Case, is_of_old: bool,
    rng: np.random.Generator, tally: Tally,
) -> None:  # fmt: skip
    """One sequence: `before`, where old pictures come from, and `now`, by which frames are judged."""
    old = [(before if is_of_old else now).frame() for _ in range(N_OLD)]
    for picture in old:
        show(picture)
    if is_of_old:
        show(now.frame())
    worst = max(wrong_by(show(picture), now) for picture in case(now, old, rng))
    state = "untouched" if now is rest else f"{np.round(now.force_n, 2).tolist()} N"
    tally.add(worst, f"{label} on {state}")
    _go_back(show, rest)
