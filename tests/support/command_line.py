"""The command line as a function: words in, exit code and printed text out, without a process of its own.

A process costs a second of imports. Only tests of signals, pipes, terminals or the end of a process start one.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from hang import guard

from ruffini.cli import main
from ruffini.cli.common import Settings

HANDLED = (signal.SIGINT, signal.SIGTERM)  # by verbs that run until they are stopped


class Done(NamedTuple):
    """Exit code and printed text of one call."""

    code: int
    out: str
    err: str


def refusal_in(err: str) -> str:
    """The one sentence that ends the stderr of a refused call; lines before it are progress."""
    *progress, last = err.strip().splitlines() or [""]
    assert last.startswith("ruffini: "), err
    assert not any(line.startswith(("ruffini: ", "Traceback")) for line in progress), err
    return last


def run_ruffini(*words: object, port: str | None = None, cwd: Path | None = None, **environment: str) -> Done:
    """Call `ruffini` with these words.

    Parameters
    ----------
    port : sensor's port, as `--port`; without one the test's environment names none either.
    cwd : working directory during the call.
    environment : environment variables added during the call.

    Raises
    ------
    AssertionError
        The verb hangs.
    Exception
        The fault of a verb that a process would end with as a traceback.
    """
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    argv = ["ruffini", *(["--port", port] if port else []), *map(str, words)]
    with (
        _global_options_restored(),
        mock.patch.dict(os.environ, environment),
        mock.patch.object(sys, "argv", argv),
        contextlib.chdir(cwd or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        _hang_guard(" ".join(argv)),
    ):
        for name in {"RUFFINI_PORT", "RUFFINI_SERIAL"} - environment.keys():
            os.environ.pop(name, None)
        code = main()
    texts = [stream.buffer.getvalue().decode() for stream in (out, err)]  # type: ignore[attr-defined]
    return Done(code, *texts)


@contextlib.contextmanager
def _global_options_restored() -> Iterator[None]:
    names = ("port", "serial", "quiet", "progress")
    before = {name: getattr(Settings, name) for name in names}
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(Settings, name, value)


@contextlib.contextmanager
def _hang_guard(what: str) -> Iterator[None]:
    """A hang fails; signal handlers are restored. In the main thread only, the one that gets signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in HANDLED}
    try:
        with guard(what):
            yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
