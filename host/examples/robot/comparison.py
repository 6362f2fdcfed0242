"""What the examples share: their arguments, what they refuse, a film, and a table with a row for each feedback."""

import argparse
import os
import sys
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

from ruffini.boards import find_board
from ruffini.errors import InputError, RuffiniError
from ruffini.robot.film import Film


class Outcome:
    """Of one attempt: it succeeds unless one of its failures is true."""

    FAILURES: ClassVar[tuple[str, ...]]  # names of attributes

    @property
    def is_success(self) -> bool:
        return not any(getattr(self, name) for name in self.FAILURES)


class Run(Protocol):
    """One attempt at a task under a feedback; `seed` is the noise's."""

    def __call__(self, feedback: str, task: Any, board: str, seed: int, film: Film | None) -> Any: ...


def compare(
    script: str, description: str | None, arguments: Sequence[str] | None, *, goal: str, feedbacks: Collection[str],
    task: Callable[[int], Any], run: Run, measure: Callable[[list[Any]], str], film: Film | None = None,
    film_seeds: Sequence[int] = (1,),
) -> None:  # fmt: skip
    """The table of all feedbacks; with --film the film of attempts by the first.

    Parameters
    ----------
    script : its name, in front of an error.
    goal : what counts as success.
    task : of a seed.
    run : returns an `Outcome`.
    measure : what the row of all outcomes ends with.
    film : takes the pictures, where the usual view of a gripper does not fit.
    film_seeds : of the tasks that are filmed, one after the other.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--film", help="write an animated picture here, and no table")
    chosen = parser.parse_args(arguments)
    try:
        _check(chosen.board, chosen.seeds, chosen.film)
        if chosen.film is not None:
            pictures = Film() if film is None else film
            for seed in film_seeds:
                run(next(iter(feedbacks)), task(seed), chosen.board, seed, pictures)
            pictures.write(chosen.film)
            return
        print(f"SIMULATED, {chosen.board}, {chosen.seeds} seeds: {goal}")
        for feedback in feedbacks:
            outcomes = [run(feedback, task(seed), chosen.board, seed, None) for seed in range(chosen.seeds)]
            counted = {"success": "is_success"} | {
                name.removeprefix("is_").replace("_", " "): name for name in outcomes[0].FAILURES
            }
            counts = [f"{said} {sum(getattr(one, name) for one in outcomes):2d}" for said, name in counted.items()]
            print(f"{feedback:14s} {', '.join(counts)}; {measure(outcomes)}", flush=True)
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
