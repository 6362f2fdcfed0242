"""Lift a thing of unknown weight and friction with the least force, by friction and slip; then it is pushed.

python adaptive_grip.py [--board BOARD] [--seeds N] [--film FILE.gif]
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from comparison import Outcome, compare

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

    Until then a slip state in which at least the share `much_slip` slips corrects a guess. The control code is that of
    the hardware.
    """

    def __init__(self, much_slip: float = 0.0) -> None:
        self.friction, self.grip_n, self.much_slip = GUESS, TOUCH_N, much_slip

    def __call__(self, frames: dict, _: dict) -> float:
        needed = TOUCH_N
        for frame in frames.values():
            if not frame.is_valid:
                return self.grip_n  # nothing is known: hold
            for contact in frame.contacts.contacts[:1]:
                shear = float(np.hypot(*contact.force[:2]))
                if contact.friction is not None:
                    self.friction = min(max(contact.friction, 0.2), 1.2)
                elif contact.slip_state == "slides" or (
                    contact.slip_state == "incipient" and (contact.slip_share or 0.0) >= self.much_slip
                ):
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
class Result(Outcome):
    FAILURES = ("is_dropped", "is_broken")

    is_dropped: bool
    is_broken: bool
    grip_n: float  # while it was held still
    least_n: float


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
        return Result(gripper.slipped_m >= DROPPED_M, most >= task.breaks_n, float(np.mean(held)), least)


def over_least(results: list[Result]) -> str:
    """The force over the least."""
    return f"grip {np.median([r.grip_n / r.least_n for r in results]):.2f} of the least that holds"


def main(arguments: Sequence[str] | None = None) -> None:
    goal = "lifted, pushed, neither dropped nor broken"
    compare(
        "adaptive_grip", __doc__, arguments, goal=goal, feedbacks=FEEDBACK, task=Task.of_seed, run=run,
        measure=over_least,
    )  # fmt: skip


if __name__ == "__main__":
    main()
