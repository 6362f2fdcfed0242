"""`make oracle`: CalculiX presses the pad, and the board measures it. Prints how far the board errs.

What CalculiX says is kept in KEPT, named by the hash of its deck; a press whose deck has changed is solved.
"""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import compare
from compare import Solved
from presses import NEO_HOOKE, PRESSES, Press
from solve import OracleError

from ruffini.boards import Board, find_board
from ruffini.errors import InputError, RuffiniError
from ruffini.files import write_whole

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "tests" / "data" / "oracle" / "presses.npz"
KEPT_BOARD = "gelslim"
JUDGED = ("host/ruffini", "firmware", "boards", "tests/oracle", str(KEPT.relative_to(ROOT)), ":!*.md")
sys.path += [str(ROOT / "tests" / "bench"), str(ROOT / "tests" / "hostile")]
from gels import with_row  # noqa: E402
from table import commit  # noqa: E402


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default=KEPT_BOARD, help="a board with a flat pad and a lattice of markers")
    parser.add_argument("--folder", type=Path, default=Path("build/oracle"), help="where the solver's files are kept")
    parser.add_argument(
        "--again", action="store_true", help=f"solve also what {KEPT.name} has; without --keep, compare"
    )
    parser.add_argument("--turn", type=turn, default=(0, 1), metavar="K/N", help="only every N-th press, from the K-th")
    parser.add_argument("--twin", action="store_true", help="the twin beside it: minutes for each state the first time")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the mean errors into this document")
    parser.add_argument("--out", type=Path, help="the tables also into this file, and as .json beside it")
    parser.add_argument("--keep", action="store_true", help=f"solve what {KEPT.name} lacks, write it there, and stop")
    parser.add_argument("--only", nargs="+", help="only presses of these names")
    chosen = parser.parse_args(arguments)
    try:
        return run(chosen)
    except RuffiniError as error:
        print(f"oracle: {error}", file=sys.stderr)
        return error.exit_code


def turn(text: str) -> tuple[int, int]:
    """K/N."""
    at, _, n = text.partition("/")
    if not (at.isdecimal() and n.isdecimal() and int(at) < int(n)):
        raise argparse.ArgumentTypeError(f"{text!r} is not K/N with K below N, as in 0/6")
    return int(at), int(n)


def chosen_presses(only: list[str] | None, at: int, n: int) -> list[Press]:
    """The presses of these names, all if there are none; of them every n-th from number `at`."""
    names = [press.name for press in PRESSES]
    if unknown := [name for name in only or () if name not in names]:
        raise InputError(f"no press {', '.join(map(repr, unknown))}: choose of {', '.join(names)}")
    named = [press for press in PRESSES if not only or press.name in only]
    if at >= len(named):
        raise InputError(f"--turn {at}/{n}: of {len(named)} presses none is number {at}: begin with a smaller one")
    return named[at::n]


def states_of(board: Board, press: Press, chosen: argparse.Namespace) -> list[Solved]:
    """The states of a press: kept or solved; with `--again` solved now, and like the kept ones unless `--keep`.

    Raises
    ------
    OracleError
        It cannot be solved here, or the kept states are others.
    """
    kept = compare.kept_press(KEPT, board, press)
    if kept is not None and not chosen.again:
        return kept
    if chosen.again and kept is None and not chosen.keep:
        raise OracleError(
            f"{KEPT} has no states of this deck and board to compare with: leave --again out, or --keep them"
        )
    started = time.monotonic()
    print(f"oracle: {press.name}: CalculiX solves it, some minutes", file=sys.stderr)
    folder = chosen.folder
    if chosen.again:  # not what an earlier run left, but its files, for the log
        shutil.rmtree(folder := folder / "again", ignore_errors=True)
    solved = compare.solve_press(board, press, folder)
    print(f"oracle: {press.name}, {len(solved)} states, {time.monotonic() - started:.0f} s", file=sys.stderr)
    if kept is not None and not chosen.keep and (difference := compare.solved_again(kept, solved)):
        raise OracleError(f"{difference} ({KEPT}): find out why, then solve all with --keep --again")
    return solved


def run(arguments: argparse.Namespace) -> int:
    """The exit code."""
    board = find_board(arguments.board)
    compare.check_board(board)
    is_part = bool(arguments.only) or arguments.turn != (0, 1) or board.name != KEPT_BOARD
    if is_part and (arguments.keep or arguments.table):
        raise InputError(
            f"--keep and --table are for all presses of {KEPT_BOARD}: leave --board, --only and --turn out"
        )
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    states, failed = [], 0
    for press in chosen_presses(arguments.only, *arguments.turn):
        try:
            states += states_of(board, press, arguments)
        except OracleError as error:
            failed += 1
            print(f"oracle: {press.name}: {error}", file=sys.stderr)
    if failed and (arguments.keep or arguments.table or not states):
        return 1
    if arguments.keep:
        compare.keep_states(KEPT, board, states)
        return 0
    twins = {}
    for one in states:
        if arguments.twin and one.press.exponent == NEO_HOOKE:  # as the twin's rubber
            print(f"twin: {one.name}", file=sys.stderr)
            twins[one.name] = compare.twin_state(board, one)
    mechanics = {one.name: compare.beside(one, twins[one.name]) for one in states if one.name in twins}
    fields = compare.judge(board, states, twins)
    means = compare.means(states, fields)
    tables = f"{board.name}, SIMULATED by CalculiX: {len(states)} states\n\n"
    if mechanics:
        tables += f"{compare.mechanics_table(mechanics)}\n\n"
    tables += f"{compare.field_table(fields)}\n{compare.means_table(means)}"
    print(tables)
    if arguments.table:
        document = arguments.table.read_text()
        for name, cells in means:
            document = with_row(
                document, f"| {' | '.join((name, *cells, at, date))} |", compare.SECTION, compare.COLUMNS
            )
        write_whole(arguments.table, document.encode())
    if arguments.out:
        write_whole(arguments.out, f"{tables}\n".encode())
        figures = json.dumps({"mechanics": mechanics, "fields": fields})
        write_whole(arguments.out.with_suffix(".json"), f"{figures}\n".encode())
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
