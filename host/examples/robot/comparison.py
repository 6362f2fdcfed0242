"""What the examples share: their arguments, what they refuse, and a table with a row for each feedback."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from ruffini.boards import find_board
from ruffini.errors import InputError, RuffiniError


def compare(
    script: str, description: str | None, arguments: Sequence[str] | None, *, goal: str, feedbacks: Iterable[str],
    row: Callable[[str, str, int], str], film: Callable[[str, str], None],
) -> None:  # fmt: skip
    """The table of all feedbacks; with --film the film of one attempt.

    Parameters
    ----------
    script : its name, in front of an error.
    goal : what counts as success.
    row : of a feedback, on a board, over so many seeds.
    film : on a board, to a file.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--film", help="write an animated picture of one seed here, and no table")
    chosen = parser.parse_args(arguments)
    try:
        _check(chosen.board, chosen.seeds, chosen.film)
        if chosen.film is not None:
            film(chosen.board, chosen.film)
            return
        print(f"SIMULATED, {chosen.board}, {chosen.seeds} seeds: {goal}")
        for feedback in feedbacks:
            print(f"{feedback:14s} {row(feedback, chosen.board, chosen.seeds)}", flush=True)
    except RuffiniError as error:
        print(f"{script}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def _check(board: str, n_seeds: int, film: str | None) -> None:
    """Refuse what would fail after minutes."""
    unmeasured = [axis for axis in ("force_x", "force_y", "force_z") if axis in find_board(board).board.not_measured]
    if unmeasured:
        raise InputError(
            f"board {board!r} does not measure {', '.join(unmeasured)}, which this example needs: use another"
        )
    if missing := [
        slot for slot in ("node_forces", "wrench", "contacts", "slip") if not find_board(board).writes(slot)
    ]:
        raise InputError(
            f"board {board!r} has no stage for {', '.join(missing)}, which this example needs: use another"
        )
    if n_seeds < 1:
        raise InputError(f"--seeds {n_seeds}: give at least 1")
    if film is None:
        return
    path = Path(film).absolute()
    if path.suffix != ".gif" or path.is_dir() or not path.parent.is_dir():
        raise InputError(f"--film {film}: give a .gif in a folder that exists")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"--film {film}: the folder cannot be written")
