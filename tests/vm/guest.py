"""Runs inside the virtual board, once systemd is up: real GPIO, I2C, USB and camera interfaces of the kernel.

`make vm` starts it; what it found is in /vm/result.json (checks.py).
"""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import time
from pathlib import Path

from checks import check, content, run, run_all, tool, until
from played_forces import beside_truth
from usb_camera_checks import (
    usb_camera,
    usb_camera_by_v4l2,
    usb_camera_unplugged,
    usb_camera_unplugged_by_v4l2,
)
from virtual_board import (
    DRIVER,
    ENVIRONMENT,
    GADGET,
    GEL,
    I2C,
    IREF,
    LAMPS,
    LED_OUT,
    LOG,
    THERMOMETER,
    TOUCH,
    WATCHDOG_S,
    allow_time,
    daemon,
    lamps,
    line,
    main_process,
    new_pictures,
    on_bus,
    pictures_and_wrenches,
    port,
    restarted,
    ruffini,
    ruffinid,
    serve,
    settings,
    settle,
    starved,
    udc,
    warm_to,
)


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
    printed = run("/vm/ruffini_capture_tests", "--gtest_filter=Libcamera*:Pixels*:V4l2*:Jpeg*:VideoNodes*", timeout=200)
    passed = re.search(r"\[  PASSED  \] (\d+) tests", printed)
    assert passed, printed
    assert "SKIPPED" not in printed, printed
    return f"{passed[1]} tests"


VIMC = Path("/sys/bus/platform/drivers/vimc")
BARS = [(1, 1, 1), (1, 1, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 0)]  # red, green, blue


