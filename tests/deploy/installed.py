"""Looks whether what was installed is whole and works, on the machine where it was installed.

    python3 tests/deploy/installed.py device    ruffinid of a Debian package
    python3 tests/deploy/installed.py host      ruffini of a Debian package or a wheel, with the Python that it is for
    python3 tests/deploy/installed.py live      ruffini live on a video, with the ruffinid of a wheel
    python3 tests/deploy/installed.py frames FOLDER    what daemon_alone.py plays, with a Python that has the host tool
    python3 tests/deploy/installed.py plugin    LeRobot's plugin beside the host tool, without LeRobot
    python3 tests/deploy/installed.py both      the two talking over a pseudo-terminal

Every file of the checkout that belongs into a package is looked for by its content. Ends at the first thing that is
missing. Exit code 0: all is there.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ruffini.boards import Board

SOURCE = Path(__file__).parents[2]
DEPLOY = SOURCE / "firmware" / "deploy"
NOT_INSTALLED = {"packages.cmake", "ruffini"}  # the rules of the packages; the host tool's starter
DOTS = "gelsight-mini"  # a board of dots, whose forces need no picture of a press
LIBRARIES = ["/usr/bin/ruffinid", *(f"/usr/lib/ruffini/libruffini_{name}.so" for name in ("infer", "pictures"))]


def run(*command: str, code: int | None = 0, timeout: float = 120) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    if code is not None and done.returncode != code:
        sys.exit(f"installed: {' '.join(command)}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def need(is_so: object, what: str) -> None:
    if not is_so:
        sys.exit(f"installed: {what}")


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def all_there(wanted: list[Path], installed: list[Path], where: str) -> int:
    """How many: each wanted file is among the installed ones with the same content."""
    there = {digest(path) for path in installed if path.is_file()}
    missing = [str(path.relative_to(SOURCE)) for path in wanted if digest(path) not in there]
    need(wanted and not missing, f"{where} lacks {', '.join(missing) or 'everything'}")
    return len(wanted)


def of_package(name: str) -> list[Path]:
    return [Path(line) for line in run("dpkg", "-L", name).splitlines()]


def device() -> None:
    wanted = [p for p in DEPLOY.iterdir() if p.is_file() and p.name not in NOT_INSTALLED]
    wanted += SOURCE.glob("boards/*/board.toml")
    n = all_there(wanted, of_package("ruffinid"), "the package ruffinid")
    for library in LIBRARIES:
        need("not found" not in run("ldd", library), f"{library} lacks libraries: ldd {library}")
    version = run("ruffinid", "--version").strip()
    need(version, "ruffinid --version says nothing")
    run("systemd-analyze", "verify", "--man=no", "ruffinid.service", "ruffini-gadget.service")
    need("ruffini" in run("id", "-nG", "ruffini"), "no user ruffini")
    report = {c["name"]: c for c in json.loads(run("ruffini-doctor", "--json", code=None))["checks"]}
    for name in ("board", "store"):
        need(report[name]["state"] == "ok", f"ruffini-doctor: {report[name]}")
    print(f"ruffinid {version}: {n} files, units, user, doctor's board and store")


def host() -> None:
    import ruffini
    from ruffini.native import native_folder

    here = Path(ruffini.__file__).parent
    need(SOURCE not in here.parents, f"{here} is the checkout, not what was installed")
    wanted = [p for p in SOURCE.glob("host/ruffini/**/*") if p.suffix in (".py", ".rules") and "_native" not in p.parts]
    wanted += SOURCE.glob("boards/*/*.toml")
    need(not (here.parent / "papers").exists(), "the papers' methods are installed: they belong in a clone alone")
    n = all_there(wanted, list(here.glob("**/*")), str(here))
    native = native_folder()
    need(here in native.parents, f"{native} is not {here}'s own")
    for name in ("libruffini.so", "ruffini.desc", "page/index.html", "page/page.js"):
        need((native / name).is_file() and (native / name).stat().st_size > 100, f"{native / name} is missing")
    core = ctypes.CDLL(str(native / "libruffini.so"))
    core.ruffini_kernels.restype = ctypes.c_char_p
    if platform.machine() == "aarch64" or "avx2" in Path("/proc/cpuinfo").read_text():
        need(core.ruffini_kernels() == b"vector", f"{native}/libruffini.so makes no use of this processor's vectors")
    need("ruffini/$attr{serial}" in ruffini_tool("udev", "show"), "ruffini udev show: no link by serial number")
    ruffini_tool("board", "check", "gelslim")
    boards = ruffini_tool("board", "list").split()
    need("gelslim" in boards, f"ruffini board list: {boards}")
    print(f"ruffini {ruffini.__version__}: {n} files, library, schema, page, boards")


def pushed_dots(board: Board) -> Iterator[Any]:
    """Pictures of the board's dots, untouched, then pushed to the right."""
    import cv2
    import numpy as np

    c, m = board.camera, board.markers
    per_um = c.focal_mpx / 1e3 / c.standoff_um
    for frame in range(100):
        picture = np.full((c.height_px, c.width_px, 3), 150, np.uint8)
        push_px = max(0, min(frame - 50, 20)) * 0.2
        for column in range(m.n_x):
            for row in range(m.n_y):
                x = (m.first_x_um + column * m.pitch_x_um - board.pad.size_x_um / 2) * per_um + c.center_x_mpx / 1e3
                y = (m.first_y_um + row * m.pitch_y_um - board.pad.size_y_um / 2) * per_um + c.center_y_mpx / 1e3
                at = round(16 * (x + push_px)), round(16 * y)  # to a sixteenth of a pixel
                cv2.circle(picture, at, round(8 * m.diameter_um * per_um), (50, 50, 50), -1, cv2.LINE_AA, shift=4)
        yield picture


