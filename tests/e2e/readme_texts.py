"""What the repository's texts show as commands: blocks of lines, and code within sentences."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from kept import cache_folder

from ruffini.cli.app import command as tree
from ruffini.cli.device import defaults_of_verbs

ROOT = Path(__file__).parents[2]
TEXTS = sorted(  # without those that tools put into folders such as .pytest_cache
    path
    for folder in (".", "boards", "docs", "firmware", "host", "proto", "tests")
    for path in (ROOT.glob("*.md") if folder == "." else (ROOT / folder).rglob("*.md"))
    if "node_modules" not in path.parts and not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
)
BLOCK = re.compile(r"^ *```([\w ]*)\n(.*?)^ *```$", re.M | re.S)
PROGRAM = re.compile(r"(?:\.venv/bin/)?ruffini (.*)")
FOLDERS = ("boards", "build", "docs", "host", "tests")  # that a reader finds where the commands are run
NOT_COMMANDS = ("BOARD",)  # what a device calls itself on USB


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path, kind: str) -> list[str]:
    return [block for found, block in BLOCK.findall(path.read_text()) if found == kind]


def spans(text: str) -> list[str]:
    """Code within the sentences, on one line each."""
    return [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", BLOCK.sub("", text))]


def words_of(line: str) -> list[str]:
    """What stands for more of the same, or may be left out, goes."""
    return [w.strip("[]") for w in shlex.split(line, comments=True) if w.strip("[].")]


def fault_of(words: list[str], *, is_whole: bool) -> str | None:
    """What the parser refuses; a file or folder of the reader's is not there. Typer brings its own click, or not."""
    command: Any = tree()
    context, rest = None, words
    while True:
        try:
            context = command.make_context(command.name or "ruffini", list(rest), parent=context)
            if not hasattr(command, "commands"):
                return None
            if context.parent is None and context.params["board"]:  # as the options before the verb do
                context.default_map = defaults_of_verbs(context.params["board"])
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


def run_commands(text: str, folder: Path, *, limit_s: float) -> subprocess.CompletedProcess[str]:
    """As pasted into a shell that stands in the repository, with its programs on the path; results go to `folder`."""
    for name in FOLDERS:
        (folder / name).symlink_to(ROOT / name)
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", text], cwd=folder, env=environment_in(folder),
        capture_output=True, text=True, timeout=limit_s, check=False,
    )  # fmt: skip


def environment_in(home: Path) -> dict[str, str]:
    """Of a command: nothing of the user's, but one cache for all runs."""
    environment = {k: v for k, v in os.environ.items() if k not in ("RUFFINI_PORT", "RUFFINI_SERIAL")}
    return environment | {
        "HOME": str(home),
        "XDG_CACHE_HOME": str(cache_folder() / "product"),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