@check
def kernel_camera() -> str:
    """Camera of the kernel (vimc), media graph and V4L2 buffers: colours; busy; no [exposure]; unplugged, back"""
    run("insmod", "/vm/vimc.ko")
    settle()
    refused = run(*ruffinid("vimc", board="vmexposed"), code=2)
    assert "cannot be told ExposureTime AnalogueGain ColourGains" in refused, refused
    with daemon("vimc", board="vmbare") as process:
        pictures = new_pictures(4)
        assert len(pictures) == 4, list(pictures)
        levels = pictures[max(pictures)].mean(axis=0)[..., ::-1]  # of each column: red, green, blue
        middles = levels[len(levels) // 16 :: len(levels) // 8]
        assert [tuple(row > 100) for row in middles] == BARS, middles
        busy = run(*ruffinid("vimc", board="vmbare"), code=3)
        assert "another program uses it" in busy, busy
        (VIMC / "unbind").write_text("vimc.0")
        until("ruffinid has ended", lambda: process.poll() is not None)
        gone = LOG.read_text().strip().splitlines()[-1]
        assert "was unplugged" in gone, LOG.read_text()
    (VIMC / "bind").write_text("vimc.0")
    settle()
    with daemon("vimc", board="vmbare"):
        assert len(new_pictures(1)) == 1
    return f"frames {list(pictures)}; bars {middles.round().astype(int).tolist()}; {gone}"


@check
def camera_stalls() -> str:
    """A camera whose driver gets no time: started again where the stop comes back, left to the kernel where not"""
    if not Path("/sys/kernel/debug/sched").exists():
        run("mount", "-t", "debugfs", "debugfs", "/sys/kernel/debug")
    with daemon("vimc", board="vmbare") as process:
        new_pictures(1)
        with starved() as first:
            time.sleep(2.0)  # a stall is told after 1 s, a stop that does not come back 2 s later
        assert len(new_pictures(2)) == 2
        assert process.poll() is None
        with starved() as second:
            assert second != first
            seconds = until("ruffinid gives up", lambda: "does not stop" in LOG.read_text(), 60)
        process.wait(20)
        said = LOG.read_text().strip().splitlines()[-1]
    return f"again after a stall of 2 s, by another thread of the driver; then {said}, after {seconds:.1f} s"


check(usb_camera)
check(usb_camera_unplugged)
check(usb_camera_by_v4l2)
check(usb_camera_unplugged_by_v4l2)


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
def forces() -> str:
    """Newtons, SIMULATED: the twin's presses through libcamera, ruffinid, USB; each wrench beside the truth"""
    with daemon("VirtualPress"):
        return beside_truth(pictures_and_wrenches())


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
        damaged_before = sensor.decoder.counters.malformed  # where an earlier reader went, a frame was cut
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
        assert (counters.malformed - damaged_before, counters.oversize) == (0, 0), counters
        missing = max(stamps) - min(stamps) + 1 - len(set(stamps))
        assert missing > 0, "nothing was lost: the reader did not lag"
    lost = f"{missing} of {max(stamps) - min(stamps) + 1} frames lost"
    return f"{lost}; an answer after {seconds:.1f} s; {counters}, {damaged_before} before"


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
    without = run(*ruffinid("VirtualRest"), code=3)
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
    ready = serve("vmpad")
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


@check
def threads() -> str:
    """Threads of the board file, under systemd: policy, priority and CPUs of each, as the kernel says"""
    serve("vmfull")
    wanted = {"frame": (46, {1}), "capture": (45, {1}), "link": (30, {0, 1})}
    found = {}
    for task in Path(f"/proc/{main_process()}/task").iterdir():
        n = int(task.name)
        assert os.sched_getscheduler(n) == os.SCHED_FIFO, content(task / "comm")
        found[content(task / "comm")] = (os.sched_getparam(n).sched_priority, os.sched_getaffinity(n))
    assert {name: found.get(name) for name in wanted} == wanted, found
    run("systemctl", "stop", "ruffinid")
    return ", ".join(f"{name} FIFO {priority} on CPU {sorted(cpus)}" for name, (priority, cpus) in found.items())


@check
def lamps_driver() -> str:
    """I2C: currents of the lamps' driver as asked, out when it says that it is hot, lit at a start, out at the end"""
    dark, lit = [0] * 4, [0b010001, 0, 0, 0]
    with daemon(board="vmfull"):
        assert on_bus(DRIVER, IREF, n=4) == [100, 0, 20, 0]
        assert on_bus(DRIVER, LED_OUT, n=4) == lit
        on_bus(DRIVER, 0x01, 0x80)
        seconds = until("lamps out", lambda: on_bus(DRIVER, LED_OUT, n=4) == dark)
        said = LOG.read_text().strip().splitlines()[-1]
        assert "LIGHT" in str(json.loads(ruffini("info", "--json"))["health"])
    on_bus(DRIVER, 0x01, 0)
    with daemon(board="vmfull"):
        assert on_bus(DRIVER, LED_OUT, n=4) == lit
    assert on_bus(DRIVER, LED_OUT, n=4) == dark
    return f"currents in steps 100, 0, 20; out {seconds:.1f} s after it was too hot: {said}"


@check
def thermometer() -> str:
    """Thermometer: a TMP102 of the kernel's driver, in the sensor's status"""
    from ruffini.device import Connection

    def said() -> list[tuple[str, int]]:
        return [(t.place, t.milli_celsius) for t in sensor.status().temperatures]

    warm_to(25.5)
    with daemon(board="vmfull"), Connection(port()) as sensor:
        until("25.5 degrees", lambda: said() == [("gel", 25500)])
        warm_to(31.25)
        seconds = until("31.25 degrees", lambda: said() == [("gel", 31250)])
    return f"31.25 C is said {seconds:.1f} s after it is so"


@check
def two_cameras() -> str:
    """Two cameras of libcamera as one picture: frames come; one that is not there is named"""
    without = run(*ruffinid("PadLeft", "NoSuchCamera", board="vmstereo"), code=3)
    assert "NoSuchCamera" in without, without
    with daemon("PadLeft", "PadRight", board="vmstereo"):
        lines = ruffini("monitor", "--n", "10", "--json").strip().splitlines()
        assert len(lines) == 10, lines
    return f"{len(lines)} frames; {without.strip()}"


@check
def two_pads() -> str:
    """Two pads on one computer, by the README's recipe: two services, two lines, two ports of the host"""
    recipe = Path("/usr/share/doc/ruffinid/README.md").read_text().split("## Two pads on one board")[1]
    commands = re.findall(r"^```console\n(.*?)```", recipe, re.M | re.S)[0].replace("sudo ", "")
    steps = re.split(r"(?<=second.env) +#.*\n", commands)
    assert len(steps) == 2, commands
    # Recordings keep their pace; two of these cameras, as fast as they are taken, leave this computer to nobody else.
    settings(ENVIRONMENT, CAMERA="replay:/vm/VirtualRest", MORE="--loop")
    serve("vmpad")
    run("sh", "-euc", steps[0])
    settings(Path("/etc/ruffini/second.env"), BOARD="/vm/vmbare", SERIAL="VM-0002", LINK="/dev/ttyGS1")
    allow_time("ruffinid-second")
    run("sh", "-euc", steps[1], timeout=300)
    found = {}
    for name in ("/dev/ttyACM0", "/dev/ttyACM1"):
        until(name, Path(name).exists)
        facts = json.loads(tool("--port", name, "--quiet", "info", "--json"))
        found[facts["serial"]] = f"{name} {facts['sensors'][0]['board']}"
        assert len(tool("--port", name, "--quiet", "monitor", "--n", "5", "--json").strip().splitlines()) == 5
    assert sorted(found) == ["VM-0001", "VM-0002"], found
    run("systemctl", "disable", "--now", "ruffinid-second")
    run("systemctl", "stop", "ruffinid")
    settings(ENVIRONMENT, CAMERA="libcamera:VirtualRest", MORE="", PADS="1")
    run("systemctl", "restart", "ruffini-gadget")
    until("the link", Path("/dev/ruffini/VM-0001").exists)
    settle()
    return f"{found}"


@check
def board_doctor() -> str:
    """Doctor of the board, as the service's user: finds this computer fit but for what it lacks"""
    run("systemctl", "stop", "ruffinid")
    settings(ENVIRONMENT, BOARD="/vm/vmfull")
    printed = subprocess.run(
        ["ruffini-doctor", "--json"], capture_output=True, text=True, timeout=60, check=False
    ).stdout
    report = {c["name"]: c for c in json.loads(printed)["checks"]}
    well = ("gpio", "i2c", "usb", "link", "store", "clock", "memory lock", "board", "frames", "threads", "lamps")
    for name in well:
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
    """Modules, simulated lines and bus, settings"""
    for_vimc = ("v4l2-tpg", "videobuf2-v4l2", "videobuf2-vmalloc", "videobuf2-dma-contig")
    for module in ("i2c-dev", "gpio-sim", "libcomposite", "dummy_hcd", "cdc-acm", "tmp102", *for_vimc):
        run("modprobe", module)
    run("insmod", "/vm/i2c_bench.ko", "eeproms=0x50,0x51", f"registers={DRIVER}", f"words={THERMOMETER}")
    on_bus(THERMOMETER, 1, 0x60, 0xA0)  # as it comes out of a reset
    warm_to(25.5)
    Path("/sys/bus/i2c/devices/i2c-0/new_device").write_text(f"tmp102 {THERMOMETER:#x}")
    until("the thermometer's file", Path("/sys/class/hwmon/hwmon0/temp1_input").exists)
    chip = Path("/sys/kernel/config/gpio-sim/pad")
    for folder in (chip, chip / "bank0"):
        folder.mkdir()
    (chip / "bank0/num_lines").write_text("8")
    for name, n in (("LAMPS", LAMPS), ("TOUCH", TOUCH)):
        (chip / f"bank0/line{n}").mkdir()
        (chip / f"bank0/line{n}/name").write_text(name)
    (chip / "live").write_text("1")
    settings(ENVIRONMENT, BOARD="/vm/vmpad", CAMERA="libcamera:VirtualRest", SERIAL="VM-0001")
    os.environ.update(BOARD="/vm/vmpad", SERIAL="VM-0001")
    settle()
    return os.uname().release


if __name__ == "__main__":
    run_all(set_up, log=LOG)
