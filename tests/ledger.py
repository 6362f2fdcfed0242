"""The committed ledger of long runs, tests/ledger.toml: what they add up to, and at which commit the last one was.

python tests/ledger.py fuzz frame=123456 session=4567

adds executions to the targets named.

python tests/ledger.py simulation build/ruffini_simulation 100

simulates so many device-hours, from the seed after the last one in the ledger on, and adds a row; none where a promise
was broken. `make soak` does that. After `make fuzz LEDGER=1` commit the file with the change that was
fuzzed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import tomllib

LEDGER = Path(__file__).parent / "ledger.toml"
HEADER = "# Accumulated figures of long runs, written by tests/ledger.py; not to be edited by hand.\n"


def add(rows: list[dict[str, Any]], target: str, executions: int, commit: str) -> None:
    """Add executions to the row of `target`, which is made where there is none."""
    row = next((r for r in rows if r["target"] == target), None)
    if row is None:
        rows.append(row := {"target": target, "executions": 0})
    row["executions"] += executions
    row["commit"] = commit


def simulate(rows: list[dict[str, Any]], program: str, hours: str, commit: str) -> int:
    """Device-hours with new seeds; the program's exit code."""
    first = max((row["first_seed"] + row["seeds"] for row in rows), default=1)
    command = [program, "--json", "--hours", hours, "--first", str(first)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode == 0:
        rows.append({**json.loads(done.stdout), "commit": commit})
        total = sum(row["device_hours"] for row in rows)
        print(f"SIMULATED: {rows[-1]['device_hours']} device-hours, {total:.1f} with those in the ledger, none broken")
    return done.returncode


def written(tables: dict[str, list[dict[str, Any]]]) -> str:
    """The file's text: strings and numbers only."""
    out = [HEADER]
    for name, rows in tables.items():
        for row in rows:
            lines = [
                f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in row.items()
            ]
            out.append("\n".join([f"\n[[{name}]]", *lines]) + "\n")
    return "".join(out)


def main(arguments: list[str]) -> int:
    is_simulation = len(arguments) == 3 and arguments[0] == "simulation"
    if not is_simulation and (len(arguments) < 2 or arguments[0] != "fuzz"):
        print(__doc__, file=sys.stderr)
        return 2
    tables = tomllib.loads(LEDGER.read_text()) if LEDGER.exists() else {}
    commit = subprocess.run(
        ["git", "rev-parse", "--short=12", "HEAD"], cwd=LEDGER.parent, capture_output=True, text=True, check=True
    ).stdout.strip()
    if is_simulation and simulate(tables.setdefault("simulation", []), arguments[1], arguments[2], commit) != 0:
        return 1
    for argument in arguments[1:] if not is_simulation else []:
        target, executions = argument.split("=")
        add(tables.setdefault("fuzz", []), target, int(executions), commit)
    LEDGER.write_text(written(tables))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
