"""Blocks of commands in the folders' texts: `sh` runs here word for word, `sh long` in test_long_commands.py,
`console` says what CI has not for it."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
from pathlib import Path

import pytest
from browser import sensor_of, wait_for
from playwright.sync_api import Page
from readme_texts import BLOCK, ROOT, TEXTS, blocks, name_of, run_commands
from test_bad_input import HOST

RUN_ELSEWHERE = {  # by `.ci/run`, test_host_readme.py, py/client/test_cpp_package.py
    "README.md", "host/README.md", "host/cpp/README.md"
}  # fmt: skip
COMMAND = re.compile(
    r" *((\.venv/bin/|build/)?(ruffini\w*|python)|make|pip|npm|cmake|ctest|c\+\+|dtc|lerobot-record|sudo|\.ci/\w+) "
)
# A sensor's port, or in capitals what the reader puts there: a bench, recordings, a folder of presses.
READERS_OWN = re.compile(
    r"/dev/|\b(NAME|BENCH|BOARD|FOLDER|FILE|DIR|LOG|COPY|THEIRS|PORT|ADDRESS)\b|\bsudo\b|\.\.\.|\.ci/"
)
BY_HAND = re.compile(r"^# by hand: (minutes|half an hour|an hour|hours)\b", re.M)
PRESS_S = 60.0
RUN_HERE = [(path, block) for path in TEXTS if name_of(path) not in RUN_ELSEWHERE for block in blocks(path, "sh")]


@pytest.mark.parametrize(("path", "block"), RUN_HERE, ids=lambda x: name_of(x) if isinstance(x, Path) else "")
def test_runs(path: Path, block: str, tmp_path: Path) -> None:
    done = run_commands(block, tmp_path, limit_s=600)
    assert done.returncode == 0, f"{block}\n{done.stderr}"


def test_some_run() -> None:
    assert {name_of(path) for path, _ in RUN_HERE} >= {"boards/ftouch/README.md", "host/ruffini/rig/README.md"}


@pytest.mark.parametrize("path", [p for p in TEXTS if name_of(p) != "host/README.md"], ids=name_of)
def test_what_does_not_run_says_why(path: Path) -> None:
    faults = [
        block
        for kind, block in BLOCK.findall(path.read_text())
        if kind not in ("sh", "sh long") and any(COMMAND.match(line) for line in block.splitlines())
        if kind != "console" or not (BY_HAND.search(block) or READERS_OWN.search(block))
    ]
    assert faults == []


def test_the_page_with_a_simulated_pad_as_its_readme_opens_it(page: Page, tmp_path: Path) -> None:
    """But for the browser, which this opens itself."""
    (line,) = [x for b in blocks(ROOT / "host/page/README.md", "console") for x in b.splitlines() if "--demo" in x]
    words = shlex.split(line, comments=True)[1:]
    command = [*HOST, *words, "--no-browser", "--http-port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            assert address, process.communicate(timeout=60)
            page.goto(address)
            state = wait_for(page, "a press", lambda s: sensor_of(s)["wrench"]["values"][2] < -0.2, PRESS_S)
        finally:
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=60)[1]
    assert process.returncode == 0, said
    assert sensor_of(state)["isSimulated"]
    assert min(sensor_of(state)["wrench"]["sigma"]) > 0
