"""The command line. Heavy imports happen inside the commands; `ruffini --help` stays fast."""

from __future__ import annotations

import sys

from ruffini.errors import RuffiniError


def main() -> int:
    """Run the command line; returns the exit code: 0 ok, 1 failed check, 2 usage, 3 no device, 4 refused, 5 verify."""
    from ruffini.cli.app import app

    try:
        app()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except RuffiniError as error:
        print(f"ruffini: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    return 0
