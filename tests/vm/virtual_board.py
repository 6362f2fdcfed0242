"""The virtual board as its checks see it: lines, chips on the bus, the daemon, the host."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from checks import content, run, tool, until

ENVIRONMENT = Path("/etc/ruffini/ruffinid.env")
GADGET = Path("/sys/kernel/config/usb_gadget/ruffini")
I2C = Path("/sys/module/i2c_bench/parameters")
LAMPS, TOUCH = 3, 5  # lines
WATCHDOG_S = 8
DRIVER, THERMOMETER = 0x15, 0x48  # chips on the bus
IREF, LED_OUT = 0x18, 0x02  # registers of the lamps' driver
GEL = ["--bus", "/dev/i2c-0", "--address", "0x51", "--address-bytes", "2"]
LOG = Path("/run/ruffinid.log")


def udc() -> str:
    return os.listdir("/sys/class/udc")[0]


def line(n: int) -> str:
    """Level of a line of the simulated chip, as a wire on it would see it."""
    (value,) = Path("/sys/devices/platform").glob(f"gpio-sim.*/gpiochip*/sim_gpio{n}/value")
    return content(value)


def lamps() -> str:
    return line(LAMPS)


def settle() -> None:
    run("udevadm", "settle", "--timeout=20")


def port() -> str:
    """The sensor's port on the host's side, by its link."""
    return str(Path("/dev/ruffini/VM-0001").resolve())


def on_bus(address: int, *out: int, n: int = 0) -> list[int]:
    """What the chip at an address answers, or nothing: another master of the bus, beside ruffinid."""
    from smbus2 import SMBus, i2c_msg

    answer = i2c_msg.read(address, n)
    with SMBus("/dev/i2c-0") as bus:
        bus.i2c_rdwr(i2c_msg.write(address, out), *([answer] if n else []))
    return list(answer)


def warm_to(celsius: float) -> None:
    """A TMP102 as its driver sets it: 13 bits, the last of them 1/16 degree, in the upper ones of 16."""
    on_bus(THERMOMETER, 0, *int(celsius * 128).to_bytes(2, "big"))


def ruffinid(*cameras: str, board: str = "vmpad") -> list[str]:
    named = [camera if camera.startswith("v4l2:") else f"libcamera:{camera}" for camera in cameras]
    given = [word for camera in named for word in ("--camera", camera)]
    return ["ruffinid", "--board", f"/vm/{board}", *given, "--link", "/dev/ttyGS0",
            "--serial", "VM-0001", "--store", "/run/store"]  # fmt: skip


@contextlib.contextmanager
def daemon(*cameras: str, board: str = "vmpad") -> Iterator[subprocess.Popen[bytes]]:
    """ruffinid, not under systemd, once it has opened its line; LOG is what it says."""
    command = ruffinid(*(cameras or ("VirtualRest",)), board=board)
    with LOG.open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as process:
        try:
            until("ruffinid has opened its line", lambda: "link: " in LOG.read_text() or process.poll() is not None, 60)
            assert process.poll() is None, LOG.read_text()
            yield process
        finally:
            process.terminate()
            process.wait(20)


def ruffini(*words: str) -> str:
    return tool("--port", port(), "--quiet", *words)


def new_pictures(n: int) -> dict[int, Any]:
    """What the host gets of a camera, by number of the frame, (height, width, 3), B G R."""
    from ruffini.device import Connection
    from ruffini.device.results import RESULTS

    got: dict[int, Any] = {}
    with Connection(port()) as sensor:
        sensor.subscribe(image=1)
        for frame, message in sensor.stream(timeout_s=30):
            if sensor.schema.type_name(frame.type) == "IMAGE":
                assert not got or message.stamp.frame > max(got), (message.stamp.frame, list(got))
                got[message.stamp.frame] = RESULTS["IMAGE"].from_message(message).pixels
            if len(got) == n:
                break
        sensor.subscribe()  # what nobody takes keeps the line from being closed: the gadget's driver waits 15 s for it
    return got


def pictures_and_wrenches() -> Iterator[tuple[Any, Any, bool]]:
    """Image, Wrench and whether they are marked as simulated, of each frame of which the host gets both."""
    from ruffini.device import Connection
    from ruffini.device.results import RESULTS

    with Connection(port()) as sensor:
        sensor.subscribe(image=1, wrench=1)
        last: dict[str, Any] = {}
        for frame, message in sensor.stream(timeout_s=30):
            name = sensor.schema.type_name(frame.type)
            if name not in ("IMAGE", "WRENCH"):
                continue
            last[name] = RESULTS[name].from_message(message)
            if len(last) == 2 and last["IMAGE"].frame == last["WRENCH"].frame:
                yield last["IMAGE"], last["WRENCH"], frame.is_simulated


def streamer_on_second_cpu() -> str:
    """vimc's thread that makes the pictures; nothing where there is none, as when the stream is just started again."""
    found = subprocess.run(["pgrep", "vimc-streamer"], capture_output=True, text=True, check=False).stdout.split()
    for thread in found:
        if subprocess.run(["taskset", "-p", "2", thread], capture_output=True, check=False).returncode == 0:
            return thread
    return ""


@contextlib.contextmanager
def starved() -> Iterator[str]:
    """vimc's thread shares the second CPU with what never lets go, and nothing keeps a part for it; its number."""
    tried: list[str] = []
    until("a thread of vimc", lambda: tried.append(streamer_on_second_cpu()) or bool(tried[-1]))
    limits = [Path("/proc/sys/kernel/sched_rt_runtime_us"), Path("/sys/kernel/debug/sched/fair_server/cpu1/runtime")]
    were = [limit.read_text() for limit in limits]
    for limit, value in zip(limits, ("-1", "0"), strict=True):
        limit.write_text(value)
    command = ["taskset", "2", "chrt", "-f", "99", "sh", "-c", "while :; do :; done"]
    with subprocess.Popen(command) as hog:
        try:
            yield tried[-1]
        finally:
            hog.kill()
            for limit, was in zip(limits, were, strict=True):
                limit.write_text(was)


def settings(path: Path, **changes: str) -> None:
    text = path.read_text()
    for name, value in changes.items():
        text = re.sub(f"^{name}=.*", f"{name}={value}", text, flags=re.M)
    path.write_text(text)


def allow_time(unit: str) -> None:
    """This computer is emulated: ten to twenty times slower than its host, and that has others to serve."""
    drop_in = Path(f"/run/systemd/system/{unit}.service.d/emulated.conf")
    if drop_in.exists():
        return
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(f"[Service]\nTimeoutStartSec=120\nTimeoutStopSec=60\nWatchdogSec={WATCHDOG_S}\n")
    run("systemctl", "daemon-reload")


def serve(board: str) -> float:
    """The service with this board; seconds until it says READY=1."""
    settings(ENVIRONMENT, BOARD=f"/vm/{board}")
    allow_time("ruffinid")
    start = time.monotonic()
    run("systemctl", "restart", "ruffinid", timeout=190)
    assert run("systemctl", "is-active", "ruffinid").strip() == "active"
    return time.monotonic() - start


def main_process() -> str:
    return run("systemctl", "show", "ruffinid", "-p", "MainPID", "--value").strip()


def restarted(process: str, signal: str) -> float:
    """Seconds from the signal to another process that has said READY=1."""
    start = time.monotonic()
    run("kill", f"-{signal}", process)
    until("another process", lambda: main_process() not in ("0", process), 60)
    until("active again", lambda: run("systemctl", "is-active", "ruffinid", code=None).strip() == "active", 120)
    return time.monotonic() - start