def write_calibration(board: Board, path: Path) -> None:
    from ruffini.calibrate import container
    from ruffini.demo.calibration import NOISE_WITHOUT_DEPTH
    from ruffini.estimators.operator.fit import make_operator

    kind = make_operator(board, method="optimal", noise=NOISE_WITHOUT_DEPTH)
    container.write(path, container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}))


def frames() -> None:
    """For daemon_alone.py: the pictures, what they are of, and a calibration."""
    import cv2

    from ruffini.boards import find_board

    board, folder = find_board(DOTS), Path(sys.argv[2])
    folder.mkdir(parents=True)
    for n, picture in enumerate(pushed_dots(board)):
        cv2.imwrite(str(folder / f"{n:03}.png"), picture)
    (folder / "recording.toml").write_text(f'board = "{board.name}"\nsimulated = true\n')
    write_calibration(board, folder / "calibration.safetensors")


def live() -> None:
    """`ruffini live` on a video, with the ruffinid that came with the package: a force field on the line."""
    import cv2

    from ruffini.boards import find_board
    from ruffini.daemon import find_daemon
    from ruffini.native import native_folder

    need(find_daemon().parent == native_folder(), f"ruffinid is {find_daemon()}, not the package's own")
    board = find_board(DOTS)
    c = board.camera
    with tempfile.TemporaryDirectory() as folder:
        calibration, video = Path(folder) / "calibration.safetensors", Path(folder) / "dots.avi"
        write_calibration(board, calibration)
        writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (c.width_px, c.height_px))
        for picture in pushed_dots(board):
            writer.write(picture)
        writer.release()
        words = ["live", "--camera", str(video), "--board", board.name, "--no-browser", "--http-port", "0", "--json"]
        tool = str(Path(sys.executable).with_name("ruffini"))
        store = {**os.environ, "XDG_STATE_HOME": folder}
        with subprocess.Popen([tool, *words], env=store, stdout=subprocess.PIPE, text=True) as process:
            try:
                address = json.loads(process.stdout.readline())["address"]
                with urllib.request.urlopen(f"{address.rstrip('/')}/lines.json", timeout=20) as answer:
                    (line,) = json.load(answer)
                need(Path(line["port"]).exists(), f"ruffini live: no line at {line}")
            finally:
                process.send_signal(signal.SIGINT)
        need(process.returncode == 0, f"ruffini live ended with {process.returncode}")
        field_of(board, video, calibration.read_bytes())


