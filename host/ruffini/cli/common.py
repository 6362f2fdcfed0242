"""What all commands share: results on stdout, progress on stderr, and only on a terminal."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import typer

JsonFlag = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
RESUME_S = 10.0
ResumeOption = Annotated[
    float, typer.Option(min=0, help="How long a line that was lost is waited for, seconds (0 = end with it).")
]
BoardOption = Annotated[str, typer.Option("--board", help="Board name, or a folder with a board.toml.")]


class Settings:
    """Global options, set once by the callback."""

    port: str | None = None
    serial: str | None = None
    quiet: bool = False
    progress: bool = True


def emit(result: dict[str, Any], as_json: bool, text: str) -> None:
    """Print a result: JSON or text."""
    print(json.dumps(result) if as_json else text, flush=True)


def note(text: str) -> None:
    """A line for the person, on stderr."""
    if not Settings.quiet:
        print(text, file=sys.stderr)


@contextlib.contextmanager
def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr where that is a terminal; silent otherwise."""
    if Settings.quiet or not Settings.progress or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda done: bar.update(task, completed=done)
