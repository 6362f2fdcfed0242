"""The committed ledger of long runs, tests/ledger.toml: what they add up to, and at which commit the last one was.

python tests/ledger.py fuzz frame=123456 session=4567

adds executions to the targets named. Whoever has run `make fuzz LEDGER=1` commits the file with the change that was
fuzzed.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

LEDGER = Path(__file__).parent / "ledger.toml"
HEADER = "# Accumulated figures of long runs, written by tests/ledger.py; not to be edited by hand.\n"


def add(rows: list[dict[str, Any]], target: str, executions: int, commit: str) -> None:
    """Add executions to the row of `target`, which is made where there is none."""
    row = next((r for r in rows if r["target"] == target), None)
    if row is None:
        rows.append(row := {"target": target, "executions": 0})
    row["executions"] += executions
    row["commit"] = commit


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
    if len(arguments) < 2 or arguments[0] != "fuzz":
        print(__doc__, file=sys.stderr)
        return 2
    tables = tomllib.loads(LEDGER.read_text()) if LEDGER.exists() else {}
    commit = subprocess.run(
        ["git", "rev-parse", "--short=12", "HEAD"], cwd=LEDGER.parent, capture_output=True, text=True, check=True
    ).stdout.strip()
    for argument in arguments[1:]:
        target, executions = argument.split("=")
        add(tables.setdefault("fuzz", []), target, int(executions), commit)
    LEDGER.write_text(written(tables))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
