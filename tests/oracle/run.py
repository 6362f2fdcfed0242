"""`make oracle`: CalculiX presses the pad, the board measures it, the twin does the same. Prints both tables.

Solutions are kept in build/oracle by the hash of their deck; a press that was solved before costs nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import compare
from presses import PRESSES, QUICK
from solve import OracleError

from ruffini.boards import find_board


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="gelslim", help="a board with a flat pad and a lattice of markers")
    parser.add_argument("--folder", type=Path, default=Path("build/oracle"), help="where solutions are kept")
    parser.add_argument("--quick", action="store_true", help="two presses: not the README's figures")
    parser.add_argument("--solved-only", action="store_true", help="only presses whose solution is kept")
    parser.add_argument("--out", type=Path, help="the tables also into this file, and as .json beside it")
    parser.add_argument("--keep", type=Path, help="the fields on the board's nodes into this .npz and stop")
    parser.add_argument("--only", nargs="+", help="only presses of these names")
    arguments = parser.parse_args()
    board = find_board(arguments.board)
    states, failed = [], 0
    for press in QUICK if arguments.quick else PRESSES:
        if arguments.only and press.name not in arguments.only:
            continue
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
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(text + "\n")
        arguments.out.with_suffix(".json").write_text(json.dumps({"mechanics": mechanics, "fields": fields}) + "\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
