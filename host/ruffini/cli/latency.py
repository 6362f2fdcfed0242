"""ruffini latency: from the end of the exposure to the last byte on this computer."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit
from ruffini.cli.device import open_sensor
from ruffini.errors import InputError

KNOWN = ("wrench", "field", "contacts", "depth", "markers", "residual")


def latency(
    n: Annotated[int, typer.Option("--n", min=2, help="Frames that are measured.")] = 1000,
    types: Annotated[str, typer.Option("--types", help="Messages of each frame, of which the last counts.")] = "wrench",
    json_: JsonFlag = False,
) -> None:
    """From the end of the exposure to the last byte: percentiles, jitter, frames that are missing or late."""
    from ruffini.boards import parse_board
    from ruffini.device.latency import summarize, watch

    wanted = [name.strip().lower() for name in types.split(",")]
    if unknown := [name for name in wanted if name not in KNOWN]:
        raise InputError(f"--types {','.join(unknown)}: give some of {', '.join(KNOWN)}, with commas")
    with open_sensor() as sensor:
        board = parse_board(sensor.hello.sensors[0].board_toml, sensor.port)
        half_us = board.exposure.time_us // 2 if board.exposure is not None else None
        watched = watch(sensor, n, wanted, 1000 * (half_us or 0))
        line = "pseudo-terminal" if os.path.realpath(sensor.port).startswith("/dev/pts/") else "serial port"
        seen = summarize(watched.ages, 1e6 / board.camera.rate_mhz)
    kind = " SIMULATED" * watched.is_simulated + " REPLAY" * watched.is_replay
    where = "end" if half_us is not None else "middle"
    start = f"the {where} of the exposure" + (" (no [exposure] in board.toml)" if half_us is None else "")
    last = "--" if seen.p999_ms is None else f"{seen.p999_ms:.2f}"
    emit(
        {"board": board.board.name, "port": sensor.port, "line": line, "source": kind.split(), "types": wanted,
         "from": where, **asdict(seen)},
        json_,
        f"{board.board.name} on a {line}{kind}: {seen.n_frames} frames, {' and '.join(wanted)}, from {start}\n"
        f"  p50 {seen.p50_ms:.2f}  p99 {seen.p99_ms:.2f}  p99.9 {last}  largest {seen.largest_ms:.2f}  "
        f"jitter {seen.jitter_ms:.2f} ms (all +- {seen.clock_error_ms:.2f}: the clocks)\n"
        f"  {seen.n_missing} missing, {seen.n_late} later than a frame's {seen.interval_ms:.2f} ms",
    )  # fmt: skip
