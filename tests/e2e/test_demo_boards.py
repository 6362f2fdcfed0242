"""`ruffini demo` and `ruffini view --demo` on every board with a twin: `make readmes`; `make run` is gelslim's.

Calibrations are fitted as on a person's computer, and kept in the tests' own cache.
"""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import pytest
from browser import sensor_of, wait_for
from hang import HANG_S
from playwright.sync_api import Page
from readme_texts import ROOT, environment_in
from test_bad_input import HOST

from ruffini.boards import find_board

TWINS = sorted(path.parent.name for path in (ROOT / "boards").glob("*/twin.toml"))
LIMIT_S = 600  # two minutes on a quiet computer
VALID = 1


def pictures_of(name: str) -> set[str]:
    """What suits what the board measures."""
    board = find_board(name)
    first = "field" if board.writes("node_forces") else "contacts" if board.writes("contacts") else ""
    depth = "depth" if board.writes("depth") and "depth" not in board.board.not_measured else ""
    return {f"{kind}.png" for kind in (first, depth, "wrench") if kind}


@pytest.mark.long
@pytest.mark.parametrize("name", TWINS)
def test_the_first_picture_of_every_board_is_one_command(name: str, tmp_path: Path) -> None:
    command = [*HOST, "demo", "--board", name, "--out", str(tmp_path / "run"), "--json"]
    pipes = {"capture_output": True, "text": True, "check": False}
    done = subprocess.run(command, cwd=tmp_path, env=environment_in(tmp_path), timeout=LIMIT_S, **pipes)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert {Path(path).name for path in result["pictures"]} == pictures_of(name)
    assert all(Path(path).stat().st_size > 10_000 for path in result["pictures"])
    assert result["simulated"]
    assert result["valid_frames"] > 20
    assert result["force_axes"] == [
        axis for axis in "xyz" if f"force_{axis}" not in find_board(name).board.not_measured
    ]


@pytest.mark.long
@pytest.mark.parametrize("name", TWINS)
def test_every_board_is_pressed_in_the_page(name: str, page: Page, tmp_path: Path) -> None:
    command = [*HOST, "view", "--demo", name, "--no-browser", "--http-port", "0"]
    environment = environment_in(tmp_path)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, **pipes) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().strip()
            assert address, process.communicate(timeout=HANG_S)
            page.goto(address)
            state = wait_for(page, "a press", lambda s: is_pressed(name, sensor_of(s)["wrench"]))
        finally:
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=HANG_S)[1]
    assert process.returncode == 0, said
    assert sensor_of(state)["isSimulated"]


def is_pressed(name: str, wrench: dict[str, list[float]]) -> bool:
    """A force along an axis that the board measures."""
    axis = 0 if "force_z" in find_board(name).board.not_measured else 2
    return wrench["validity"][axis] == VALID and abs(wrench["values"][axis]) > 0.1
