"""Runs inside the virtual board, once systemd is up: real GPIO, I2C, USB and camera interfaces of the kernel.

Writes /vm/result.json: what was looked at, how long it took, and what went wrong. `make vm` starts it.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import json
import os
import re
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ENVIRONMENT = Path("/etc/ruffini/ruffinid.env")
GADGET = Path("/sys/kernel/config/usb_gadget/ruffini")
I2C = Path("/sys/module/i2c_bench/parameters")
LAMPS, TOUCH = 3, 5  # lines
WATCHDOG_S = 8
GEL = ["--bus", "/dev/i2c-0", "--address", "0x51", "--address-bytes", "2"]
RESULT, LOG = Path("/vm/result.json"), Path("/run/ruffinid.log")
checks: list[Callable[[], str]] = []


def check(function: Callable[[], str]) -> Callable[[], str]:
    checks.append(function)
    return function


def run(*command: str, code: int | None = 0, timeout: float = 60) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    assert code is None or done.returncode == code, (
        f"{' '.join(command)}: exit code {done.returncode}\n{done.stdout}{done.stderr}"
    )
    return done.stdout + done.stderr


def until(what: str, is_so: Callable[[], object], seconds: float = 30) -> float:
    """Seconds until it is so."""
    start = time.monotonic()
    while not is_so():
        assert time.monotonic() - start < seconds, f"not after {seconds:g} s: {what}"
        time.sleep(0.05)
    return time.monotonic() - start


def content(path: Path | str) -> str:
    return Path(path).read_text().strip()


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


def ruffinid(camera: str) -> list[str]:
    return ["ruffinid", "--board", "/vm/vmpad", "--camera", f"libcamera:{camera}", "--link", "/dev/ttyGS0",
            "--serial", "VM-0001", "--store", "/run/store"]  # fmt: skip


@contextlib.contextmanager
def daemon(camera: str = "VirtualDots") -> Iterator[subprocess.Popen[bytes]]:
    """ruffinid, not under systemd, once it has opened its line; LOG is what it says."""
    with LOG.open("w") as log, subprocess.Popen(ruffinid(camera), stdout=log, stderr=log) as process:
        try:
            until("ruffinid has opened its line", lambda: "link: " in LOG.read_text(), 60)
            yield process
        finally:
            process.terminate()
            process.wait(20)


@functools.cache
def commands() -> Any:
    from typer.main import get_command

    from ruffini.cli.app import app

    return get_command(app)


def tool(*words: str, code: int | None = 0) -> str:
    """The host tool, in this process: to start it takes ten seconds on this emulated computer."""
    from ruffini.errors import RuffiniError

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            got = commands().main(list(words), prog_name="ruffini", standalone_mode=False) or 0
        except RuffiniError as error:
            print(f"ruffini: {error}")
            got = error.exit_code
    assert code is None or got == code, f"ruffini {' '.join(words)}: exit code {got}\n{said.getvalue()}"
    return said.getvalue()


def ruffini(*words: str) -> str:
    return tool("--port", port(), "--quiet", *words)


@check
def gadget_up() -> str:
    """USB gadget: described to the kernel, up again writes nothing, host sees texts and link by serial number"""
    planned = run("/usr/lib/ruffini/ruffini-gadget", "up", "--dry-run")
    assert not GADGET.exists()
    assert f"echo '{udc()}' > {GADGET}/UDC" in planned
    run("/usr/lib/ruffini/ruffini-gadget", "up")
    before = content(GADGET / "UDC")
    run("/usr/lib/ruffini/ruffini-gadget", "up")
    assert content(GADGET / "UDC") == before == udc()
    assert run("/usr/lib/ruffini/ruffini-gadget", "up", "--dry-run") == ""
    until("/dev/ruffini/VM-0001", Path("/dev/ruffini/VM-0001").exists)
    settle()
    found = run("udevadm", "info", "--query=all", "--name", port())
    assert "ID_MM_PORT_IGNORE=1" in found, found
    assert "uaccess" in found, found
    usb = run(
        "udevadm", "info", "--query=all", "--path", str(Path(f"/sys/class/tty/{Path(port()).name}/device/..").resolve())
    )
    assert "ID_MM_DEVICE_IGNORE=1" in usb, usb
    assert "ID_MM_PORT_IGNORE=1" in run("udevadm", "info", "--query=all", "--name", "/dev/ttyGS0")
    return f"{port()}, {before}"


@check
def gadget_conflict() -> str:
    """USB gadget: another one that has the port is named with the remedy, and freed by it"""
    run("/usr/lib/ruffini/ruffini-gadget", "down")
    other = GADGET.with_name("other")
    for folder in (other, other / "configs/c.1", other / "functions/acm.x"):
        folder.mkdir()
    (other / "configs/c.1/acm.x").symlink_to(other / "functions/acm.x")
    (other / "UDC").write_text(udc())
    said = run("/usr/lib/ruffini/ruffini-gadget", "up", code=4)
    assert f"the gadget {other} has {udc()}" in said, said
    run("sh", "-c", said.split("free it with: ")[1])
    (other / "configs/c.1/acm.x").unlink()
    for folder in (other / "configs/c.1", other / "functions/acm.x", other):
        folder.rmdir()
    run("/usr/lib/ruffini/ruffini-gadget", "up")
    until("/dev/ruffini/VM-0001", Path("/dev/ruffini/VM-0001").exists)
    return said.strip().removeprefix("ruffini-gadget: ")


@check
def camera() -> str:
    """Camera: the capture code on libcamera's virtual pipeline, frames in memory of a DMA heap or udmabuf"""
    printed = run("/vm/ruffini_capture_tests", "--gtest_filter=Libcamera*:Pixels*", timeout=200)
    passed = re.search(r"\[  PASSED  \] (\d+) tests", printed)
    assert passed, printed
    assert "SKIPPED" not in printed, printed
    return f"{passed[1]} tests"


