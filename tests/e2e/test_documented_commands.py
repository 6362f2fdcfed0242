"""Every command that a README shows is one: its verbs, options, and in blocks also what a verb cannot do without."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from ruffini.cli.app import app

ROOT = Path(__file__).parents[2]
TEXTS = sorted(
    path
    for folder in (".", "boards", "firmware", "host", "proto", "tests")
    for path in (ROOT.glob("*.md") if folder == "." else (ROOT / folder).rglob("*.md"))
    if "node_modules" not in path.parts
)
NOT_COMMANDS = ("BOARD",)  # what a device calls itself on USB
PROGRAM = re.compile(r"(?:\.venv/bin/)?ruffini (.*)")


def words_of(line: str) -> list[str]:
    """What stands for more of the same, or may be left out, goes."""
    return [w.strip("[]") for w in shlex.split(line, comments=True) if w.strip("[].")]


def commands(text: str) -> Iterator[tuple[list[str], bool]]:
    """Words after the program's name, and whether they are a whole command."""
    for block in re.findall(r"^```\w*\n(.*?)^```$", text, re.M | re.S):
        for line in block.splitlines():
            if found := PROGRAM.match(line.strip()):
                yield words_of(found[1]), "..." not in line
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    for span in re.findall(r"`([^`]+)`", prose):
        if (found := PROGRAM.fullmatch(" ".join(span.split()))) and found[1] not in NOT_COMMANDS:
            yield words_of(found[1]), False


def fault_of(words: list[str], *, is_whole: bool) -> str | None:
    """What the parser refuses; a file or folder of the reader's is not there. Typer brings its own click, or not."""
    command: Any = typer.main.get_command(app)
    context, rest = None, words
    while True:
        try:
            context = command.make_context(command.name or "ruffini", list(rest), parent=context)
            if not hasattr(command, "commands"):
                return None
            rest = [*context._protected_args, *context.args]  # there is no other door to them
            _, command, rest = command.resolve_command(context, rest)
        except Exception as error:  # by name: of which click they are depends on Typer's version
            kind = type(error).__name__
            is_place = type(getattr(getattr(error, "param", None), "type", None)).__name__ == "TyperPath"
            if kind == "NoArgsIsHelpError":
                return "a group, not a verb" if is_whole else None
            if kind in ("MissingParameter", "BadParameter", "BadOptionUsage"):  # something of it is not there
                return None if not is_whole or (is_place and kind == "BadParameter") else str(error)
            if kind in ("NoSuchOption", "NoSuchCommand", "UsageError"):
                return str(error)
            raise


@pytest.mark.parametrize("path", TEXTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_commands_exist(path: Path) -> None:
    faults = [(words, fault_of(words, is_whole=whole)) for words, whole in commands(path.read_text())]
    assert [f for f in faults if f[1]] == []


def test_most_texts_have_some() -> None:
    found = [sum(1 for _ in commands(path.read_text())) for path in TEXTS]
    assert sum(n > 0 for n in found) > 15
    assert sum(found) > 150


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("cal coffee", "No such command"),
        ("cal operator --bored gelslim", "No such option"),
        ("cal fit --board tiny", "Missing"),
        ("record run.mcap --n many", "valid integer"),
        ("sim", "not a verb"),
    ],
)
def test_what_is_none_is_told(line: str, says: str) -> None:
    assert says in str(fault_of(line.split(), is_whole=True))
