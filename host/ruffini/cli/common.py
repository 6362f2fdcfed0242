"""Shared by all commands: results on stdout, progress on stderr (a bar on a terminal, plain lines elsewhere)."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ruffini.calibrate.gates import Gate

JsonFlag = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
RESUME_S = 10.0
PLAIN_PERIOD_S = 5.0  # between two lines of progress on a pipe
ResumeOption = Annotated[
    float, typer.Option(min=0, help="How long a line that was lost is waited for, seconds (0 = end with it).")
]
BoardOption = Annotated[str, typer.Option("--board", help="Board name, or a folder with a board.toml.")]
StrainOption = Annotated[str, typer.Option("--strain", help="finite for a real pad, or linear.")]
MOST_WORKERS = 8  # a process takes half a gigabyte
WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help=f"Processes (default: one a core, at most {MOST_WORKERS}).")
]


def n_workers_of(asked: int | None) -> int:
    """What was given as WorkersOption, or one for each core that this process may use, as far as the system says."""
    if asked is not None:
        return asked
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(n_cores, MOST_WORKERS)


def is_finite(strain: str) -> bool:
    """What was given as StrainOption.

    Raises
    ------
    InputError
        Neither of the two.
    """
    from ruffini.errors import InputError

    if strain not in ("linear", "finite"):
        raise InputError(f"--strain {strain!r}: choose linear or finite")
    return strain == "finite"


class Settings:
    """Global options, set once by the callback."""

    port: str | None = None
    serial: str | None = None
    quiet: bool = False
    progress: bool = True


def printable(text: str) -> str:
    """`text` with every control character but newline and tab escaped."""
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


def emit(result: dict[str, Any], as_json: bool, text: str) -> None:
    """Print a result: JSON or text. Control characters in a device's name do not reach the terminal."""
    print(json.dumps(result) if as_json else printable(text), flush=True)


def emit_judged(result: dict[str, Any], gates: Sequence[Gate], as_json: bool, text: str) -> None:
    """`emit` a fit with its gates; a failed one is named, and ends the verb with exit code 1."""
    result = {**result, "gates": [gate._asdict() for gate in gates]}
    bad = [gate for gate in gates if gate.ok is False]
    for gate in gates:
        note(f"{'ok  ' if gate.ok else 'open' if gate.ok is None else 'FAIL'} {gate.name}: {gate.text}")
    emit(result, as_json, text + (f"\nFAILS {', '.join(g.name for g in bad)}: it will not be flashed" if bad else ""))
    if bad:
        raise typer.Exit(1)


def note(text: str) -> None:
    """A line for the person, on stderr."""
    if not Settings.quiet:
        print(printable(text), file=sys.stderr, flush=True)


def note_start(verb: str, board: str | None) -> None:
    """`note` what begins, with its board where one is named."""
    note(f"{verb} ..." if board is None else f"{verb}: board {board}")


@contextlib.contextmanager
def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr on a terminal, plain lines elsewhere; yields a function that takes the fraction done, 0 to 1.

    On a pipe the label is printed at once, then the percentage at most every `PLAIN_PERIOD_S`.
    """
    if Settings.quiet or not Settings.progress:
        yield lambda _: None
        return
    if not sys.stderr.isatty():
        lines = PlainProgress(label)
        yield lines.update
        lines.finish()
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda done: bar.update(task, completed=done)


class PlainProgress:
    """Progress as lines of text on stderr, for logs and pipes."""

    def __init__(self, label: str, now: Callable[[], float] = time.monotonic) -> None:
        self._label, self._now = label, now
        self._start_s = self._printed_s = now()
        print(f"{label} ...", file=sys.stderr, flush=True)

    def update(self, done: float) -> None:
        """Print the fraction `done`, 0 to 1, unless a line was printed less than `PLAIN_PERIOD_S` ago."""
        now_s = self._now()
        if now_s - self._printed_s < PLAIN_PERIOD_S:
            return
        self._printed_s = now_s
        print(f"{self._label}: {100 * done:.0f} %, {now_s - self._start_s:.0f} s", file=sys.stderr, flush=True)

    def finish(self) -> None:
        """Print the duration of work that took longer than one period."""
        duration_s = self._now() - self._start_s
        if duration_s >= PLAIN_PERIOD_S:
            print(f"{self._label}: done, {duration_s:.0f} s", file=sys.stderr, flush=True)