@check
def gel_eeprom() -> str:
    """I2C: the gel's EEPROM over i2c-dev; nobody at an address, a bus that fails, one that hangs"""
    tool("board", "eeprom", "write", *GEL, "--serial", "G-1", "--name", "soft")
    assert "G-1" in tool("board", "eeprom", "read", *GEL)
    assert "does not answer" in tool("board", "eeprom", "read", "--bus", "/dev/i2c-0", "--address", "0x53", code=3)
    for error, n in (("5", 2), ("110", 2)):
        (I2C / "error").write_text(error)
        (I2C / "fail").write_text(str(n))
        assert "G-1" in tool("board", "eeprom", "read", *GEL)
    (I2C / "error").write_text("5")
    (I2C / "fail").write_text("3")
    assert "Input/output error" in tool("board", "eeprom", "read", *GEL, code=3)
    return "serial G-1"


@check
def stream() -> str:
    """The whole way: camera to host tool over ttyGS0 and ttyACM0; a calibration flashed, the lamps' line on"""
    from ruffini.device import Connection
    from ruffini.device.results import VALID

    start = time.monotonic()
    with daemon():
        assert lamps() == "1"
        facts = json.loads(ruffini("info", "--json"))
        answered = time.monotonic() - start
        assert facts["serial"] == "VM-0001"
        flash_started = time.monotonic()
        with Connection(port()) as sensor:
            sensor.flash(Path("/vm/calibration.safetensors").read_bytes())
        flashed = time.monotonic() - flash_started
        assert json.loads(ruffini("info", "--json"))["sensors"][0]["calibration"]["present"]
        lines = ruffini("monitor", "--n", "40", "--json").strip().splitlines()
        assert len(lines) == 40, lines
        n_valid = sum(json.loads(text)["validity"][2] == VALID for text in lines)
        assert n_valid > 0, lines[-1]
        assert Path("/run/store/gel-G-1").is_dir()
    until("lamps off", lambda: lamps() == "0")
    return (
        f"first answer to the host tool {answered:.1f} s after the start of ruffinid; flashed in {flashed:.1f} s; "
        f"{n_valid} of 40 frames with a force"
    )


@check
def reflex_line() -> str:
    """GPIO: the reflex line goes on while pictures of a press come and off after them, as a wire sees it"""
    with daemon("VirtualPress"):
        assert lamps() == "1"
        off = until("off while nothing is touched", lambda: line(TOUCH) == "0")
        on = until("on while pressed", lambda: line(TOUCH) == "1", 60)
        again = until("off again", lambda: line(TOUCH) == "0", 60)
        info = run("gpioinfo", "-c", "gpiochip0")
        assert re.search(r"TOUCH.*output.*consumer=\"?ruffinid", info), info
    return f"off {off:.1f} s, on after {on:.1f} s, off after {again:.1f} s more"


