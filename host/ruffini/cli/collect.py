"""The verb that presses: touches with a reference beside them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar
from ruffini.cli.device import open_sensor
from ruffini.cli.view import HTTP_PORT
from ruffini.errors import InputError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.demo.twin_session import TwinOptions
    from ruffini.rig.bench import Bench
    from ruffini.rig.guarded_stage import Limits
    from ruffini.rig.program import Span
    from ruffini.rig.settings import RigSettings
    from ruffini.view.guided import GuidingPage

SIMULATED, SCALE = "sim", "scale"  # kinds of rigs
LOG = "log"  # the program whose reference another program writes
NO_SHEAR = "A scale measures no shear: it follows from the pad's mechanics, with the uncertainty in the stream"


def collect(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Log (HDF5) to write; run again after a stop to go on with it.")],
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            help="File of the bench (host/ruffini/rig/README.md); scale: a kitchen scale under the sensor, read by a "
            "person; or sim.",
        ),
    ],
    program: Annotated[
        str | None,
        typer.Option(
            help="grid (depth and shear), balls (straight presses), indenters (a person mounts one after the other), "
            "or by hand: weights, scale, free, conditions, log (the reference is a CSV of another program). "
            "Default: what the board's estimator is fitted to."
        ),
    ] = None,
    n: Annotated[int | None, typer.Option("--n", min=1, help="Touches. Default: 20, conditions 18.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="6 touches, for a first look.")] = False,
    depth_mm: Annotated[
        float | None, typer.Option(min=0.05, max=10, help="Deepest press below the contact. Default: the estimator's.")
    ] = None,
    shear_mm: Annotated[
        float | None, typer.Option(min=0, max=5, help="How far it goes sideways (grid). Default: the estimator's.")
    ] = None,
    hold_s: Annotated[
        float,
        typer.Option(min=0.5, max=60, help="How long each touch is held (grid, balls); 3 tells a gel's relaxation."),
    ] = 0.5,
    grams: Annotated[str, typer.Option(help="weights, scale: which, in grams.")] = "20,50,100,200",
    force_n: Annotated[float, typer.Option(min=0.1, help="free, conditions: largest force by hand.")] = 2.0,
    torque_nmm: Annotated[float, typer.Option(min=0.1, help="conditions: largest moment by hand.")] = 10.0,
    normal_n: Annotated[
        float | None, typer.Option(min=0.1, help="conditions: largest normal force. Default: as --force-n.")
    ] = None,
    known_grams: Annotated[
        float | None, typer.Option(min=1, help="First a weight of so much on the pad: is the reference's unit right?")
    ] = None,
    seed: Annotated[int, typer.Option(help="The plan follows from it.")] = 1,
    calibration: Annotated[Path | None, typer.Option(help="Flashed first (--rig sim: needed for forces).")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print every move, move nothing.")] = False,
    view: Annotated[
        bool, typer.Option("--view", help="Guide in the browser, too: where to press next, how hard, how good it is.")
    ] = False,
    http_port: Annotated[int, typer.Option(min=0, max=65535, help="--view: port for the page (0 = any).")] = HTTP_PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="--view: print the address, open nothing.")] = False,
    ball_mm: Annotated[
        float | None, typer.Option(help="--rig sim: diameter of the ball. Default: the estimator's.")
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option(help="By hand: what presses, in a word; logs of five tips tell how much another one differs."),
    ] = None,
    machine: Annotated[str, typer.Option(help="--rig sim: marlin or grbl.")] = "marlin",
    unit: Annotated[int | None, typer.Option(help="--rig sim: unit of a fleet, off its board file.")] = None,
    modulus: Annotated[float, typer.Option(help="--rig sim: the pad's modulus over the board's.")] = 1.0,
    thickness: Annotated[float, typer.Option(help="--rig sim: likewise its thickness.")] = 1.0,
    json_: JsonFlag = False,
) -> None:
    """Press the pad along a plan, or have it pressed, and keep what sensor and reference saw."""
    note(f"cal collect: board {board}")
    from ruffini.boards import find_board
    from ruffini.demo.twin_session import MACHINES, TwinOptions
    from ruffini.estimators.material.prior import has_finite_strain
    from ruffini.estimators.table import pressed_for
    from ruffini.rig import collect as collecting
    from ruffini.rig.log_file import LogWriter
    from ruffini.rig.program import PROGRAMS, Program, Touch, check_weights, plan, setups_left_out, span_of

    found = find_board(board)
    settings = None if rig == SIMULATED else _settings(rig)
    task = pressed_for(found, is_simulated=settings is None)
    if program is None:
        usual = next(one.name for one in PROGRAMS.values() if one.is_of_scale == (rig == SCALE))
        program = usual if rig == SCALE or PROGRAMS[task.program].items is None else task.program
    asked = PROGRAMS.get(program, Program(program))
    depth_mm = task.depth_mm if depth_mm is None else depth_mm
    shear_mm = task.shear_mm if shear_mm is None else shear_mm
    ball_mm = task.ball_mm if ball_mm is None else ball_mm
    if machine not in MACHINES:
        raise InputError(f"--machine {machine!r}: choose {' or '.join(MACHINES)}")
    options = TwinOptions(machine, ball_mm, seed, _error(found, unit, modulus, thickness), say=note)
    span = (task.span if asked.changes_tools else span_of)(
        found, depth_mm * 1e-3, shear_mm * 1e-3, _reach(settings, found)
    )
    if asked.changes_tools:
        if settings is not None:
            span = settings.with_tools(span, found)
            if program == task.program:
                task.check(span)
        elif program != task.program:
            raise InputError(f"--rig sim has no indenters for board {found.name!r}: take program {task.program}")
    if rig == SCALE and asked.is_of_scale:
        span = span.inside(task.scale_part or 1.0)
    count = n or (6 if quick else asked.n)
    if asked.is_of_csv:
        if view:
            raise InputError(f"--view guides along a plan, and program {program!r} has none")
        return _by_log(found, settings, out, calibration, options, json_, dry_run=dry_run)
    if asked.changes_tools and (missing := setups_left_out(span, count)):
        note(missing)
    items = plan(program, span, count, seed, _by_hand(grams, force_n, torque_nmm, normal_n))
    if asked.is_of_scale and settings is not None:
        check_weights(items, settings.limits.max_force_n)
    items = [item._replace(hold_s=hold_s) if isinstance(item, Touch) else item for item in items]
    limits = _limits(settings, found, span, ball_mm) if asked.is_by_stage else None
    result: dict[str, Any] = {"file": str(out), "touches": count, "program": program, "simulated": rig == SIMULATED}
    if limits is not None or dry_run:
        rehearsal = collecting.rehearse(items, limits)
        if dry_run:
            emit({**result, "state": "dry-run", "least_s": rehearsal.least_s, "moves_m": rehearsal.places.tolist()},
                 json_, "\n".join([*rehearsal.lines, f"{count} touches, {rehearsal.least_s:.0f} s at least, none out "
                                   "of the limits; nothing moved"]))  # fmt: skip
            return
    presses = None if asked.changes_tools else _tip(settings, ball_mm, tip)
    log = LogWriter(out, {"board": found.name, "program": program, "seed": seed, "n": count, "depth_mm": depth_mm,
                          "shear_mm": shear_mm, "rig": rig, "tip": presses, **span.facts})  # fmt: skip
    n_before = len(log.done())
    strain = " --strain finite" if rig != SIMULATED and has_finite_strain(found, is_asked=True) else ""
    next_step = f"Next: ruffini cal fit {out} --board {board}{strain} --out calibration.safetensors"
    if asked.is_of_scale and "force_x" not in found.board.not_measured:
        next_step += f". {NO_SHEAR}"
    page = _page(f"{program} on {found.name}", next_step, http_port, opens=not no_browser) if view else None
    with _bench(settings, found, program, limits, calibration, options, page) as bench, progress_bar("touches") as bar:

        def tell(p: collecting.Progress) -> None:
            bar(p.n_done / p.n_total)
            note(f"{p.n_done}/{p.n_total} {p.text}")

        n_redone = collecting.collect(bench, items, log, known_grams=known_grams, tell=tell)
    mark = ", SIMULATED" if rig == SIMULATED else ""
    emit({**result, "state": "complete", "kept": n_before, "redone": n_redone}, json_,
         f"{out}: {count} touches ({n_before} were there, {n_redone} done again){mark}")  # fmt: skip


def _by_log(
    board: Board, settings: RigSettings | None, out: Path, calibration: Path | None, options: TwinOptions,
    json_: bool, *, dry_run: bool,
) -> None:  # fmt: skip
    """Program log: stream first, then the CSV."""
    from ruffini.calibrate import container
    from ruffini.demo.twin_session import open_logged
    from ruffini.rig.by_log import join, record
    from ruffini.rig.log_file import LogWriter
    from ruffini.rig.person import TerminalPerson
    from ruffini.rig.session import SensorParts, watched_stream
    from ruffini.rig.settings import CsvSettings

    if settings is not None and not isinstance(settings.reference, CsvSettings):
        raise InputError(f"program {LOG!r} reads a CSV: give kind = 'csv' and path in [reference]")
    if dry_run:
        emit({"file": str(out), "program": LOG, "state": "dry-run"}, json_, "a person presses; nothing moved")
        return
    log = LogWriter(out, {"board": board.name, "program": LOG, "tip": _tip(settings, options.ball_mm)})
    gauges = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(log.locked())
        if settings is None:
            parts, path = open_logged(stack, board, options, log.side_file("reference.csv"))
            note(f"SIMULATED bench of {board.name}")
        else:
            assert isinstance(settings.reference, CsvSettings)
            path, gauges = Path(settings.reference.path), settings.reference.gauges()
            parts = SensorParts(stack.enter_context(open_sensor()), TerminalPerson(note))
        if calibration is not None:
            parts.sensor.flash(container.read(calibration).data)
        watched = stack.enter_context(watched_stream(parts.sensor, board, parts.pace))
        record(watched.stream, parts.person, log, watched.session)
        joined = join(log, path, watched.bad_flags, longest_gap_s=parts.pace.longest_gap_s, gauges=gauges)
    for fault in joined.faults:
        note(f"left out: {fault}")
    mark = ", SIMULATED" if settings is None else ""
    emit({"file": str(out), "program": LOG, "state": "complete", "touches": joined.n_touches,
          "left_out": joined.faults, "simulated": settings is None}, json_,
         f"{out}: {joined.n_touches} touches ({len(joined.faults)} left out){mark}")  # fmt: skip


def convert(
    csv: Annotated[Path, typer.Argument(help="CSV with a column of time, the wrench, displacements of markers.")],
    out: Annotated[Path, typer.Option("--out", help="Log (HDF5) to write.")],
    columns: Annotated[
        Path | None, typer.Option("--columns", help="TOML: our names of its columns (host/ruffini/rig/README.md).")
    ] = None,
    board: Annotated[
        str | None, typer.Option("--board", help="Board that it is of: displacements also at its nodes.")
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """Make a calibration log of a CSV that another program wrote."""
    from ruffini.boards import find_board
    from ruffini.rig.convert import convert as converted
    from ruffini.rig.log_file import write_log

    if out.exists():
        raise InputError(f"{out} exists: choose another name, or remove it")
    log = converted(csv, columns, None if board is None else find_board(board))
    write_log(out, log)
    arrays = sorted(log.touches[0].arrays)
    emit({"file": str(out), "touches": len(log.touches), "arrays": arrays}, json_,
         f"{out}: {len(log.touches)} touches of {csv.name}")  # fmt: skip


def _settings(rig: str) -> RigSettings:
    from ruffini.rig.settings import load_rig, scale_rig

    return scale_rig() if rig == SCALE else load_rig(Path(rig))


def _by_hand(grams: str, force_n: float, torque_nmm: float, normal_n: float | None) -> Any:
    from ruffini.rig.program import ByHand

    try:
        weights = tuple(float(g) for g in grams.split(","))
    except ValueError:
        raise InputError(f"--grams {grams!r}: give weights, e.g. 20,50,100") from None
    return ByHand(weights, force_n, torque_nmm * 1e-3, normal_n)


def _error(board: Board, unit: int | None, modulus: float, thickness: float) -> Any:
    """How the simulated pad is off its board file."""
    from ruffini.sim.unit import PadError
    from ruffini.sim.units import fleet_error

    drawn = PadError() if unit is None else fleet_error(board, unit)
    return PadError(drawn.modulus * modulus, drawn.poisson, drawn.thickness * thickness)


def _tip(settings: RigSettings | None, ball_mm: float, name: str | None = None) -> dict[str, Any] | None:
    if settings is None:
        return {"shape": "sphere", "radius_m": ball_mm / 2e3}
    if settings.tip is None:
        return None if name is None else {"name": name}
    if name is not None:
        raise InputError(f"--tip {name}: the bench's file describes the tip in [tip]; leave the option out")
    return {"shape": settings.tip.shape, "radius_m": settings.tip.diameter_mm / 2e3}


def _reach(settings: RigSettings | None, board: Board) -> tuple[float, float] | None:
    from ruffini.demo.twin_session import reach_of

    return reach_of(board) if settings is None else settings.limits.reach_m


def _limits(settings: RigSettings | None, board: Board, span: Span, ball_mm: float) -> Limits:
    from ruffini.demo.twin_session import limits_of

    if settings is None:
        return limits_of(board, span, ball_mm)
    if settings.stage is not None:
        settings.stage.rotary(board)  # refuses a stage that cannot press this board, also in a dry run
    return settings.limits.limits


@contextlib.contextmanager
def _bench(
    settings: RigSettings | None, board: Board, program: str, limits: Limits | None, calibration: Path | None,
    options: TwinOptions, page: GuidingPage | None,
) -> Iterator[Bench]:  # fmt: skip
    """The bench, homed and at rest; the page beside it ends with it."""
    from dataclasses import replace

    from ruffini.calibrate import container
    from ruffini.demo.twin_session import open_simulated
    from ruffini.rig.person import TerminalPerson
    from ruffini.rig.session import open_real, ready_bench
    from ruffini.rig.stop_key import stop_key

    with contextlib.ExitStack() as stack:
        if settings is None:
            with progress_bar("pad mechanics") as progress:
                parts = open_simulated(stack, board, program, replace(options, progress=progress)).parts
            note(f"SIMULATED bench of {board.name}")
        else:
            person = TerminalPerson(note, page=page.keys if page else None)
            parts = open_real(stack, settings, board, stack.enter_context(open_sensor()), person)
        if calibration is not None:
            parts.sensor.flash(container.read(calibration).data)
        key = stack.enter_context(stop_key())
        if page is None:
            yield stack.enter_context(ready_bench(parts, board, limits, key))
            return
        stack.enter_context(page.shown(parts.sensor))
        parts = replace(parts, person=page.heard(parts.person))
        bench = stack.enter_context(ready_bench(parts, board, limits, page.guard(key)))
        page.look_at(bench)
        yield bench


def _page(program: str, next_step: str, http_port: int, *, opens: bool) -> GuidingPage:
    import webbrowser

    from ruffini.view.guided import GuidingPage

    def ready(address: str) -> None:
        note(f"page: {address}")
        if opens:
            webbrowser.open(address)

    return GuidingPage(program, next_step, http_port, ready)