def field_of(board: Board, video: Path, calibration: bytes) -> None:
    import numpy as np

    from ruffini.device import Connection, Field
    from ruffini.live.unit import of_recording, running_unit

    os.environ["XDG_STATE_HOME"] = str(video.parent)
    with running_unit(of_recording(video), board) as daemon, Connection(daemon.port) as sensor:
        sensor.flash(calibration)
        sensor.subscribe(field=1)
        for n, (frame, message) in enumerate(sensor.stream(timeout_s=20)):
            if sensor.schema.type_name(frame.type) != "FIELD":
                continue
            pushed_n = np.nansum(Field.from_message(message).force[..., 0])
            if pushed_n > 0.1:
                print(f"live: a video of pushed dots gives a force field of {pushed_n:.2f} N along x")
                return
            need(n < 500, f"live: no force field in {n} packets")


def plugin() -> None:
    from importlib import metadata, util

    name = "lerobot_camera_ruffini"  # by its beginning LeRobot finds it
    spec = util.find_spec(name)  # to import it would want LeRobot
    need(spec is not None and spec.origin, f"{name} cannot be found")
    here = Path(spec.origin).parent
    need(SOURCE not in here.parents, f"{here} is the checkout, not what was installed")
    n = all_there(list((SOURCE / "host/lerobot_plugin" / name).glob("*.py")), list(here.glob("*")), str(here))
    wants = metadata.requires(name) or []
    need(any(text.startswith("ruffini") for text in wants), f"{name} does not want ruffini, but {wants}")
    need(any(text.startswith("lerobot") for text in wants), f"{name} does not want lerobot, but {wants}")
    print(f"{name} {metadata.version(name)}: {n} files, beside ruffini {metadata.version('ruffini')}")


def ruffini_tool(*words: str) -> str:
    """The host tool that belongs to this Python."""
    beside = Path(sys.executable).with_name("ruffini")
    return run(str(beside), *words)


def both() -> None:
    import cv2
    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder) / "frames"
        frames.mkdir()
        rng = np.random.default_rng(1)
        for k in range(4):
            cv2.imwrite(str(frames / f"{k}.png"), rng.integers(90, 120, (240, 320, 3)).astype(np.uint8))
        (frames / "recording.toml").write_text('board = "gelslim"\nsimulated = true\n')
        link = f"{folder}/line"
        command = ["ruffinid", "--board", "gelslim", "--camera", f"replay:{frames}", "--loop", "--link", f"pty:{link}"]
        with subprocess.Popen([*command, "--store", f"{folder}/store", "--serial", "P-1"]) as process:
            try:
                start = time.monotonic()
                while not Path(link).exists():
                    need(process.poll() is None and time.monotonic() < start + 20, "ruffinid did not start")
                    time.sleep(0.05)
                facts = json.loads(ruffini_tool("--port", link, "info", "--json"))
                need(facts["serial"] == "P-1", f"info: {facts}")
                n = len(ruffini_tool("--port", link, "monitor", "--n", "5", "--json").splitlines())
                need(n == 5, f"monitor --n 5: {n} lines")
            finally:
                process.terminate()
        need(process.returncode == 0, f"ruffinid ended with {process.returncode}")
    print("both: info and five frames of a replay over a pseudo-terminal")


if __name__ == "__main__":
    {"device": device, "host": host, "frames": frames, "live": live, "plugin": plugin, "both": both}[sys.argv[1]]()
