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
        print(f"ruffini: {error}", *_notes(error), sep="\n", file=sys.stderr)
        return error.exit_code
    except OSError as error:  # a path of the command line that no verb could use
        what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        print(f"ruffini: {what}: check the path and its permissions", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _notes(error: BaseException) -> list[str]:
    """What was added on the way up, e.g. that a stage could not be brought to safety."""
    return getattr(error, "__notes__", [])
