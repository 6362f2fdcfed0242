"""A person's fingers push the last link of an arm to two places, and it follows the force that its pads feel.

python hand_guidance.py [--board BOARD] [--seeds N] [--film FILE.gif]

Two flat pads on the link's sides stand for the paper's tube, which the reduced pads do not have: the link follows
pushes on them and drags along them, and none from elsewhere.
"""

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
OUT = {"left": -1.0, "right": 1.0}  # x of the pad's z; its x is up
REST, PUSH, RELEASE = 20, 110, 30  # frames; each finger pushes, and then lets go
DRAG_NS_M, DEAD_N, FOLLOW = 40.0, 0.15, 0.15  # of the link, as it feels; and how fast it follows, of each frame
PERSON_N_M, BACK_N, STOPS_M = 300.0, 1.0, 1e-3  # the person's arm
TOUCH_M, TOUCH_N, AWAY_M = 0.0325, 0.4, 0.036  # from the link's middle; until it touches, a finger is gentle
NEAR_M, STAYS_M, TIRES_N = 4e-3, 1e-3, 8.0


@dataclass(frozen=True)
class Person:
    """Unknown to the arm: where each finger moves the link, along x and z, and how strongly it pushes."""

    way_m: dict[str, np.ndarray]
    push_n: dict[str, float]
    friction: float = 0.8

    @classmethod
    def of_seed(cls, seed: int) -> "Person":
        rng, way, push = np.random.default_rng(seed), {}, {}
        for name, out in OUT.items():
            angle = rng.uniform(-0.35, 0.35)
            way[name] = rng.uniform(0.02, 0.04) * np.array([-out * np.cos(angle), np.sin(angle)])
            push[name] = float(rng.uniform(1.5, 3.5))
        return cls(way, push, float(rng.uniform(0.6, 1.0)))


class ByWrench:
    """Ours: the force of both pads, less what it was at rest. The control code is that of the hardware."""

    def __init__(self) -> None:
        self.at_rest: dict[str, list[np.ndarray]] = {name: [] for name in OUT}

    def __call__(self, frames: dict, _: dict) -> dict[str, np.ndarray]:
        force = {}
        for name, frame in frames.items():
            if not frame.is_valid:
                return dict.fromkeys(frames, np.zeros(3))  # nothing is known: stay
            if len(self.at_rest[name]) < REST // 2:
                self.at_rest[name].append(frame.wrench.force)
            force[name] = frame.wrench.force - np.mean(self.at_rest[name], axis=0)
        return force


FEEDBACK = {"wrench": ByWrench, "perfect force": lambda: lambda _, true: true, "none": lambda: lambda _, __: {}}


@dataclass
class Result(Outcome):
    FAILURES = ("is_not_there", "is_drifting", "is_tiring")

    off_m: list[float] = field(default_factory=list)  # from the wanted place, after each push
    drift_m: float = 0.0  # after the fingers let go
    most_n: float = 0.0  # true, on a finger

    @property
    def is_not_there(self) -> bool:
        return max(self.off_m) > NEAR_M

    @property
    def is_drifting(self) -> bool:
        return self.drift_m > STAYS_M

    @property
    def is_tiring(self) -> bool:
        return self.most_n > TIRES_N


def run(feedback: str, person: Person, board: str, seed: int = 0, film: Film | None = None) -> Result:
    """One attempt."""
    feel, result, velocity, line = FEEDBACK[feedback](), Result(), np.zeros(2), []
    model = mujoco.MjModel.from_xml_path(str(SCENE))
    model.geom_friction[:, 0] = person.friction
    with World(model, dict.fromkeys(OUT, board), noise_m=NOISE_M, seed=seed, is_feeling=feedback == "wrench") as world:
        link, goal, last = world.data.body("link"), np.array([0.0, 0.06]), np.zeros(2)
        for i in range(REST + len(OUT) * (PUSH + RELEASE)):
            turn, since = divmod(i - REST, PUSH + RELEASE)
            place = link.xpos[[0, 2]].copy()
            for k, (name, out) in enumerate(OUT.items()):
                finger = world.data.body(f"{name}_finger")
                finger.xfrc_applied[:] = 0
                if k == turn and since == 0:
                    goal = place + person.way_m[name]
                if k == turn and since < PUSH:
                    way = goal - place
                    size = min(person.push_n[name], PERSON_N_M * max(float(np.linalg.norm(way)) - STOPS_M, 0))
                    if out * (finger.xpos[0] - place[0]) > TOUCH_M:
                        size = TOUCH_N
                    finger.xfrc_applied[[0, 2]] = size * way / max(float(np.linalg.norm(way)), 1e-9)
                elif i >= REST and out * (finger.xpos[0] - place[0]) < AWAY_M:
                    finger.xfrc_applied[0] = out * BACK_N
            world.data.actuator("x").ctrl[0], world.data.actuator("z").ctrl[0] = velocity
            frames = world.step()
            true = {name: pad.wrench[:3].copy() for name, pad in world.pads.items()}
            result.most_n = max(result.most_n, *(float(np.linalg.norm(force)) for force in true.values()))
            felt = feel(frames, true)
            force = sum((np.array([OUT[name] * f[2], f[0]]) for name, f in felt.items()), np.zeros(2))
            size = float(np.linalg.norm(force))
            wanted = force / DRAG_NS_M * max(size - DEAD_N, 0) / max(size, 1e-9) if i >= REST else np.zeros(2)
            velocity += FOLLOW * (wanted - velocity)
            now = link.xpos[[0, 2]].copy()
            if i >= REST and since == PUSH - 1:
                result.off_m.append(float(np.linalg.norm(now - goal)))
            if since == PUSH + RELEASE // 2:
                last = now
            if since == PUSH + RELEASE - 1 and i >= REST:
                result.drift_m = max(result.drift_m, float(np.linalg.norm(now - last)))
            line.append(link.xpos.copy())
            if film is not None and i % 6 == 0:
                film.take(world, frames, f"the link feels {size:.2f} N", np.array(line))
    return result


def accuracy(results: list[Result]) -> str:
    """How far from the wanted places."""
    off_mm, most_n = 1e3 * np.median([max(r.off_m) for r in results]), np.median([r.most_n for r in results])
    return f"{off_mm:.1f} mm off, largest force {most_n:.1f} N"


def main(arguments: Sequence[str] | None = None) -> None:
    goal = f"the link within {1e3 * NEAR_M:.0f} mm of both places, still when let go, force under {TIRES_N:.0f} N"
    compare(
        "hand_guidance", __doc__, arguments, goal=goal, feedbacks=FEEDBACK, task=Person.of_seed, run=run,
        measure=accuracy, film=Film((-0.1, 0.1, -0.01, 0.16), full_n=0.06),
    )  # fmt: skip


if __name__ == "__main__":
    main()
