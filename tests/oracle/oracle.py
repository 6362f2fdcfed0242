"""`make oracle`: CalculiX presses the pad, the board measures it, the twin does the same. Prints both tables.

Solutions are kept in build/oracle by the hash of their deck; a press that is kept costs nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import compare
from presses import PRESSES, QUICK, Press
from solve import OracleError

from ruffini.boards import find_board
from ruffini.errors import InputError, RuffiniError
from ruffini.files import write_whole


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim", help="a board with a flat pad and a lattice of markers")
    parser.add_argument("--folder", type=Path, default=Path("build/oracle"), help="where solutions are kept")
    parser.add_argument("--quick", action="store_true", help="two presses: not the README's figures")
    parser.add_argument("--solved-only", action="store_true", help="only presses whose solution is kept")
    parser.add_argument("--out", type=Path, help="the tables also into this file, and as .json beside it")
    parser.add_argument("--keep", type=Path, help="the fields on the board's nodes into this .npz and stop")
    parser.add_argument("--only", nargs="+", help="only presses of these names")
    chosen = parser.parse_args(arguments)
    try:
        return run(chosen)
    except RuffiniError as error:
        print(f"oracle: {error}", file=sys.stderr)
        return error.exit_code


def chosen_presses(only: list[str] | None, is_quick: bool) -> list[Press]:
    """The presses of these names; all, if there are none."""
    presses = QUICK if is_quick else PRESSES
    names = {press.name: None for press in presses}  # in their order
    if unknown := [name for name in only or () if name not in names]:
        raise InputError(f"no press {', '.join(map(repr, unknown))}: choose of {', '.join(names)}")
    return [press for press in presses if not only or press.name in only]


def run(arguments: argparse.Namespace) -> int:
    """The exit code."""
    board = find_board(arguments.board)
    compare.check_board(board)
    states, failed = [], 0
    for press in chosen_presses(arguments.only, arguments.quick):
        started = time.monotonic()
        try:
            solved = compare.solve_press(board, press, arguments.folder, only_kept=arguments.solved_only)
        except OracleError as error:
            failed += not arguments.solved_only
            print(f"oracle: {press.name}: {error}", file=sys.stderr)
            continue
        states += solved
        print(f"oracle: {press.name}, {len(solved)} states, {time.monotonic() - started:.0f} s", file=sys.stderr)
    if not states:
        return 1
    if arguments.keep:
        compare.keep_states(arguments.keep, states)
        return 1 if failed else 0
    twins = []
    for one in states:
        twins.append(compare.twin_state(board, one))
        print(f"twin: {one.name}", file=sys.stderr)
    mechanics = {one.name: compare.beside(one, twin) for one, twin in zip(states, twins, strict=True)}
    fields = compare.judge(board, states, twins)
    text = "\n".join([
        f"{board.name}, SIMULATED by CalculiX and by the twin: {len(states)} presses", "",
        compare.mechanics_table(mechanics), "", compare.field_table(fields), compare.means_table(fields),
    ])  # fmt: skip
    print(text)
    if arguments.out:
        write_whole(arguments.out, f"{text}\n".encode())
        figures = json.dumps({"mechanics": mechanics, "fields": fields})
        write_whole(arguments.out.with_suffix(".json"), f"{figures}\n".encode())
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
