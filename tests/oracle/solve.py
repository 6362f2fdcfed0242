"""Runs CalculiX on a deck, once: solutions are kept by the hash of the deck."""

from __future__ import annotations

import hashlib
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


def solved(deck: str, folder: Path, *, only_kept: bool = False) -> Path:
    """The .dat file of a deck, from `folder` if it was solved before; otherwise it is solved, unless `only_kept`.

    Raises
    ------
    OracleError
        The program is missing, found no equilibrium, or took longer than TIME_LIMIT_S.
    """
    name = hashlib.sha256(deck.encode()).hexdigest()[:24]
    kept = folder / f"{name}.dat"
    if kept.is_file():
        return kept
    if only_kept:
        raise OracleError(f"no kept solution in {folder}: solve it without --solved-only")
    if not is_installed():
        raise OracleError(f"{PROGRAM} is not installed: sudo apt-get install calculix-ccx")
    work = folder / f"{name}.work"
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
