"""`--rig sim`: the real daemon on a pty, a board's twin as its camera, an emulated machine or person, a reference."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ruffini import host_clock
from ruffini.boards import Board
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.rig.emulated_dialects import EmulatedGrbl, EmulatedMarlin
from ruffini.rig.emulated_machine import EmulatedMachine
from ruffini.rig.emulated_person import EmulatedPerson
from ruffini.rig.emulated_references import (
    ASKEW,
    BOLTED,
    BOLTED_ARM_M,
    FULL_SCALE,
    SIGMA,
    EmulatedLogger,
    EmulatedPage,
    EmulatedTextCell,
    Mount,
)
from ruffini.rig.frame_clock import FrameClock
from ruffini.rig.grbl import Grbl
from ruffini.rig.guarded_stage import Limits
from ruffini.rig.marlin import Marlin
from ruffini.rig.network_cell import NetworkCell, fetch_settings
from ruffini.rig.placed_weight import PlacedWeight
from ruffini.rig.program import PROGRAMS, Program, Span
from ruffini.rig.reference import Reference
from ruffini.rig.session import Pace, Parts, SensorParts
from ruffini.rig.stage import Stage
from ruffini.rig.text_cell import TextCell
from ruffini.rig.turned import Turned
from ruffini.rig.twin_bench import MAX_FORCE_N, ORIGIN, Hanging, Loader, TwinBench, build_twin_bench, surface_m
from ruffini.sim.indenters import Indenter
from ruffini.sim.rig import Unit
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import PadError, Progress
from ruffini.sim.units import build_unit

TOP_MM = 2.0  # over the pad
NEAR_MM = 0.3  # from there on it goes slowly
SLACK_M = 1e-4  # of the limits, beside the plan
BELOW_MM = 1.2  # the pad, where a contact is still looked for
LOGGER_OFFSET_S, LOGGER_DRIFT = 1234.5, 150e-6  # of the other program's clock
DOME_PART = 0.28  # of a dome's radius, along x and y: further out a straight press slides off
MACHINES: dict[str, tuple[type[EmulatedMachine], Callable[[str], Stage]]] = {
    "marlin": (EmulatedMarlin, Marlin),
    "grbl": (EmulatedGrbl, Grbl),
}
# How fast a body's mechanics and pictures can be made on a busy computer of two cores.
PACES = {
    "plane": Pace(20.0, stall_s=15.0, longest_gap_s=8.0, max_hold_s=30.0, image_bytes_per_s=1e6),
    "dome": Pace(3.0, stall_s=30.0, longest_gap_s=20.0, max_hold_s=90.0, image_bytes_per_s=1e6),
    "tube": Pace(1.0, stall_s=60.0, longest_gap_s=40.0, max_hold_s=180.0, image_bytes_per_s=1e6),
}
REFERENCE_HZ = {"plane": 2.0, "dome": 0.8, "tube": 0.3}  # stated: how long a silence is waited for is real time, always
# By simulated time no computer is too slow, but a frame of a tube takes half a second to make: one of so many is made.
HURRIED_STEP = {"tube": 6}


@dataclass(frozen=True)
class TwinOptions:
    """What a simulated bench is made of."""

    machine: str = "marlin"
    ball_mm: float = 6.0
    seed: int = 1
    error: PadError = field(default_factory=PadError)
    mount: Mount | None = None  # None: askew; BOLTED to a connector, as its drawing says
    is_hurried: bool = False  # by simulated time, as fast as this computer goes, and not by real time
    say: Callable[[str], None] = lambda _: None
    progress: Progress = lambda _: None


@dataclass
class Simulated:
    """Parts that can be disturbed, beside those that a bench needs."""

    parts: Parts
    twin: TwinBench
    machine: EmulatedMachine | None
    text_cell: EmulatedTextCell | None
    clock: FrameClock | None  # of a hurried bench


def reach_of(board: Board) -> tuple[float, float] | None:
    """How far from the centre a twin can be pressed straight, metres along x and y; None: all over.

    Raises
    ------
    InputError
        The board has no twin.
    """
    shape = load_twin(board).shape
    return (1e-6 * shape.radius_um * DOME_PART,) * 2 if shape.kind == "dome" else None


def limits_of(board: Board, span: Span, ball_mm: float) -> Limits:
    """Soft limits of a simulated bench, about what a plan touches."""
    half_x_m, half_y_m = span.half_x_m + span.shear_m + SLACK_M, span.half_y_m + span.shear_m + SLACK_M
    drop_m = -surface_m(load_twin(board).shape, ball_mm / 2e3, half_x_m, half_y_m)
    bottom_m = -(drop_m + 1e-3 * BELOW_MM + span.deepest_m)
    return Limits(half_x_m, half_y_m, 1e-3 * TOP_MM, bottom_m, span.deepest_m, MAX_FORCE_N, 1e-3 * NEAR_MM)


def open_simulated(
    stack: contextlib.ExitStack, board: Board, program: str, options: TwinOptions, unit: Unit | None = None
) -> Simulated:
    """A bench for a program on a board's twin, or on a unit that is there; `stack` ends it.

    Raises
    ------
    InputError
        The board has no twin.
    """
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ruffini-")))
    unit = unit or build_unit(board, options.error, progress=options.progress)
    played = PROGRAMS[program]
    reference_hz = played.reference_hz or REFERENCE_HZ[unit.twin.shape.kind]
    kind, indenter = unit.twin.shape.kind, Indenter("sphere", options.ball_mm / 2e3)
    pace, clock = PACES[kind], None
    if options.is_hurried:
        period_s, step = 1e3 / board.camera.rate_mhz, played.frame_step or HURRIED_STEP.get(kind, 1)
        clock, pace = FrameClock(period_s, step=step), pace._replace(frame_hz=1 / (period_s * step))
    stack.enter_context(host_clock.lent(clock) if clock else contextlib.nullcontext())
    emulated, driver = MACHINES[options.machine]
    machine = stack.enter_context(emulated()) if played.is_by_stage else None
    person = EmulatedPerson(options.seed, options.say)
    loader: Loader = person if machine is None else Hanging(machine, unit, indenter)
    twin = build_twin_bench(
        unit,
        indenter,
        loader,
        folder / "twin",
        options.seed,
        rate_hz=reference_hz,
        mount=options.mount or (BOLTED if played.is_bolted else ASKEW),
        clock=clock,
    )
    stack.enter_context(twin.server)
    if clock:
        stack.callback(clock.stop)
    stack.enter_context(twin.cell)
    assert board.folder is not None
    mode = ["--lockstep"] if clock else []
    port = stack.enter_context(running_daemon(board.folder, f"twin:{folder / 'twin'}", folder / "store", *mode))
    sensor = stack.enter_context(Connection(port))
    stage: Stage | None = None
    if machine is not None:
        stage = driver(machine.port)
        stack.callback(stage.close)
    text_cell = stack.enter_context(EmulatedTextCell(options.seed)) if kind == "tube" else None
    page = stack.enter_context(EmulatedPage(reference_hz))
    reference = _reference(twin, text_cell, page, played, reference_hz)
    if played.is_bolted and options.mount is None:
        reference = Turned(reference, np.eye(3), BOLTED_ARM_M)
    parts = Parts(sensor, person, pace, reference=reference, max_force_n=MAX_FORCE_N, stage=stage, origin=ORIGIN,
                  mount=twin.twin.mount)  # fmt: skip
    return Simulated(parts, twin, machine, text_cell, clock)


def open_logged(
    stack: contextlib.ExitStack, board: Board, options: TwinOptions, csv: Path, unit: Unit | None = None
) -> tuple[SensorParts, Path]:
    """A sensor that a person presses while another program writes the reference to `csv`, by a clock of its own."""
    simulated = open_simulated(stack, board, "log", options, unit)
    logger = EmulatedLogger(csv, options.seed, offset_s=LOGGER_OFFSET_S, drift=LOGGER_DRIFT)
    simulated.twin.twin.listeners.append(logger.measure)
    simulated.parts.reference.close()
    return SensorParts(simulated.parts.sensor, simulated.parts.person, simulated.parts.pace), csv


def _reference(
    twin: TwinBench, text_cell: EmulatedTextCell | None, page: EmulatedPage, program: Program, rate_hz: float
) -> Reference:
    """Weights are their own reference; a tube's paper has a cell on the tip, which has one axis; the others six."""
    if program.weight_sigma_g is not None:
        return PlacedWeight(program.weight_sigma_g)
    if text_cell is not None:
        twin.twin.listeners.append(text_cell.measure)
        return TextCell(text_cell.port, "N", float(FULL_SCALE[2]), float(SIGMA[2]), rate_hz=rate_hz)
    settings = fetch_settings("127.0.0.1", page.server_port)
    return NetworkCell("127.0.0.1", FULL_SCALE, SIGMA, settings=settings, port=twin.cell.port)
