"""Runs CalculiX on a deck, once: solutions are kept."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from ruffini.errors import RuffiniError

PROGRAM = "ccx"
TIME_LIMIT_S = 4 * 3600


class OracleError(RuffiniError):
    """The oracle has no solution; the message says why and what to do."""


def is_installed() -> bool:
    return shutil.which(PROGRAM) is not None


def solved(deck: str, kept: Path) -> Path:
    """`kept`, the .dat file of a deck: solved now unless it is there.

    Raises
    ------
    OracleError
        The program is missing, found no equilibrium, or took longer than TIME_LIMIT_S.
    """
    if kept.is_file():
        return kept
    if not is_installed():
        raise OracleError(f"{PROGRAM} is not installed: sudo apt-get install calculix-ccx")
    work = kept.with_suffix(".work")
    work.mkdir(parents=True, exist_ok=True)
    (work / "press.inp").write_text(deck)
    try:
        done = subprocess.run(
            [PROGRAM, "-i", "press"], cwd=work, capture_output=True, text=True, errors="replace", timeout=TIME_LIMIT_S,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise OracleError(
            f"{PROGRAM} was stopped after {TIME_LIMIT_S / 3600:g} h: {work}/press.sta has how far it came; a faster "
            "computer, or a larger TIME_LIMIT_S in tests/oracle/solve.py"
        ) from error
    if done.returncode or "*ERROR" in done.stdout or "Job finished" not in done.stdout:
        log = work / "press.log"
        log.write_text(done.stdout + done.stderr)
        raise OracleError(f"{PROGRAM} found no solution (exit code {done.returncode}): read {log}")
    os.replace(work / "press.dat", kept)
    shutil.rmtree(work)
    return kept
