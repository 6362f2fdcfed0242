"""Frames a second of a gripper with two pads, beside the physics alone. SIMULATED.

python tests/bench/robot.py [--board BOARD] [--frames N] [--calibration out/run/calibration.safetensors]

Fast mode: processor time of one core, and environments side by side by the clock. Full mode: pictures, two daemons and
two clients by the clock, and the processor time that all of it takes, with the board's camera and with one of 30 frames
a second; without --calibration depth is not measured.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import mujoco
import numpy as np

import ruffini
from ruffini.boards import Board, find_board
from ruffini.device import Connection
from ruffini.robot import Gripper, Thing
from ruffini.robot.core_sensor import default_calibration
from ruffini.robot.environment import NAME
from ruffini.robot.gripper import gripper_mjcf
from ruffini.robot.live import Live

GRIP_N = 2.0
SETTLE = 30  # frames until it is gripped
FULL_FRAMES, FULL_HZ = 300, 30
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


def at_rate(board: str, rate_hz: int, folder: Path) -> Board:
    """The board with a camera of another rate."""
    own = find_board(board).folder
    assert own is not None
    copy = Path(shutil.copytree(own, folder / own.name))
    text = (copy / "board.toml").read_text()
    (copy / "board.toml").write_text(re.sub(r"^rate_mhz = \d+", f"rate_mhz = {1000 * rate_hz}", text, flags=re.M))
    return find_board(copy)


def full(board: Board, n: int, calibration: Path | None) -> tuple[float, float, float, float]:
    """Frames a second that the slower client got, of the world and of the camera; processor seconds a frame."""
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
            counts = [0] * len(streams)
            for _ in range(n):
                live.step()
                for i, stream in enumerate(streams):
                    while stream.get(0.0) is not None:
                        counts[i] += 1
            took_s, cpu_s = time.monotonic() - start_s, processor_s(pids) - start_cpu_s
            return min(counts) / took_s, n / took_s, 1 / gripper.frame_s, cpu_s / n


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
    print("pictures and daemons:")
    with tempfile.TemporaryDirectory() as folder:
        for board in (find_board(chosen.board), at_rate(chosen.board, FULL_HZ, Path(folder))):
            rate, world, wanted, cpu_s = full(board, FULL_FRAMES, chosen.calibration)
            print(f"  camera of {wanted:g} frames/s {rate:7.1f} frames/s by the clock, the world at "
                  f"{world / wanted:.2f} of real time, {1e3 * cpu_s:.0f} ms of processor time a frame")  # fmt: skip


if __name__ == "__main__":
    main()
