"""Lift a thing of unknown weight and friction with the least force, by friction and slip; then it is pushed.

python adaptive_grip.py [--board BOARD] [--seeds N] [--film FILE.gif]
"""

import argparse
import functools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ruffini.boards import find_board
from ruffini.errors import InputError, RuffiniError
from ruffini.robot import Gripper, Thing
from ruffini.robot.core_sensor import NOISE_M
from ruffini.robot.film import Film

TOUCH_N, MOST_N = 0.6, 12.0
SAFETY = 1.3  # of the force over the least that friction holds
GUESS = 0.8  # friction of the first guess; a slip corrects it
CLOSE, LIFT, HOLD, PUSH, AFTER = 40, 90, 30, 30, 30  # frames
HEIGHT_M = 0.05
DROPPED_M = 0.01


@dataclass(frozen=True)
class Task:
    """What nobody tells the gripper."""

    thing: Thing
    push_n: tuple[float, float, float]
    breaks_n: float

    @classmethod
    def of_seed(cls, seed: int) -> "Task":
        rng = np.random.default_rng(seed)
        thing = Thing(mass_kg=float(rng.uniform(0.06, 0.3)), friction=float(rng.uniform(0.4, 0.9)))
        push = rng.uniform(0.3, 1.0)
        least = (9.81 * thing.mass_kg + push) / (2 * thing.friction)
        return cls(thing, (0.0, 0.0, -float(push)), float(least * rng.uniform(2.0, 3.0)))


class ByFriction:
    """Ours: the grip follows the shear over the friction coefficient that the pads measure once something slips.

    Until then the slip state corrects a guess. The control code is that of the hardware.
    """

    def __init__(self) -> None:
        self.friction, self.grip_n = GUESS, TOUCH_N

    def __call__(self, frames: dict, _: dict) -> float:
        needed = TOUCH_N
        for frame in frames.values():
            if not frame.is_valid:
                return self.grip_n  # nothing is known: hold
            for contact in frame.contacts.contacts[:1]:
                shear = float(np.hypot(*contact.force[:2]))
                if contact.friction is not None:
                    self.friction = min(max(contact.friction, 0.2), 1.2)
                elif contact.slip_state in ("incipient", "slides"):
                    self.friction = max(0.97 * self.friction, 0.2)
                needed = max(needed, SAFETY * shear / self.friction)
                if contact.slip_state == "slides" and shear > 0.1:
                    needed = max(needed, self.grip_n + 0.15)
        self.grip_n += float(np.clip(needed - self.grip_n, -0.02, 0.3))
        return self.grip_n


def by_perfect_force(_: dict, force: dict) -> float:
    """A force sensor without error or noise says nothing of friction: half is assumed."""
    shear = max(float(np.hypot(*f[:2])) for f in force.values())
    return max(TOUCH_N, SAFETY * shear / 0.5)


def blind(_: dict, __: dict) -> float:
    """No feedback: one force for all."""
    return 2.5


FEEDBACK = {"friction": ByFriction, "perfect force": lambda: by_perfect_force, "none": lambda: blind}


@dataclass(frozen=True)
class Result:
    is_held: bool
    is_whole: bool
    grip_n: float  # while it was held still
    least_n: float

    @property
    def is_success(self) -> bool:
        return self.is_held and self.is_whole


def run(feedback: str, task: Task, board: str, seed: int = 0, film: Film | None = None) -> Result:
    """One attempt."""
    control, held, most = FEEDBACK[feedback](), [], 0.0
    with Gripper(board, task.thing, noise_m=NOISE_M, seed=seed, is_feeling=feedback == "friction") as gripper:
        gripper.grip_n = TOUCH_N
        for i in range(CLOSE + LIFT + HOLD + PUSH + AFTER):
            after_lift = i - CLOSE - LIFT - HOLD
            gripper.lift_m = HEIGHT_M * float(np.clip((i - CLOSE) / LIFT, 0, 1))
            gripper.push(task.push_n if 0 <= after_lift < PUSH else (0.0, 0.0, 0.0))
            frames = gripper.step()
            most = max(most, *(float(-force[2]) for force in gripper.true_force.values()))
            if i >= CLOSE:
                gripper.grip_n = float(np.clip(control(frames, gripper.true_force), TOUCH_N, MOST_N))
            if -HOLD // 2 <= after_lift < 0:
                held.append(gripper.grip_n)
            if film is not None and i % 3 == 0:
                film.take(gripper, frames, f"grip {gripper.grip_n:.2f} N, slipped {1e3 * gripper.slipped_m:.1f} mm")
        least = 9.81 * task.thing.mass_kg / (2 * task.thing.friction)
        return Result(gripper.slipped_m < DROPPED_M, most < task.breaks_n, float(np.mean(held)), least)


def check(board: str, n_seeds: int, film: str | None) -> None:
    """Refuse what would fail after minutes."""
    if unmeasured := [
        axis for axis in ("force_x", "force_y", "force_z") if axis in find_board(board).board.not_measured
    ]:
        raise InputError(
            f"board {board!r} does not measure {', '.join(unmeasured)}, which this example needs: use another"
        )
    if n_seeds < 1:
        raise InputError(f"--seeds {n_seeds}: give at least 1")
    if film and not (film.endswith(".gif") and Path(film).absolute().parent.is_dir()):
        raise InputError(f"--film {film}: give a .gif in a folder that exists")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--film", help="write an animated picture of the first seed here, and no table")
    chosen = parser.parse_args(arguments)
    try:
        check(chosen.board, chosen.seeds, chosen.film)
        compare(chosen.board, chosen.seeds, chosen.film)
    except RuffiniError as error:
        print(f"adaptive_grip: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def compare(board: str, n_seeds: int, path: str | None) -> None:
    """The table of all feedbacks; or the film of one attempt, to `path`."""
    if path:
        film = Film()
        print(run("friction", Task.of_seed(1), board, film=film))
        film.write(path)
        return
    print(f"SIMULATED, {board}, {n_seeds} seeds: lifted, pushed, neither dropped nor broken")
    for feedback in FEEDBACK:
        attempt = functools.partial(run, feedback, board=board)
        results = [attempt(Task.of_seed(seed), seed=seed) for seed in range(n_seeds)]
        over = np.median([r.grip_n / r.least_n for r in results])
        print(
            f"{feedback:14s} success {sum(r.is_success for r in results):2d}, dropped "
            f"{sum(not r.is_held for r in results):2d}, broken {sum(not r.is_whole for r in results):2d}; "
            f"grip {over:.2f} of the least that holds",
            flush=True,
        )


if __name__ == "__main__":
    main()
