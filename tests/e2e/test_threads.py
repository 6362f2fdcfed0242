"""[threads] of board.toml: where the real ruffinid's threads run, as the kernel says."""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
from pathlib import Path

import pytest
from hang import finished, until
from tiny_sensor import Sensor, start, write_board

from ruffini.boards import find_board
from ruffini.daemon import find_daemon
from ruffini.device import Connection

PR_CAPBSET_DROP, CAP_IPC_LOCK, CAP_SYS_NICE = 24, 14, 23  # linux/prctl.h, linux/capability.h


def asking(tmp_path: Path, sensor: Sensor, threads: str) -> Sensor:
    folder = write_board(tmp_path / "tiny", {})
    with (folder / "board.toml").open("a") as file:
        file.write(f"\n[threads]\n{threads}")
    return Sensor(find_board(folder), folder, sensor.recording, b"")


def threads_of(pid: int) -> dict[str, int]:
    """Thread ids by name; waits until all are named."""

    def named() -> dict[str, int]:
        tasks = Path(f"/proc/{pid}/task").iterdir()
        found = {(task / "comm").read_text().strip(): int(task.name) for task in tasks}
        return found if {"capture", "frame", "link"} <= found.keys() else {}

    return until(named, "the threads' names")


def may_be_real_time() -> bool:
    done = subprocess.run(["chrt", "-f", "10", "true"], capture_output=True, check=False)
    return done.returncode == 0


def test_each_thread_is_where_its_board_wants_it(sensor: Sensor, tmp_path: Path) -> None:
    cpus = sorted(os.sched_getaffinity(0))
    is_allowed = may_be_real_time()
    wanted = f"capture_cpus = [{cpus[-1]}]\nframe_cpus = [{cpus[0]}]\n"
    if is_allowed:
        wanted += "capture_priority = 12\nframe_priority = 11\n"
    with start(asking(tmp_path, sensor, wanted), tmp_path / "store", "--loop") as daemon:
        found = threads_of(daemon.process.pid)
        # Named first, placed then.
        until(lambda: os.sched_getaffinity(found["capture"]) == {cpus[-1]}, "the capture thread's place")
        until(lambda: os.sched_getaffinity(found["frame"]) == {cpus[0]}, "the frame thread's place")
        assert os.sched_getaffinity(found["link"]) == set(cpus)
        assert os.sched_getscheduler(found["link"]) == os.SCHED_OTHER
        told = (11 if is_allowed else 0, 1 << cpus[0] if (os.cpu_count() or 1) > 1 else 0, False)
        with Connection(daemon.port) as host:  # once the thread has looked where it is

            def is_told() -> bool:
                place = host.status().scheduling
                return (place.priority, place.cpus, place.is_memory_locked) == told

            until(is_told, "the frame thread's place in STATUS")
        if not is_allowed:
            pytest.skip("the kernel grants no real-time priority here: places alone were looked at")
        for role, priority in (("capture", 12), ("frame", 11)):
            until(lambda r=role: os.sched_getscheduler(found[r]) == os.SCHED_FIFO, f"the {role} thread's priority")
            assert os.sched_getparam(found[role]).sched_priority == priority


def test_what_cannot_be_had_is_said_and_the_sensor_runs(sensor: Sensor, tmp_path: Path) -> None:
    board = asking(tmp_path, sensor, "link_cpus = [63]\n")
    if 63 in os.sched_getaffinity(0):
        pytest.skip("a computer that has CPU 63")
    with start(board, tmp_path / "store", "--loop") as daemon:
        threads_of(daemon.process.pid)
        assert daemon.process.stderr is not None
        said = daemon.process.stderr.readline()
        assert said.startswith("ruffinid: thread link: CPU 63: this computer gives it ")
        assert "correct threads.link_cpus in board.toml" in said
        assert daemon.process.poll() is None


def no_real_time() -> None:
    """For the program that comes next: no limit that grants it, and no capability, not even root's."""
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE)


def test_the_doctor_tells_threads_with_the_remedy(sensor: Sensor, tmp_path: Path) -> None:
    cpu = max(os.sched_getaffinity(0))
    board = asking(tmp_path, sensor, f"frame_priority = 45\nframe_cpus = [{cpu}]\n")
    command = [
        str(find_daemon()), "--doctor", "--board", str(board.folder), "--camera", f"replay:{board.recording}",
        "--link", "pty", "--store", str(tmp_path),
    ]  # fmt: skip
    done = finished(command, preexec_fn=no_real_time)
    lines = done.stdout.splitlines()
    at = lines.index(f"warning  threads: frame ordinary on CPU {cpu}")
    assert (
        lines[at + 1].strip().startswith("thread frame: real-time priority 45 cannot be had (Operation not permitted)")
    )
    assert "LimitRTPRIO=45" in lines[at + 1]


def no_locked_memory() -> None:
    """For the program that comes next, as no_real_time."""
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_IPC_LOCK)


def test_memory_that_cannot_be_locked_is_said_and_the_sensor_runs(sensor: Sensor, tmp_path: Path) -> None:
    command = [
        str(find_daemon()), "--board", str(sensor.folder), "--camera", f"replay:{sensor.recording}",
        "--link", "pty", "--store", str(tmp_path), "--loop", "--lock-memory",
    ]  # fmt: skip
    pipe = subprocess.PIPE
    daemon = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, preexec_fn=no_locked_memory)
    try:
        assert daemon.stdout is not None
        assert daemon.stderr is not None
        with Connection(daemon.stdout.readline().removeprefix("link: ").strip()) as host:
            assert not host.status().scheduling.is_memory_locked
        assert daemon.stderr.readline().startswith("ruffinid: --lock-memory: not allowed")
    finally:
        daemon.kill()
        daemon.communicate()
