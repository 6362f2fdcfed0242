"""The command line. Heavy imports happen inside the commands; `ruffini --help` stays fast."""

from __future__ import annotations

import sys

from ruffini.errors import RuffiniError

USAGE = 2
INTERRUPTED = 130  # 128 + SIGINT, as a shell reports it


def main() -> int:
    """Run the command line and return the exit code.

    0 ok, 1 failed check, 2 usage, 3 no device, 4 refused, 5 verify failed, 130 interrupted. With `--json` an error is
    one JSON object on stdout, {"error": sentence, "exit_code": number}, beside the sentence on stderr.
    """
    from ruffini.cli.app import command

    try:
        command()()
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        if code == USAGE:  # of a command line; what a verb refuses is a RuffiniError
            _as_json("wrong usage: stderr says what is wrong", code)
        return code
    except RuffiniError as error:
        return _fail(str(error), error.exit_code, *_notes(error))
    except OSError as error:  # a path of the command line that no verb could use
        what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        return _fail(f"{what}: check the path and its permissions", 2)
    except RecursionError:  # JSON and TOML parsers on a file of brackets
        return _fail("what was given is nested too deep: is it the right file?", 2)
    except MemoryError:
        return _fail("there is not enough memory for this: is it the right file?", 2)
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0


def _fail(sentence: str, exit_code: int, *notes: str) -> int:
    """Print an error on stderr and, with `--json`, as an object on stdout."""
    print(f"ruffini: {sentence}", *notes, sep="\n", file=sys.stderr)
    _as_json(sentence, exit_code)
    return exit_code


def _as_json(sentence: str, exit_code: int) -> None:
    if "--json" in sys.argv[1:]:
        import json

        print(json.dumps({"error": sentence, "exit_code": exit_code}), flush=True)


def _notes(error: BaseException) -> list[str]:
    """What was added on the way up, e.g. that a stage could not be brought to safety."""
    return getattr(error, "__notes__", [])
