"""Frames a second of a gripper with two pads, beside the physics alone. SIMULATED; processor time, one core.

python tests/bench/robot.py [--board BOARD] [--frames N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import mujoco

from ruffini.robot import Gripper, Thing
from ruffini.robot.gripper import gripper_mjcf

GRIP_N = 2.0
SETTLE = 30  # frames until it is gripped


def per_second(work: Callable[[], object], n: int) -> float:
    """How often a second of this process."""
    start = time.process_time()
    for _ in range(n):
        work()
    return n / (time.process_time() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--frames", type=int, default=60)
    chosen = parser.parse_args()
    rates = {}
    for name, is_feeling in (("physics, pads and core", True), ("physics and pads", False)):
        with Gripper(chosen.board, Thing(), is_feeling=is_feeling) as gripper:
            gripper.grip_n = GRIP_N
            per_second(gripper.step, SETTLE)
            rates[name] = per_second(gripper.step, chosen.frames)
            n_steps = round(gripper.frame_s / gripper.world.model.opt.timestep)
    model = mujoco.MjModel.from_xml_string(gripper_mjcf(Thing()))
    data = mujoco.MjData(model)
    rates["physics alone"] = per_second(lambda: mujoco.mj_step(model, data, n_steps), chosen.frames)
    print(f"SIMULATED, two pads of {chosen.board}, {n_steps} steps of physics a frame, one core's processor time")
    for name, rate in rates.items():
        print(f"{name:24s} {rate:7.0f} frames/s, {rate * n_steps:8.0f} physics steps/s, "
              f"{rates['physics alone'] / rate:6.1f} times the physics alone")  # fmt: skip


if __name__ == "__main__":
    main()
