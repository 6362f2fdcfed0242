"""Squeeze a thing, judge its hardness, leave it if it is hard, and pick it up gently if it is soft.

python sort_by_hardness.py [--board BOARD] [--seeds N] [--film FILE.gif]

Simulated softness is a layer as thick as the pad: moduli alone share the travel. Of real things, shape does too.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from adaptive_grip import DROPPED_M, HEIGHT_M, ByFriction, by_perfect_force
from comparison import Outcome, compare
from egg_bottle_ball import APPROACH_N, MUCH_SLIP

from ruffini.boards import find_board
from ruffini.robot import Gripper, Thing
from ruffini.robot.core_sensor import NOISE_M
from ruffini.robot.film import Film

PRESS_N, BLIND_N = 1.2, 2.0
CLOSE, SQUEEZE, OPEN, LIFT, HOLD = 40, 50, 20, 80, 40  # frames
Press = tuple[float, float, float]  # force of a pad (N), travel of a finger and depth of a pad (m)
FROM_N = 0.3  # below it a press is not judged
ENCODER_M = 1e-5  # step of the fingers' encoders
SOFT_PA, HARD_PA, BOUND_PA = (4e4, 2.5e5), (5e5, 4e6), 3.5e5
BRUISES_N = 3.0  # at 100 kPa; with the root of the modulus, +-15 %
GENTLE = 0.75  # of the force that bruises


def bruises_n(modulus_pa: float) -> float:
    """The force that bruises a usual thing of a modulus."""
    return BRUISES_N * float(np.sqrt(modulus_pa / 1e5))


@dataclass(frozen=True)
class Task:
    """Unknown to the gripper."""

    thing: Thing
    bruises_n: float

    @classmethod
    def of_seed(cls, seed: int) -> "Task":
        rng = np.random.default_rng(seed)
        modulus = float(np.exp(rng.uniform(*np.log((SOFT_PA, HARD_PA)[seed % 2]))))
        size = float(rng.uniform(0.018, 0.03))
        kind, sizes = [("sphere", (size,)), ("cylinder", (size, 0.03))][int(rng.integers(2))]
        thing = Thing(kind, sizes, float(rng.uniform(0.05, 0.12)), float(rng.uniform(0.5, 0.9)), modulus)
        return cls(thing, bruises_n(modulus) * float(rng.uniform(0.85, 1.15)))


def by_depth(board: str, presses: list[Press]) -> float:
    """Ours: the modulus by the travel over the depth of the pads, as the stream's contacts have it."""
    _, travel, depth = np.array([press for press in presses if press[0] > FROM_N]).T
    share = float(np.polyfit(depth, travel, 1)[0]) - 1  # of the thing, over the pad's
    return find_board(board).pad.modulus_pa / max(share, 1e-3)


def stiffness(presses: list[Press]) -> float:
    """Force over travel."""
    force, travel, _ = np.array([press for press in presses if press[0] > FROM_N]).T
    return float(np.polyfit(travel, force, 1)[0])


@functools.cache
def taught(board: str) -> tuple[list[float], list[float]]:
    """The stiffness of usual balls of several moduli, and these."""
    moduli, stiff = [float(modulus) for modulus in np.geomspace(SOFT_PA[0], HARD_PA[1], 6)], []
    for modulus in moduli:
        with Gripper(board, Thing("sphere", (0.024,), 0.08, 0.7, modulus), is_feeling=False) as gripper:
            stiff.append(stiffness(squeeze(gripper)[0]))
    return stiff, moduli


def by_stiffness(board: str, presses: list[Press]) -> float:
    """A force sensor, even a perfect one, cannot distinguish hard from wide."""
    stiff, moduli = taught(board)
    return float(np.exp(np.interp(np.log(stiffness(presses)), np.log(stiff), np.log(moduli))))


FEEDBACK = {  # the judgement, and the control of the grip
    "stream": (by_depth, lambda: ByFriction(MUCH_SLIP)),
    "perfect force": (by_stiffness, lambda: by_perfect_force),
    "none": (lambda _, __: SOFT_PA[1], lambda: lambda _, __: BLIND_N),
}


@dataclass(frozen=True)
class Result(Outcome):
    FAILURES = ("is_missorted", "is_dropped", "is_bruised")

    is_missorted: bool
    is_dropped: bool
    is_bruised: bool
    modulus_off: float  # judged over true


def squeeze(gripper: Gripper, film: Film | None = None) -> tuple[list[Press], float]:
    """Close, and press harder; and the largest true force. Without frames the force is true, and there is no depth."""
    presses, most = [], 0.0
    for i in range(CLOSE + SQUEEZE):
        gripper.grip_n = APPROACH_N + (PRESS_N - APPROACH_N) * max(i - CLOSE, 0) / SQUEEZE
        frames = gripper.step()
        most = max(most, *(float(-force[2]) for force in gripper.true_force.values()))
        travel = ENCODER_M * round(float(gripper.world.data.joint("left").qpos[0]) / ENCODER_M)
        force = [-frame.wrench.force[2] for frame in frames.values()] or [-f[2] for f in gripper.true_force.values()]
        depth = [-contact.peak_depth for frame in frames.values() for contact in frame.contacts.contacts[:1]]
        presses.append((float(np.mean(force)), travel, float(np.mean(depth or 0))))
        if film is not None and i % 6 == 0:
            film.take(gripper, frames, f"squeezes with {gripper.grip_n:.2f} N")
    return presses, most


def run(feedback: str, task: Task, board: str, seed: int = 0, film: Film | None = None) -> Result:
    """One attempt."""
    judge, control = FEEDBACK[feedback][0], FEEDBACK[feedback][1]()
    with Gripper(board, task.thing, noise_m=NOISE_M, seed=seed, is_feeling=feedback == "stream") as gripper:
        presses, most = squeeze(gripper, film)
        modulus = judge(board, presses)
        is_soft, limit = modulus < BOUND_PA, GENTLE * bruises_n(modulus)
        said = f"{modulus / 1e3:.0f} kPa: " + (f"soft, at most {limit:.2f} N" if is_soft else "hard, is left")
        for i in range(LIFT + HOLD):
            gripper.lift_m = HEIGHT_M * float(np.clip((i if is_soft else i - OPEN) / LIFT, 0, 1))
            frames = gripper.step()
            most = max(most, *(float(-force[2]) for force in gripper.true_force.values()))
            gripper.grip_n = min(control(frames, gripper.true_force), limit) if is_soft else -APPROACH_N
            if film is not None and i % 6 == 0:
                film.take(gripper, frames, said)
        is_right, is_dropped = is_soft == (task.thing.modulus_pa < BOUND_PA), is_soft and gripper.slipped_m > DROPPED_M
        return Result(not is_right, is_dropped, most > task.bruises_n, modulus / task.thing.modulus_pa)


def error(results: list[Result]) -> str:
    """How far the judged modulus is off."""
    return f"modulus off by a factor of {np.exp(np.median([abs(np.log(r.modulus_off)) for r in results])):.2f}"


def main(arguments: Sequence[str] | None = None) -> None:
    goal = "hard ones left, soft ones picked up, neither dropped nor bruised"
    compare(
        "sort_by_hardness", __doc__, arguments, goal=goal, feedbacks=FEEDBACK, task=Task.of_seed, run=run,
        measure=error, film_seeds=(0, 1),
    )  # fmt: skip


if __name__ == "__main__":
    main()
