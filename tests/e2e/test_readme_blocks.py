"""Blocks of commands in the folders' texts: `sh` runs here word for word, `sh long` in test_long_commands.py; `console`
says what CI has not for it."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
from pathlib import Path

import pytest
from browser import sensor_of, wait_for
from hang import HANG_S
from playwright.sync_api import Page
from readme_texts import BLOCK, ROOT, TEXTS, blocks, environment_in, name_of, run_commands
from test_bad_input import HOST

# Lines of `console` blocks that nobody runs as they are, and why. The others say it themselves (READERS_OWN).
SENSOR = "a sensor"
ITS_LOG = "the log of a collection at a sensor; the same on the twin is in that text's block `sh long`"
NOT_RUN = {
    "cmake -G Ninja -S . -B /root/build -DRUFFINI_PAGE=OFF && cmake --build /root/build --target ruffini_capture_tests":
        "goes on a line of .ci/in-root, which wants root",
    "ruffini record run.mcap --n 600": "test_host_readme.py, with fewer frames",
    "build/ruffinid --board boards/gelslim --camera replay:out/run/recording --loop --link pty:out/tty "
    "--store out/store --factory out/run/calibration.safetensors": "until it is stopped",
    "pip install ./host ./host/lerobot_plugin": "LeRobot wants Python 3.12 and PyTorch: .ci/wheel does without",
    "pip install -e 'host[train]'": "PyTorch: .ci/setup extras installs it for `make readmes`",
    ".venv/bin/ruffini view --demo gelslim": "test_the_page_with_a_simulated_pad_as_its_readme_opens_it, likewise",
    "ruffini view --demo gelslim": "test_the_page_with_a_simulated_pad_as_its_readme_opens_it, until it is stopped",
    ".venv/bin/ruffini live": SENSOR,
    "ruffini live": SENSOR,
    "ruffini live --camera VIDEO --board gelsight-mini": "test_live_verb.py, with a video that it draws",
    "ruffini cal flash colours.safetensors": SENSOR,
    "ruffini cal report unit.safetensors --log grid.h5 --out report.html": ITS_LOG,
    "ruffini cal flash unit.safetensors": SENSOR,
    "ruffini cal check --grams 100 --calibration unit.safetensors": SENSOR,
    "ruffini cal undo": SENSOR,
    "ruffini ros2 bridge --connect tcp/10.0.0.2:7447 --domain 7": "a sensor, another computer: test_ros2.py has both",
    "ruffini ros2 bridge --through rclpy": "a sensor and ROS 2",
}  # fmt: skip
RUN_ELSEWHERE = {  # by `.ci/run`, test_host_readme.py, py/client/test_cpp_package.py
    "README.md", "docs/tutorial.md", "host/README.md", "host/cpp/README.md"
}  # fmt: skip
COMMAND = re.compile(
    r" *((\.venv/bin/|build/)?(ruffini\w*|python)|make|pip|npm|cmake|ctest|c\+\+|dtc|lerobot-record|sudo|\.ci/\w+) "
)
# A sensor's port, or in capitals what the reader puts there: a bench, recordings, a folder of presses.
READERS_OWN = re.compile(
    r"/dev/|\b(NAME|BENCH|BOARD|FOLDER|FILE|DIR|LOG|COPY|THEIRS|PORT|ADDRESS)\b|\bsudo\b|\.\.\.|\.ci/"
)
BY_HAND = re.compile(r"^# by hand: (minutes|half an hour|an hour|hours)\b", re.M)
RUN_HERE = [(path, block) for path in TEXTS if name_of(path) not in RUN_ELSEWHERE for block in blocks(path, "sh")]


@pytest.mark.parametrize(("path", "block"), RUN_HERE, ids=lambda x: name_of(x) if isinstance(x, Path) else "")
def test_runs(path: Path, block: str, tmp_path: Path) -> None:
    done = run_commands(block, tmp_path, limit_s=600)
    assert done.returncode == 0, f"{block}\n{done.stderr}"


def test_some_run() -> None:
    assert {name_of(path) for path, _ in RUN_HERE} >= {"host/ruffini/ros/README.md", "host/ruffini/rig/README.md"}


def not_run(path: Path) -> list[tuple[str, str]]:
    """Kind of its block and line, without its comment, of each command that no test takes from its block."""
    return [
        (kind, re.sub(r" +# .*", "", line).strip())
        for kind, block in BLOCK.findall(path.read_text())
        if kind not in ("sh", "sh long") and not (kind == "console" and BY_HAND.search(block))
        for line in block.splitlines()
        if COMMAND.match(line)
    ]


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_what_does_not_run_says_why(path: Path) -> None:
    """Line by line: a command beside one that wants a board must run, or be named."""
    faults = [line for kind, line in not_run(path) if kind != "console" or not is_excused(line)]
    assert faults == []


def is_excused(line: str) -> bool:
    return bool(READERS_OWN.search(line)) or line in NOT_RUN


def test_a_line_is_not_excused_by_its_neighbour(tmp_path: Path) -> None:
    text = tmp_path / "README.md"
    block = "```console\nruffini --port /dev/ttyACM0 view  # now\nruffini board list  # all\n```\n"
    text.write_text(block + "```sh\nmake\n```\n")
    lines = [line for _, line in not_run(text)]
    assert lines == ["ruffini --port /dev/ttyACM0 view", "ruffini board list"]
    assert [is_excused(line) for line in lines] == [True, False]


def test_what_is_named_as_not_run_is_still_shown() -> None:
    shown = {line for path in TEXTS for _, line in not_run(path)}
    assert NOT_RUN.keys() - shown == set()


@pytest.mark.long
def test_the_page_with_a_simulated_pad_as_its_readme_opens_it(page: Page, tmp_path: Path) -> None:
    """But for the browser, which this opens itself."""
    (line,) = [x for b in blocks(ROOT / "host/page/README.md", "console") for x in b.splitlines() if "--demo" in x]
    words = shlex.split(line, comments=True)[1:]
    command = [*HOST, *words, "--no-browser", "--http-port", "0"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=tmp_path, env=environment_in(tmp_path), **pipes) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            assert address, process.communicate(timeout=HANG_S)
            page.goto(address)
            state = wait_for(page, "a press", lambda s: is_pressed(sensor_of(s)["wrench"]))
        finally:
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=HANG_S)[1]
    assert process.returncode == 0, said
    assert sensor_of(state)["isSimulated"]
    assert min(sensor_of(state)["wrench"]["sigma"]) > 0


def is_pressed(wrench: dict[str, list[float]]) -> bool:
    """A busy computer's camera stalls; the force that is then repeated is not valid and has no sigma."""
    return wrench["validity"] == [1] * 6 and wrench["values"][2] < -0.2
