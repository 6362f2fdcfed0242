"""Draw a line on paper of unknown height and slope with a light, even force, felt by the wrenches of two pads.

python pen_stroke.py [--board BOARD] [--seeds N] [--film FILE.gif]
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from comparison import Outcome, compare

from ruffini.robot import World
from ruffini.robot.core_sensor import NOISE_M
from ruffini.robot.film import Film

SCENE = Path(__file__).with_suffix(".xml")
TIP_M = 0.002
GRIP_N, WANTED_N, FELT_N = 6.0, 0.5, 0.2
DRAWS_N, TEARS_N = 0.1, 1.2  # the pen leaves a line above the one, and tears the paper above the other
AIR, FALL, SETTLE, STROKE, RAMP = 40, 120, 40, 150, 20  # frames; the fall ends when the paper is felt
SPEED_M, FALL_M = 4e-4, 1.5e-4  # a frame
GAIN, INTEGRAL = 2e-4, 1e-5  # metres a newton, and each frame as many more
WHOLE = 0.95  # share of the stroke that is drawn
VIEW_M = (-0.06, 0.06, -0.025, 0.085)  # x and z of the film


@dataclass(frozen=True)
class Paper:
    """What nobody tells the arm."""

    height_m: float = 0.0
    slope_rad: float = 0.0
    friction: float = 0.3

    @classmethod
    def of_seed(cls, seed: int) -> "Paper":
        rng = np.random.default_rng(seed)
        return cls(float(rng.uniform(-3e-3, 3e-3)), float(rng.uniform(-0.12, 0.12)), float(rng.uniform(0.15, 0.4)))

    def model(self) -> mujoco.MjModel:
        """The scene with this paper on the table."""
        scene = mujoco.MjSpec.from_file(str(SCENE))
        table = scene.geom("table")
        table.pos[2] += self.height_m
        table.quat = [np.cos(self.slope_rad / 2), 0, np.sin(self.slope_rad / 2), 0]
        scene.pairs[0].friction[:2] = [self.friction] * 2
        return scene.compile()


class ByWrench:
    """Ours: both pads' force along the pen less what it was in the air. The control code is that of the hardware."""

    def __init__(self) -> None:
        self.in_air: list[float] = []
        self.tip_n = 0.0

    def __call__(self, frames: dict, _: float) -> float:
        if all(frame.is_valid for frame in frames.values()):  # else the last force stays
            upward = sum(float(frame.wrench.force[1]) for frame in frames.values())
            if len(self.in_air) < AIR // 2:
                self.in_air.append(upward)
            self.tip_n = upward - float(np.mean(self.in_air))
        return self.tip_n


FEEDBACK = {"wrench": ByWrench, "perfect force": lambda: lambda _, n: n, "none": lambda: lambda _, __: WANTED_N}


@dataclass
class Result(Outcome):
    FAILURES = ("is_not_whole", "is_torn")

    most_n: float = 0.0  # the tip's largest true force, from the first touch
    tip_n: list[float] = field(default_factory=list)  # true, in each frame of the stroke
    down_m: float = 0.0  # at the end

    @property
    def drawn(self) -> float:
        return sum(force > DRAWS_N for force in self.tip_n) / STROKE

    @property
    def is_not_whole(self) -> bool:
        return self.drawn < WHOLE

    @property
    def is_torn(self) -> bool:
        return self.most_n > TEARS_N


@functools.cache
def taught_m(board: str) -> float:
    """How far down the pen draws on flat paper at height zero."""
    return run("perfect force", Paper(), board).down_m


def run(feedback: str, paper: Paper, board: str, seed: int = 0, film: Film | None = None) -> Result:
    """One attempt."""
    feel, result, speed_m, n_down, line = FEEDBACK[feedback](), Result(), 0.0, 0, []
    lowest_m = taught_m(board) if feedback == "none" else FALL * FALL_M
    pads = {"left": board, "right": board}
    with World(paper.model(), pads, noise_m=NOISE_M, seed=seed, is_feeling=feedback == "wrench") as world:
        move = {"along": 0.0, "down": 0.0}  # metres a frame
        for i in range(AIR + FALL + SETTLE + STROKE):
            for name in move:
                world.data.actuator(name).ctrl[0] = move[name] / world.frame_s
            for name in pads:
                world.data.actuator(name).ctrl[0] = GRIP_N
            frames = world.step()
            result.down_m += move["down"]
            true_n = float(world.data.sensor("tip").data[0])
            result.most_n = max(result.most_n, true_n)
            felt_n = feel(frames, true_n) if i >= AIR // 2 else 0.0  # then the grip is firm
            line.append(world.data.site("tip").xpos - [0, 0, TIP_M] if true_n > DRAWS_N else np.full(3, np.nan))
            if film is not None and i % 4 == 0 and i >= AIR:
                film.take(world, frames, f"tip {felt_n:.2f} N felt, {true_n:.2f} N true", np.array(line))
            is_down = felt_n > FELT_N if feedback != "none" else result.down_m > lowest_m - 1e-9
            if n_down == 0 and (i < AIR or not is_down):
                move["down"] = min(FALL_M, lowest_m - result.down_m) if i >= AIR else 0.0
                continue
            n_down += 1
            if n_down > SETTLE + 1:
                result.tip_n.append(true_n)
            if len(result.tip_n) == STROKE:
                break
            speed_m += INTEGRAL * (WANTED_N - felt_n)  # the slope that is learned
            forward_m = SPEED_M * float(np.clip((n_down - SETTLE) / RAMP, 0, 1))
            move = {"along": forward_m, "down": GAIN * (WANTED_N - felt_n) + speed_m}
    return result


def evenness(results: list[Result]) -> str:
    """How far the force is from the wanted one."""
    wrong = np.median([np.sqrt(np.mean((np.array(r.tip_n or [0.0]) - WANTED_N) ** 2)) for r in results])
    return f"{wrong:.3f} N rms from the wanted {WANTED_N} N"


def main(arguments: Sequence[str] | None = None) -> None:
    goal = f"{100 * WHOLE:.0f} % of the stroke drawn, paper not torn"
    compare(
        "pen_stroke", __doc__, arguments, goal=goal, feedbacks=FEEDBACK, task=Paper.of_seed, run=run, measure=evenness,
        film=Film(VIEW_M, full_n=0.08),
    )  # fmt: skip


if __name__ == "__main__":
    main()
