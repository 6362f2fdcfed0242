"""Checks of a camera on USB (usb_camera.py), through vhci-hcd and uvcvideo: by libcamera's pipeline of that name, and
by ruffinid's own V4L2."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from checks import run, until
from usb_camera import BARS, FULL_LEVEL, FULL_TIME, GAIN_1, NAMED
from virtual_board import ENVIRONMENT, daemon, main_process, new_pictures, port, ruffinid, serve, settings, settle

STATE = Path("/run/usb_camera.json")
# What the board vmusb asks for (prepare.py), in the camera's units: half of FULL_TIME, a gain of 1.5.
ASKED = {"exposure_mode": 1, "exposure": 50, "gain": 30, "white_auto": 0, "white_temperature": 5000}
LEVEL = FULL_LEVEL * ASKED["exposure"] / FULL_TIME * ASKED["gain"] / GAIN_1


def is_there() -> bool:
    drivers = Path("/sys/class/video4linux").glob("*/device/driver")
    return any(driver.resolve().name == "uvcvideo" for driver in drivers)


@contextlib.contextmanager
def plugged_in() -> Iterator[subprocess.Popen[str]]:
    """The camera on the kernel's controller, once udev has made its nodes; its end is its unplugging."""
    command = [sys.executable, "/vm/usb_camera.py", str(STATE)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as camera:
        try:
            until("the kernel has the camera", is_there)
            settle()
            yield camera
        finally:
            unplug(camera)


def unplug(camera: subprocess.Popen[str]) -> None:
    assert camera.stdin is not None
    camera.stdin.close()
    camera.wait(20)
    until("the camera's node is gone", lambda: not is_there())


def told() -> dict[str, Any]:
    """What the camera was told."""
    facts: dict[str, Any] = json.loads(STATE.read_text())
    return {name: facts[name] for name in ASKED}


def bars() -> int:
    """The brightest level of a new picture at the host; asserts that it is the bars at LEVEL."""
    (picture,) = new_pictures(1).values()
    levels = picture.mean(axis=0)[len(picture[0]) // 16 :: len(picture[0]) // 8, ::-1]
    wanted = [[LEVEL * part for part in bar] for bar in BARS]
    assert abs(levels - wanted).max() <= 3, levels
    return round(levels.max())


def colours_and_drift(name: str, no_gain: str) -> str:
    """What the host gets of the camera that ruffinid calls `name`; `no_gain` is how it refuses vmdazzled's gain."""
    from ruffini.device import Connection

    with plugged_in() as camera:
        assert camera.stdin is not None
        before = told()
        assert all(before[name] != asked for name, asked in ASKED.items()), before
        for board, what in (
            ("vmdazzled", no_gain),
            ("vmblue", "exposure.white_kelvin = 9000, only 2800 to 6500"),
        ):
            refused = run(*ruffinid(name, board=board), code=2)
            assert f"cannot be told {what}" in refused, refused
        with daemon(name, board="vmusb"):
            level = bars()
            assert told() == ASKED, told()
            with Connection(port()) as sensor:

                def invalid() -> int:
                    return int(sensor.status().drops.invalid_frame)

                drops = invalid()
                print("exposure 60", file=camera.stdin, flush=True)
                seconds = until("frames of another exposure are invalid", lambda: invalid() > drops + 3)
                print("exposure 50", file=camera.stdin, flush=True)
            assert bars() == level
    return f"{before}, then {told()}; level {level}; invalid {seconds:.1f} s after another exposure"


def unplugged_and_back(camera: str) -> str:
    """Of the service with --camera `camera`."""
    settings(ENVIRONMENT, CAMERA=camera)
    with plugged_in() as camera:
        serve("vmusb")
        bars()
        before = main_process()
        unplug(camera)
        gone = until("it is told", lambda: "was unplugged" in run("journalctl", "-b", "-u", "ruffinid", "--no-pager"))
        ended = until("it has ended", lambda: main_process() != before, 60)
    with plugged_in():
        state = ("systemctl", "is-active", "ruffinid")
        again = until("the service is up again", lambda: run(*state, code=None).strip() == "active", 120)
        bars()
        assert told() == ASKED, told()
        run("systemctl", "stop", "ruffinid")
    settings(ENVIRONMENT, CAMERA="libcamera:VirtualRest")
    return f"told after {gone:.1f} s, ended after {ended:.1f} s more, up {again:.1f} s after it was plugged in"


def usb_camera() -> str:
    """Camera on USB (UVC): the host gets its colours; exposure, gain, white arrive in it; one that drifts is told"""
    for module in ("vhci-hcd", "uvcvideo"):
        run("modprobe", module)
    run("insmod", "/vm/usb_bench.ko")
    return colours_and_drift(NAMED, "AnalogueGain 8.0")


def usb_camera_by_v4l2() -> str:
    """The same camera without libcamera (--camera v4l2:): colours, exposure, gain, white, drift; busy is told"""
    with plugged_in(), daemon(f"v4l2:{NAMED}", board="vmusb"):
        busy = run(*ruffinid(f"v4l2:{NAMED}", board="vmusb"), code=3)
    assert "is used by another program" in busy, busy
    return colours_and_drift(f"v4l2:{NAMED}", "exposure.gain_1e3 = 8000")


def usb_camera_unplugged() -> str:
    """Camera on USB, service: unplugged while it streams, told; plugged in again, it goes on as it was"""
    return unplugged_and_back(f"libcamera:{NAMED}")


def usb_camera_unplugged_by_v4l2() -> str:
    """The same camera without libcamera, service: unplugged while it streams, told; plugged in again, it goes on"""
    return unplugged_and_back(f"v4l2:{NAMED}")
