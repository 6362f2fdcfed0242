"""Frames a second of a gripper with two pads, beside the physics alone. SIMULATED.

python tests/bench/robot.py [--board BOARD] [--frames N] [--calibration out/run/calibration.safetensors]

Fast mode: processor time of one core, and environments side by side by the clock. Full mode: pictures, two daemons and
two clients by the clock, and the processor time that all of it takes; without --calibration depth is not measured.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import mujoco
import numpy as np

import ruffini
from ruffini.device import Connection
from ruffini.robot import Gripper, Thing
from ruffini.robot.core_sensor import default_calibration
from ruffini.robot.environment import NAME
from ruffini.robot.gripper import gripper_mjcf
from ruffini.robot.live import Live

GRIP_N = 2.0
SETTLE = 30  # frames until it is gripped
FIRST_S = 60.0  # so long a daemon may take for its first frame


def per_second(work: Callable[[], object], n: int, clock: Callable[[], float] = time.process_time) -> float:
    """How often a second of this process, or of another clock."""
    start = clock()
    for _ in range(n):
        work()
    return n / (clock() - start)


def fast(board: str, n: int) -> tuple[dict[str, float], int]:
    """Frames a second of one core; steps of physics a frame."""
    rates = {}
    for name, is_feeling in (("physics, pads and core", True), ("physics and pads", False)):
        with Gripper(board, Thing(), is_feeling=is_feeling) as gripper:
            gripper.grip_n = GRIP_N
            per_second(gripper.step, SETTLE)
            rates[name] = per_second(gripper.step, n)
            n_steps = round(gripper.frame_s / gripper.world.model.opt.timestep)
    model = mujoco.MjModel.from_xml_string(gripper_mjcf(Thing()))
    data = mujoco.MjData(model)
    rates["physics alone"] = per_second(lambda: mujoco.mj_step(model, data, n_steps), n)
    return rates, n_steps


def side_by_side(board: str, n: int, n_envs: int) -> float:
    """Frames a second of all environments together, each in a process of its own."""
    envs = gymnasium.make_vec(NAME, num_envs=n_envs, vectorization_mode="async", board=board)
    try:
        envs.reset(seed=1)
        grip = np.full((n_envs, 1), GRIP_N, np.float32)
        return n_envs * per_second(lambda: envs.step(grip), n, time.monotonic)
    finally:
        envs.close()


def processor_s(pids: list[int]) -> float:
    """Of this process and of the daemons and cameras."""
    ticks = 0
    for pid in (os.getpid(), *pids):
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def full(board: str, n: int, calibration: Path | None) -> tuple[float, float, float]:
    """Frames a second that the slower client got; processor seconds a frame of both pads; the camera's rate."""
    with Gripper(board, Thing(), is_feeling=False) as gripper, Live(gripper.world) as live:
        of_board = gripper.world.pads["left"].solid.unit.board
        data = calibration.read_bytes() if calibration else default_calibration(of_board)
        for port in live.ports.values():
            with Connection(port) as host:
                host.flash(data)
        with ruffini.connect(live.ports["left"]) as left, ruffini.connect(live.ports["right"]) as right:
            streams = [sensor.frames() for sensor in (left, right)]
            motors = gripper.world.data.actuator
            motors("left").ctrl[0] = motors("right").ctrl[0] = GRIP_N
            for stream in streams:
                stream.get(FIRST_S)
            for _ in range(SETTLE):
                live.step()
            for stream in streams:
                while stream.get(0.0) is not None:
                    pass
            pids = [process.pid for process in (*live.daemons.values(), *live.cameras.values())]
            start_s, start_cpu_s = time.monotonic(), processor_s(pids)
            for _ in range(n):
                live.step()
            took_s, cpu_s = time.monotonic() - start_s, processor_s(pids) - start_cpu_s
            counts = []
            for stream in streams:
                counts.append(0)
                while stream.get(0.0) is not None:
                    counts[-1] += 1
            return min(counts) / took_s, cpu_s / n, 1 / gripper.frame_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--calibration", type=Path, default=None)
    chosen = parser.parse_args()
    rates, n_steps = fast(chosen.board, chosen.frames)
    print(f"SIMULATED, two pads of {chosen.board}, {n_steps} steps of physics a frame, one core's processor time")
    for name, rate in rates.items():
        print(f"{name:24s} {rate:7.0f} frames/s, {rate * n_steps:8.0f} physics steps/s, "
              f"{rates['physics alone'] / rate:6.1f} times the physics alone")  # fmt: skip
    for n_envs in (1, os.cpu_count() or 1):
        rate = side_by_side(chosen.board, chosen.frames, n_envs)
        print(
            f"{n_envs} environments          {rate:7.0f} frames/s, {rate * n_steps:8.0f} physics steps/s by the clock"
        )
    rate, cpu_s, wanted = full(chosen.board, chosen.frames, chosen.calibration)
    print(f"pictures and daemons     {rate:7.1f} frames/s by the clock, of {wanted:g}; {1e3 * cpu_s:.0f} ms of "
          f"processor time a frame, {cpu_s * wanted:.2f} cores")  # fmt: skip


if __name__ == "__main__":
    main()
