"""Hold an egg that is shaken, a bottle that is filled and a ball that is tugged, and neither break nor drop them.

python egg_bottle_ball.py [--board BOARD] [--seeds N] [--film FILE.gif]

The pads are flat, where the paper's fingertips are domes. The grip is controlled as in adaptive_grip.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from adaptive_grip import DROPPED_M, FEEDBACK, HEIGHT_M, MOST_N, TOUCH_N, ByFriction
from comparison import Outcome, compare

from ruffini.robot import Gripper, Thing
from ruffini.robot.core_sensor import NOISE_M
from ruffini.robot.film import Film

APPROACH_N = 0.2  # a faster finger hits the thing
CLOSE, LIFT, HOLD, TROUBLE = 40, 80, 20, 80  # frames
G = 9.81
SHAKE_M, SHAKE_HZ = 0.005, 3.0
MUCH_SLIP = 0.4  # round things always slip at the rim of their contact
FEEDBACK = FEEDBACK | {"friction": lambda: ByFriction(MUCH_SLIP)}
KINDS = ("egg", "bottle", "ball")
SIZE_M = {"egg": (0.024, 0.024, 0.033), "bottle": (0.025, 0.045), "ball": (0.03,)}
SHAPE = {"egg": "ellipsoid", "bottle": "cylinder", "ball": "sphere"}


@dataclass(frozen=True)
class Task:
    """Unknown to the gripper: the thing, the largest force (N) on a bottle or ball, and the force that breaks it."""

    name: str
    thing: Thing
    trouble_n: float
    breaks_n: float

    @classmethod
    def of_seed(cls, seed: int) -> "Task":
        rng, name = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
        mass, friction = rng.uniform(0.1, 0.25), rng.uniform(0.4, 0.9)
        trouble, margin = rng.uniform(0.3, 1.2), rng.uniform(2.0, 3.0)
        load = {
            "egg": mass * (G + SHAKE_M * (2 * np.pi * SHAKE_HZ) ** 2),
            "bottle": mass * G + trouble,
            "ball": np.hypot(mass * G, trouble),
        }[name]
        thing = Thing(SHAPE[name], SIZE_M[name], float(mass), float(friction))
        return cls(name, thing, float(trouble), float(margin * load / (2 * friction)))

    def lift_m(self, frame: int, frame_s: float) -> float:
        """Of the arm: up, and the egg is then shaken."""
        after_s = max(frame - CLOSE - LIFT - HOLD, 0) * frame_s
        shaken = SHAKE_M * np.sin(2 * np.pi * SHAKE_HZ * after_s) if self.name == "egg" else 0.0
        return HEIGHT_M * float(np.clip((frame - CLOSE) / LIFT, 0, 1)) + float(shaken)

    def push_n(self, frame: int) -> tuple[float, float, float]:
        """Water runs into the bottle, and the ball is tugged along the pads for half of the time."""
        since = (frame - CLOSE - LIFT - HOLD) / TROUBLE
        if self.name == "bottle":
            return (0.0, 0.0, -self.trouble_n * float(np.clip(2 * since, 0, 1)))
        return (0.0, self.trouble_n if self.name == "ball" and 0 <= since < 0.5 else 0.0, 0.0)


@dataclass(frozen=True)
class Result(Outcome):
    FAILURES = ("is_dropped", "is_broken")

    is_dropped: bool
    is_broken: bool
    most_n: float
    breaks_n: float


def run(feedback: str, task: Task, board: str, seed: int = 0, film: Film | None = None) -> Result:
    """One attempt."""
    control, most, is_dropped = FEEDBACK[feedback](), 0.0, False
    with Gripper(board, task.thing, noise_m=NOISE_M, seed=seed, is_feeling=feedback == "friction") as gripper:
        gripper.grip_n = APPROACH_N
        for i in range(CLOSE + LIFT + HOLD + TROUBLE):
            gripper.lift_m = task.lift_m(i, gripper.frame_s)
            gripper.push(task.push_n(i))
            frames = gripper.step()
            most = max(most, *(float(-force[2]) for force in gripper.true_force.values()))
            if i >= CLOSE:
                gripper.grip_n = float(np.clip(control(frames, gripper.true_force), TOUCH_N, MOST_N))
            is_dropped |= gripper.slipped_m > DROPPED_M
            if film is not None and i >= CLOSE and i % 9 == 0:
                film.take(gripper, frames, f"{task.name}: grip {gripper.grip_n:.2f} N, breaks at {task.breaks_n:.2f} N")
    return Result(is_dropped, most >= task.breaks_n, most, task.breaks_n)


def near_breaking(results: list[Result]) -> str:
    """The largest force over the one that breaks."""
    return f"largest force {np.median([r.most_n / r.breaks_n for r in results]):.2f} of what breaks"


def main(arguments: Sequence[str] | None = None) -> None:
    goal = "egg shaken, bottle filled, ball tugged; neither dropped nor broken"
    compare(
        "egg_bottle_ball", __doc__, arguments, goal=goal, feedbacks=FEEDBACK, task=Task.of_seed, run=run,
        measure=near_breaking, film_seeds=range(len(KINDS)),
    )  # fmt: skip


if __name__ == "__main__":
    main()
