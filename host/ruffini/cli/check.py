"""ruffini cal check: does this unit still measure as its report says?"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import JsonFlag, emit, note, note_start
from ruffini.cli.device import open_sensor
from ruffini.errors import InputError, RefusedError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.calibrate.container import CalibrationFile
    from ruffini.rig.bench import Bench

SIMULATED = "sim"
WEIGHT_SIGMA_G = 0.1


def check(
    grams: Annotated[float | None, typer.Option(min=1, help="Weight that a person puts on the level pad.")] = None,
    ball_mm: Annotated[float | None, typer.Option(min=0.5, help="Ball that a person presses: its diameter.")] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="The calibration in force: its report says what is allowed.")
    ] = None,
    rig: Annotated[str | None, typer.Option("--rig", help="sim: on the twin of --board, with --calibration.")] = None,
    board: Annotated[str | None, typer.Option("--board", help="--rig sim: whose twin.")] = None,
    unit: Annotated[int | None, typer.Option(help="--rig sim: unit of a fleet, off its board file.")] = None,
    json_: JsonFlag = False,
) -> None:
    """One weight or one ball: does this unit still meet its report?"""
    note_start("cal check", board)
    from ruffini.calibrate import container
    from ruffini.rig.check import check_ball, check_weight

    if (grams is None) == (ball_mm is None):
        raise InputError("give one of --grams (a weight) and --ball-mm (a ball)")
    if rig not in (None, SIMULATED):
        raise InputError(f"--rig {rig!r}: only sim; a real unit is checked by hand, without a bench")
    file = None if calibration is None else container.read(calibration)
    with _simulated(file, board, unit) if rig == SIMULATED else _real(file) as (bench, found):
        done = check_weight(bench, grams, file) if grams is not None else check_ball(bench, found, ball_mm or 0.0)
    words = "meets its report" if done.ok else "DOES NOT MEET ITS REPORT: calibrate it again"
    emit({"board": found.name, "simulated": rig == SIMULATED, "ok": done.ok, **done._asdict()}, json_,
         f"{done.what}: {done.said:.3f} {done.unit}, {done.wanted:.3f} +- {done.allowed:.3f} is right; "
         f"the unit {words}")  # fmt: skip
    if not done.ok:
        raise typer.Exit(1)


@contextlib.contextmanager
def _real(file: CalibrationFile | None) -> Iterator[tuple[Bench, Board]]:
    from ruffini.boards import parse_board
    from ruffini.rig.person import TerminalPerson
    from ruffini.rig.placed_weight import PlacedWeight
    from ruffini.rig.session import Parts, ready_bench

    with open_sensor() as sensor:
        described = sensor.hello.sensors[0]
        if file is not None and described.calibration.sha256 != file.sha256:
            raise RefusedError(f"{sensor.port}: another calibration is in force than the file that was given")
        board = parse_board(described.board_toml, sensor.port)
        parts = Parts(sensor, TerminalPerson(note), reference=PlacedWeight(WEIGHT_SIGMA_G), max_force_n=float("inf"))
        with ready_bench(parts, board, None) as bench:
            yield bench, board


@contextlib.contextmanager
def _simulated(file: CalibrationFile | None, name: str | None, number: int | None) -> Iterator[tuple[Bench, Board]]:
    from ruffini.boards import find_board
    from ruffini.demo.twin_session import TwinOptions, open_simulated
    from ruffini.rig.session import ready_bench
    from ruffini.sim.unit import PadError
    from ruffini.sim.units import fleet_error

    if file is None or name is None:
        raise InputError("--rig sim needs --board and --calibration")
    board = find_board(name)
    error = PadError() if number is None else fleet_error(board, number)
    with contextlib.ExitStack() as stack:
        parts = open_simulated(stack, board, "weights", TwinOptions(error=error, say=note)).parts
        parts.sensor.flash(file.data)
        yield stack.enter_context(ready_bench(parts, board, None)), board
