"""The table of a virtual board's run: `result.py RESULT CONSOLE`. Exit code 1: something failed, or it did not end."""

from __future__ import annotations

import json
import sys
from pathlib import Path


def main() -> int:
    result, console = (Path(p) for p in sys.argv[1:3])
    told = json.loads(result.read_text()) if result.exists() else {"rows": [], "is_over": False}
    rows = told["rows"]
    for row in rows:
        print(f"{row['seconds']:7.1f} s  {'ok    ' if row['ok'] else 'FAILED'}  {row['check']}")
        print("\n".join(f"                   {line}" for line in row["found"].splitlines()))
    failed = [row["check"] for row in rows if not row["ok"]]
    print(
        f"{len(rows) - len(failed)} ok, {len(failed)} failed, {sum(row['seconds'] for row in rows):.0f} s in the guest"
    )
    if told["is_over"] and rows:
        return int(bool(failed))
    end = console.read_text(errors="replace")[-3000:] if console.exists() else "no console"
    print(f"vm: it did not come to its end; the end of its console ({console}):\n{end}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
