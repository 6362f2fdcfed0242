"""What the checks inside a virtual machine have in common: running commands, waiting, the host tool, the result."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import subprocess
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

RESULT = Path("/vm/result.json")
checks: list[Callable[[], str]] = []


def check(function: Callable[[], str]) -> Callable[[], str]:
    checks.append(function)
    return function


def run(*command: str, code: int | None = 0, timeout: float = 120) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    assert code is None or done.returncode == code, (
        f"{' '.join(command)}: exit code {done.returncode}\n{done.stdout}{done.stderr}"
    )
    return done.stdout + done.stderr


def until(what: str, is_so: Callable[[], object], seconds: float = 30) -> float:
    """Seconds until it is so."""
    start = time.monotonic()
    while not is_so():
        assert time.monotonic() - start < seconds, f"not after {seconds:g} s: {what}"
        time.sleep(0.05)
    return time.monotonic() - start


def content(path: Path | str) -> str:
    return Path(path).read_text().strip()


@functools.cache
def commands() -> Any:
    from typer.main import get_command

    from ruffini.cli.app import app

    return get_command(app)


def tool(*words: str, code: int | None = 0) -> str:
    """The host tool, in this process: to start it takes ten seconds on this emulated computer."""
    from ruffini.errors import RuffiniError

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            got = commands().main(list(words), prog_name="ruffini", standalone_mode=False) or 0
        except RuffiniError as error:
            print(f"ruffini: {error}")
            got = error.exit_code
    assert code is None or got == code, f"ruffini {' '.join(words)}: exit code {got}\n{said.getvalue()}"
    return said.getvalue()


def run_all(set_up: Callable[[], str], *, log: Path | None = None) -> None:
    """Each check in its order after set_up, or only those of VM_CHECKS; RESULT is written after each.

    log : its last lines stand beside a check that failed.
    """
    rows: list[dict[str, object]] = []

    def tell(is_over: bool) -> None:
        RESULT.with_suffix(".new").write_text(json.dumps({"rows": rows, "is_over": is_over}, indent=1))
        RESULT.with_suffix(".new").rename(RESULT)

    wanted = os.environ.get("VM_CHECKS", "").split()
    for function in [set_up, *(f for f in checks if not wanted or f.__name__ in wanted)]:
        start = time.monotonic()
        row: dict[str, object] = {"check": (function.__doc__ or "").strip(), "ok": True, "found": ""}
        try:
            row["found"] = function()
        except BaseException as error:
            said = "\n".join(content(log).splitlines()[-20:]) if log and log.exists() else ""
            row.update(ok=False, found=f"{error}\n{traceback.format_exc()}\n{said}")
        row["seconds"] = round(time.monotonic() - start, 1)
        rows.append(row)
        print(f"vm: {row['seconds']} s  {'ok' if row['ok'] else 'FAILED'}  {row['check']}\n{row['found']}", flush=True)
        tell(False)
    tell(True)
