"""Commands of the texts that need no board and take minutes, word for word: `make readmes`, in CI when its turn comes.

Blocks of ```sh long, and whole commands within sentences. What takes hours goes with --quick: the same, but fewer.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from readme_texts import NOT_COMMANDS, PROGRAM, ROOT, TEXTS, blocks, fault_of, name_of, spans, words_of
from test_readme_blocks import BY_HAND, READERS_OWN

LIMIT_S = 2400
FOLDERS = ("boards", "build", "host", "tests")  # of the repository, in which a reader is
SCRIPT = re.compile(r"(?:python )?(tests/bench/\S+\.py(?: .*)?)")
HOURS = re.compile(r"ruffini (reproduce|bench papers|cal auto|sim reproduce) ")
ELSEWHERE = {  # command as a text shows it: what it wants, or what runs it
    "ruffini bench papers": "each board's own",
    "ruffini cal auto --rig sim --board gelslim": "the same with --quick",
    "ruffini cal undo": "a sensor",
    "ruffini cal zero": "a sensor",
    "ruffini devices": "a sensor",
    "ruffini doctor": "a computer that has all",
    "ruffini info": "a sensor",
    "ruffini latency": "a sensor",
    "ruffini replay run.mcap": "test_host_readme.py",
    "ruffini rerun": "a sensor",
    "ruffini view": "a sensor",
}


def is_whole(command: str) -> bool:
    """It parses, and all of it is there but for the place of its results."""
    if READERS_OWN.search(re.sub(r"--out (FOLDER|DIR)", "", command)) or "[" in command:
        return False
    found = PROGRAM.fullmatch(command)
    if found is None:
        return SCRIPT.fullmatch(command) is not None and (command.startswith("python ") or " --" in command)
    return found[1] not in NOT_COMMANDS and fault_of(words_of(found[1]), is_whole=True) is None


def sentences() -> list[str]:
    return sorted({span for path in TEXTS for span in spans(path.read_text()) if is_whole(span)})


def long_blocks() -> list[tuple[str, str]]:
    """Also those that a person runs for hours."""
    by_hand = [(path, block) for path in TEXTS for block in blocks(path, "console") if BY_HAND.search(block)]
    found = [*((path, block) for path in TEXTS for block in blocks(path, "sh long")), *by_hand]
    return [(name_of(path), block) for path, block in found]


def run(commands: str, folder: Path) -> None:
    for name in FOLDERS:
        (folder / name).symlink_to(ROOT / name)
    commands = re.sub(r"^(tests/)", r"python \1", commands)
    lines = [f"{line} --quick" if HOURS.match(line) and "--quick" not in line else line
             for line in (re.sub(r" +# .*", "", line) for line in commands.splitlines())]  # fmt: skip
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join(lines)],
        cwd=folder, capture_output=True, text=True, check=False, timeout=LIMIT_S,
        env={**os.environ, "HOME": str(folder), "PATH": path, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    if (
        done.returncode == 2
        and "PyTorch, which is not installed" in done.stderr
        and not importlib.util.find_spec("torch")
    ):
        pytest.skip("needs the extra [train]")
    assert done.returncode == 0, f"{commands}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


@pytest.mark.long
@pytest.mark.parametrize("line", [s for s in sentences() if s not in ELSEWHERE])
def test_a_command_within_a_sentence(line: str, tmp_path: Path) -> None:
    run(line, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(("name", "block"), long_blocks(), ids=lambda text: text if text.endswith(".md") else "")
def test_a_block(name: str, block: str, tmp_path: Path) -> None:
    run(block, tmp_path)


def test_what_is_not_run_is_still_in_a_text() -> None:
    assert [command for command in ELSEWHERE if command not in sentences()] == []
