"""Commands of the texts that need no board and take minutes, word for word: `make readmes`, in CI when its turn comes.

Blocks of ```sh long, and whole commands within sentences. What takes hours goes with --quick: the same, but fewer.
"""

from __future__ import annotations

import importlib.util
import os
import re
from pathlib import Path

import pytest
from readme_texts import NOT_COMMANDS, PROGRAM, TEXTS, blocks, fault_of, name_of, run_commands, spans, words_of
from test_readme_blocks import BY_HAND, READERS_OWN

LIMIT_S = 2400
TURN, OF = (int(part) for part in os.environ.get("RUFFINI_READMES_TURN", "0/1").split("/"))  # "1/2": every other one
SCRIPT = re.compile(r"(?:python )?(tests/bench/\S+\.py(?: .*)?)")
NEEDS_OUT = re.compile(r"ruffini reproduce(?!.* --out)(?!.* --only method)")  # the verb asks for it, not the parser
ENDLESS = re.compile(r"ruffini view --demo")  # until Ctrl-C; test_view_boards.py
HOURS = re.compile(r"ruffini (reproduce|cal auto) ")
ELSEWHERE = {  # command as a text shows it: what it wants, or what runs it
    "ruffini board eeprom write": "an EEPROM and the identity's serial number",
    "ruffini cal check --grams 100 --calibration unit.safetensors": "a sensor, and a weight",
    "ruffini cal fit --only wrench": "a log",
    "ruffini cal file merge unit.safetensors colours.safetensors --out both.safetensors": "two fitted files",
    "ruffini cal undo": "a sensor",
    "ruffini cal zero": "a sensor",
    "ruffini devices": "a sensor",
    "ruffini doctor": "a computer that has all",
    "ruffini eval real": "recordings",
    "ruffini info": "a sensor",
    "ruffini info --json": "a sensor",
    "ruffini latency": "a sensor",
    "ruffini live": "a camera",
    "ruffini replay run.mcap": "test_host_readme.py",
    "ruffini rerun": "a sensor",
    "ruffini view": "a sensor",
}


def is_whole(command: str) -> bool:
    """It parses, and all of it is there but for the place of its results."""
    needed = re.sub(r"--out (FOLDER|DIR)", "", command)
    if (
        ENDLESS.match(command)
        or NEEDS_OUT.match(command)
        or READERS_OWN.search(needed)
        or re.search(r"\b(VIDEO|B)\b|\[", needed)
    ):
        return False
    found = PROGRAM.fullmatch(command)
    if found is None:
        return SCRIPT.fullmatch(command) is not None and (command.startswith("python ") or " --" in command)
    return found[1] not in NOT_COMMANDS and fault_of(words_of(found[1]), is_whole=True) is None


def sentences() -> list[str]:
    return sorted({span for path in TEXTS for span in spans(path.read_text()) if is_whole(span)})


def run_here() -> list[str]:
    return [command for command in sentences() if command not in ELSEWHERE][TURN::OF]


def long_blocks() -> list[tuple[str, str]]:
    """Name of the text and block; also those that a person runs for hours."""
    by_hand = [(path, block) for path in TEXTS for block in blocks(path, "console") if BY_HAND.search(block)]
    found = [*((path, block) for path in TEXTS for block in blocks(path, "sh long")), *by_hand]
    return [(name_of(path), block) for path, block in found]


def run(commands: str, folder: Path) -> None:
    lines = [re.sub(r" +# .*", "", line) for line in re.sub(r"^(tests/)", r"python \1", commands).splitlines()]
    lines = [f"{line} --quick" if HOURS.match(line) and "--quick" not in line else line for line in lines]
    done = run_commands("\n".join(lines), folder, limit_s=LIMIT_S)
    if "'torch>=" in done.stderr and not importlib.util.find_spec("torch"):
        pytest.skip("needs the extra [train]")
    if done.returncode == 1 and done.stdout.rstrip().endswith("it will not be flashed"):
        return  # it ran to its end, and a gate has its word
    assert done.returncode == 0, f"{commands}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


@pytest.mark.long
@pytest.mark.parametrize("line", run_here())
def test_a_command_within_a_sentence(line: str, tmp_path: Path) -> None:
    run(line, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "block"), long_blocks()[TURN::OF], ids=lambda text: text if text.endswith(".md") else ""
)
def test_a_block(name: str, block: str, tmp_path: Path) -> None:
    run(block, tmp_path)


def test_none_is_overlooked() -> None:
    texts = ("ftouch/DESIGN", "gelslim/README", "stereo-fingertip-thick/README")
    boards = {f"boards/{text}.md" for text in texts}
    assert {name for name, _ in long_blocks()} >= {*boards, "host/ruffini/calibrate/README.md"}
    assert len(sentences()) > 25


def test_what_is_not_run_is_still_in_a_text() -> None:
    assert [command for command in ELSEWHERE if command not in sentences()] == []