@check
def slow_reader() -> str:
    """A reader that lags loses telemetry, no frame of it is taken for whole, and the line answers again"""
    from ruffini.device import Connection
    from ruffini.errors import NoDeviceError

    types = ("wrench", "field", "contacts", "depth", "markers")
    with daemon(), Connection(port()) as sensor:
        sensor.subscribe(**dict.fromkeys(types, 1))
        time.sleep(6)
        stamps = [m.stamp.frame for _, m in itertools.islice(sensor.stream(timeout_s=20), 100) if hasattr(m, "stamp")]

        def answers() -> bool:
            try:
                sensor.subscribe(**dict.fromkeys(types, 0) | {"wrench": 1})
            except NoDeviceError:
                return False
            return True

        seconds = until("the sensor answers", answers, 60)
        counters = sensor.decoder.counters
        assert counters.malformed == counters.oversize == 0, counters
        missing = max(stamps) - min(stamps) + 1 - len(set(stamps))
        assert missing > 0, "nothing was lost: the reader did not lag"
    return f"{missing} of {max(stamps) - min(stamps) + 1} frames lost; an answer after {seconds:.1f} s; {counters}"


@check
def unplug() -> str:
    """Unplugged and plugged in again while a host has the port open: another name, the same link, the stream goes on"""
    with (
        daemon(),
        subprocess.Popen(
            ["ruffini", "--serial", "VM-0001", "monitor", "--json", "--resume", "60"], stdout=subprocess.PIPE, text=True
        ) as host,
    ):
        assert host.stdout is not None
        for _ in range(5):
            assert host.stdout.readline()
        before = port()
        # An open file keeps the old name busy.
        held = os.open(before, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
        (GADGET / "UDC").write_text("\n")
        until("the port is gone", lambda: not Path(before).exists())
        (GADGET / "UDC").write_text(udc())
        until("the link is back", Path("/dev/ruffini/VM-0001").exists)
        after = port()
        start = time.monotonic()
        for _ in range(5):
            assert host.stdout.readline()
        seconds = time.monotonic() - start
        os.close(held)
        host.kill()
    assert after != before
    return f"{before}, then {after}; frames again {seconds:.1f} s after the link"


@check
def gel_swapped() -> str:
    """I2C: another gel ends the daemon with a sentence, its own store is chosen at the next start; none: no start"""
    with daemon() as process:
        tool("board", "eeprom", "write", *GEL, "--serial", "G-2", "--yes")
        assert process.wait(30) == 3, LOG.read_text()
        said = LOG.read_text().strip().splitlines()[-1]
    assert "gel G-1 was taken for G-2" in said, said
    with daemon():
        until("the other gel's store", Path("/run/store/gel-G-2").is_dir)
    (I2C / "absent").write_text(str(0x51))
    without = run(*ruffinid("VirtualDots"), code=3)
    (I2C / "absent").write_text("0")
    assert "nobody answers" in without, without
    return said


@check
def lamps_busy() -> str:
    """GPIO: a line that somebody else has is said, with who to ask"""
    with subprocess.Popen(["gpioset", "-c", "gpiochip0", "LAMPS=0"]):
        time.sleep(1)
        with daemon():
            said = LOG.read_text()
        run("pkill", "gpioset")
    assert "gpioinfo" in said, said
    return next(text for text in said.splitlines() if "LAMPS" in text)


@check
def service() -> str:
    """Service under systemd: READY=1, sandbox, real time, memory locked, watchdog, restarted when killed or hung"""
    # This computer is emulated: ten to twenty times slower than its host, and that has others to serve.
    drop_in = Path("/run/systemd/system/ruffinid.service.d/emulated.conf")
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(f"[Service]\nTimeoutStartSec=120\nTimeoutStopSec=60\nWatchdogSec={WATCHDOG_S}\n")
    run("systemctl", "daemon-reload")
    start = time.monotonic()
    run("systemctl", "start", "ruffinid", timeout=130)
    ready = time.monotonic() - start
    assert run("systemctl", "is-active", "ruffinid").strip() == "active"
    process = main_process()
    facts = content(f"/proc/{process}/status").splitlines()
    status = dict(fact.split(":\t", 1) for fact in facts if ":\t" in fact)
    assert status["Seccomp"] == "2"
    assert status["NoNewPrivs"] == "1"
    assert int(status["CapBnd"], 16) == 0
    assert int(status["VmLck"].split()[0]) > 0
    policy = run("chrt", "-p", process)
    assert "SCHED_FIFO" in policy, policy
    assert json.loads(ruffini("info", "--json"))["serial"] == "VM-0001"
    time.sleep(1.5 * WATCHDOG_S)
    assert run("systemctl", "show", "ruffinid", "-p", "NRestarts").strip() == "NRestarts=0"
    killed = restarted(process, "KILL")
    hung = restarted(main_process(), "STOP")
    assert "Watchdog timeout" in run("journalctl", "-u", "ruffinid", "--no-pager"), "no watchdog in the journal"
    assert json.loads(ruffini("info", "--json"))["serial"] == "VM-0001"
    return (
        f"READY=1 after {ready:.1f} s; killed, it was back after {killed:.1f} s; hung (SIGSTOP), with WatchdogSec="
        f"{WATCHDOG_S}, after {hung:.1f} s; locked {status['VmLck'].strip()}"
    )


def main_process() -> str:
    return run("systemctl", "show", "ruffinid", "-p", "MainPID", "--value").strip()


def restarted(process: str, signal: str) -> float:
    """Seconds from the signal to another process that has said READY=1."""
    start = time.monotonic()
    run("kill", f"-{signal}", process)
    until("another process", lambda: main_process() not in ("0", process), 60)
    until("active again", lambda: run("systemctl", "is-active", "ruffinid", code=None).strip() == "active", 120)
    return time.monotonic() - start


@check
def board_doctor() -> str:
    """Doctor of the board, as the service's user: finds this computer fit but for what it lacks"""
    run("systemctl", "stop", "ruffinid")
    printed = subprocess.run(
        ["ruffini-doctor", "--json"], capture_output=True, text=True, timeout=60, check=False
    ).stdout
    report = {c["name"]: c for c in json.loads(printed)["checks"]}
    for name in ("gpio", "i2c", "usb", "link", "store", "clock", "board", "frames"):
        assert report[name]["state"] == "ok", report[name]
    return ", ".join(f"{c['name']} {c['state']}" for c in report.values())


@check
def host_doctor() -> str:
    """Doctor of the host: rules and port found"""
    with daemon():
        report = {c["name"]: c for c in json.loads(tool("--port", port(), "doctor", "--json", code=None))["checks"]}
    for name in ("library", "udev rules", "port", "sensor"):
        assert report[name]["state"] == "ok", report[name]
    return report["sensor"]["found"]


def set_up() -> str:
    for module in ("i2c-dev", "gpio-sim", "libcomposite", "dummy_hcd", "cdc-acm"):
        run("modprobe", module)
    run("insmod", "/vm/i2c_bench.ko", "eeproms=0x50,0x51")
    chip = Path("/sys/kernel/config/gpio-sim/pad")
    for folder in (chip, chip / "bank0"):
        folder.mkdir()
    (chip / "bank0/num_lines").write_text("8")
    for name, n in (("LAMPS", LAMPS), ("TOUCH", TOUCH)):
        (chip / f"bank0/line{n}").mkdir()
        (chip / f"bank0/line{n}/name").write_text(name)
    (chip / "live").write_text("1")
    text = re.sub("^BOARD=.*", "BOARD=/vm/vmpad", ENVIRONMENT.read_text(), flags=re.M)
    text = re.sub("^CAMERA=.*", "CAMERA=libcamera:VirtualDots", text, flags=re.M)
    ENVIRONMENT.write_text(re.sub("^SERIAL=.*", "SERIAL=VM-0001", text, flags=re.M))
    os.environ.update(BOARD="/vm/vmpad", SERIAL="VM-0001")
    settle()
    return os.uname().release


def main() -> None:
    rows: list[dict[str, object]] = []

    def tell(is_over: bool) -> None:
        RESULT.with_suffix(".new").write_text(json.dumps({"rows": rows, "is_over": is_over}, indent=1))
        RESULT.with_suffix(".new").rename(RESULT)

    wanted = os.environ.get("VM_CHECKS", "").split()
    set_up.__doc__ = "Modules, simulated lines and bus, settings"
    for function in [set_up, *(f for f in checks if not wanted or f.__name__ in wanted)]:
        start = time.monotonic()
        row: dict[str, object] = {"check": (function.__doc__ or "").strip(), "ok": True, "found": ""}
        try:
            row["found"] = function()
        except BaseException as error:
            row.update(ok=False, found=f"{error}\n{traceback.format_exc()}")
        row["seconds"] = round(time.monotonic() - start, 1)
        rows.append(row)
        print(f"vm: {row['seconds']} s  {'ok' if row['ok'] else 'FAILED'}  {row['check']}\n{row['found']}", flush=True)
        tell(False)
    tell(True)


if __name__ == "__main__":
    main()
