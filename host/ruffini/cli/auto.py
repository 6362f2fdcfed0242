"""ruffini cal auto: collect, fit, report, flash, judge."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, is_finite, note, progress_bar
from ruffini.cli.device import open_sensor
from ruffini.errors import InputError, RefusedError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.calibrate.auto.run import Opened, Site
    from ruffini.calibrate.container import CalibrationFile
    from ruffini.estimators.task import Task, Turned

SIMULATED = "sim"


def auto(
    board: BoardOption,
    rig: Annotated[str, typer.Option("--rig", help="File of the bench (host/ruffini/rig/README.md), or sim.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for logs, calibrations, pages; given again, goes on. Default: a new one."),
    ] = None,
    previous: Annotated[
        Path | None, typer.Option(help="Calibration that is in force now: kept where the new one is no better.")
    ] = None,
    points: Annotated[
        Path | None, typer.Option(help="Known points of a tube's lens, as of `cal fit --only skin`.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few touches: for a first look and for CI.")] = False,
    depth_mm: Annotated[
        float | None, typer.Option(min=0.05, max=10, help="Deepest press below the contact. Default: the estimator's.")
    ] = None,
    shear_mm: Annotated[
        float | None, typer.Option(min=0, max=5, help="How far it goes sideways. Default: the estimator's.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Plans follow from it.")] = 1,
    unit: Annotated[int, typer.Option(min=0, help="--rig sim: unit of a fleet; 0: as its board file says.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Flash also what fails its gates.")] = False,
    strain: Annotated[
        str | None,
        typer.Option(
            "--strain", help="finite or linear (stage support). Default: finite with a bench, linear with sim."
        ),
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """Collect, fit, report, flash; then press where nothing was pressed before, and say the error before and after."""
    note(f"cal auto: board {board}, {'the simulated bench' if rig == SIMULATED else f'bench {rig}'}")
    from ruffini.boards import find_board
    from ruffini.calibrate import container, keys
    from ruffini.calibrate.auto.page import headline
    from ruffini.calibrate.auto.run import Auto
    from ruffini.estimators.material.prior import has_finite_strain
    from ruffini.estimators.operator.fit import board_slab, finite_strain_of
    from ruffini.estimators.table import task_of
    from ruffini.estimators.task import Turned
    from ruffini.files import only_writer

    at_finite = rig != SIMULATED if strain is None else is_finite(strain)
    found = find_board(board)
    if has_finite_strain(found, is_asked=at_finite):
        finite_strain_of(found, board_slab(found))  # refuses a grid that is too fine before anything is pressed
    elif strain == "finite":
        note(f"board {found.name!r} has no second pass: --strain changes nothing")
    task = task_of(found)
    if isinstance(task, Turned) and rig != SIMULATED:
        task = task.bench
    before = None if previous is None else keys.read_verified(previous)
    if before is not None:
        container.check_board(before, found)
    folder = Path(tempfile.mkdtemp(prefix="ruffini-auto-")) if out is None else out
    with only_writer(folder):
        if isinstance(task, Turned):
            _turned(found, task, folder, before, quick=quick, force=force, json_=json_)
            return
        depth_m = 1e-3 * (task.depth_mm if depth_mm is None else depth_mm)
        shear_m = 1e-3 * (task.shear_mm if shear_mm is None else shear_mm)
        if rig == SIMULATED:
            site = simulated_site(found, task, folder, depth_m, shear_m, unit)
        else:
            site = _real(found, task, Path(rig), depth_m, shear_m, before, points, folder, is_forced=force)
        counts = task.quick if quick else task.whole
        result = Auto(
            found, task, site, folder, counts, seed, note, before, force, is_quick=quick, is_finite=at_finite
        ).run()
    after, mark = result["after"], "SIMULATED, " if site.is_simulated else ""
    n_presses = counts.balls + counts.fitted + counts.judged * (2 if result["before"] else 1)
    emit(
        result, json_,
        f"{found.name}, {mark}{after['touches']} touches that were not collected, against {after['against']}: "
        f"{headline(result)} (up to {after['largest_force_n']:.2f} N); {n_presses} presses, "
        f"{sum(result['seconds'].values()):.0f} s; {folder / 'auto.html'}",
    )  # fmt: skip


def _turned(
    board: Board, task: Turned, folder: Path, before: CalibrationFile | None, *, quick: bool, force: bool, json_: bool
) -> None:
    """Turned under several tools: only the twin's bench does that by itself."""
    from ruffini.calibrate.auto.fingertip import TipAuto, eyes_apart_mm

    result = TipAuto(board, task, folder, eyes_apart_mm(board), note, quick, force, before).run()
    after, mean = result["after"], result["after"]["mean"]
    was = "" if result["before"] is None else f"{1e-3 * result['before']['error']:.3f} N before, now "
    emit(
        result, json_,
        f"{board.name}, SIMULATED, {after['touches']} presses of no fit, {after['told']} of {after['frames']} frames "
        f"told, against {after['against']}: force off by {was}{mean['force_n']:.3f} N, way {mean['way_mm']:.3f} mm, "
        f"angles {mean['roll_deg']:.2f} and {mean['pitch_deg']:.2f} degrees, place {mean['x_mm']:.2f} and "
        f"{mean['y_mm']:.2f} mm; {result['presses']['fitted']} presses fitted, "
        f"{sum(result['seconds'].values()):.0f} s; {folder / 'auto.html'}",
    )  # fmt: skip


def simulated_site(board: Board, task: Task, folder: Path, depth_m: float, shear_m: float, number: int) -> Site:
    from ruffini.calibrate.auto.run import Opened, Site
    from ruffini.calibrate.auto.truth import Truth
    from ruffini.demo.twin_session import TwinOptions, limits_of, open_simulated, reach_of
    from ruffini.rig.program import PROGRAMS
    from ruffini.rig.session import ready_bench
    from ruffini.sim.units import build_unit, fleet_error

    span = task.span(board, depth_m, shear_m, reach_of(board))
    with progress_bar("pad mechanics") as progress:
        unit = build_unit(board, fleet_error(board, number), progress=progress)
    limits = limits_of(board, span, task.ball_mm)

    @contextlib.contextmanager
    def opened(program: str, calibration: CalibrationFile | None, seed: int) -> Iterator[Opened]:
        with contextlib.ExitStack() as stack:
            options = TwinOptions(seed=seed, ball_mm=task.ball_mm, is_hurried=True)
            simulated, truth = open_simulated(stack, board, program, options, unit), Truth()
            simulated.twin.twin.listeners.append(truth.note)
            if calibration is not None:
                simulated.parts.sensor.flash(calibration.data)
            ready = ready_bench(simulated.parts, board, limits if PROGRAMS[program].is_by_stage else None)
            yield Opened(stack.enter_context(ready), truth)

    tip = None if PROGRAMS[task.program].changes_tools else {"shape": "sphere", "radius_m": task.ball_mm / 2e3}
    return Site(opened, span, tip, True, _points(board, folder))


def _points(board: Board, folder: Path) -> Path | None:
    """A twin's known points, as a person reads them off its picture; only a tube's lens needs them."""
    if board.skin is None or board.skin.shape != "tube":
        return None
    from ruffini.sim.optics.known_points import write_known_points

    return write_known_points(board, folder)


def _need_known(active: Any, known: set[bytes]) -> None:
    """Raises RefusedError where the sensor has a calibration that nobody could put back."""
    if active.present and active.sha256 not in known:
        raise RefusedError(
            f"the sensor has a calibration, made {active.created_utc}, which this would replace: give its file with "
            "--previous, so that it is compared with and can be put back, or --force to start over"
        )


def _real(
    board: Board, task: Task, path: Path, depth_m: float, shear_m: float, previous: CalibrationFile | None,
    points: Path | None, folder: Path, *, is_forced: bool,
) -> Site:  # fmt: skip
    from ruffini.calibrate.auto.fingertip import eyes_apart_mm
    from ruffini.calibrate.auto.run import Opened, Site
    from ruffini.estimators.table import task_of
    from ruffini.estimators.task import Turned
    from ruffini.files import write_whole
    from ruffini.rig.person import TerminalPerson
    from ruffini.rig.program import PROGRAMS
    from ruffini.rig.session import open_real, ready_bench
    from ruffini.rig.settings import load_rig
    from ruffini.rig.stop_key import stop_key

    settings = load_rig(path)
    if settings.stage is not None:
        settings.stage.rotary(board)  # refuses a stage that cannot press this board
    if task.needs_ball and (settings.tip is None or settings.tip.shape != "sphere"):
        raise InputError(f"{path}: `cal auto` learns the colours from a ball: give [tip] shape = 'sphere', diameter_mm")
    if task.needs_points and points is None:
        raise InputError("the lens is fitted to known points: give --points FILE (CSV: x_px, y_px, z_mm)")
    span = task.span(board, depth_m, shear_m, settings.limits.reach_m)
    if PROGRAMS[task.program].changes_tools:
        span = settings.with_tools(span, board)
        task.check(span)
    flashed = folder / "flashed.txt"  # what this run put there: it may be stopped and go on

    @contextlib.contextmanager
    def opened(program: str, calibration: CalibrationFile | None, _: int) -> Iterator[Opened]:
        with contextlib.ExitStack() as stack:
            sensor = stack.enter_context(open_sensor())
            known = {bytes.fromhex(line) for line in flashed.read_text().split()} if flashed.exists() else set()
            known |= set() if previous is None else {previous.sha256}
            if not is_forced:
                _need_known(sensor.hello.sensors[0].calibration, known)
            parts = open_real(stack, settings, board, sensor, TerminalPerson(note))
            if calibration is not None:
                write_whole(flashed, "\n".join(sha.hex() for sha in known | {calibration.sha256}).encode())
                parts.sensor.flash(calibration.data)
            key = stack.enter_context(stop_key())
            limits = settings.limits.limits if PROGRAMS[program].is_by_stage else None
            yield Opened(stack.enter_context(ready_bench(parts, board, limits, key)), None)

    tip = None if span.tools else settings.tip
    shape = None if tip is None else {"shape": tip.shape, "radius_m": tip.diameter_mm / 2e3}
    baseline_mm = eyes_apart_mm(board) if isinstance(task_of(board), Turned) else None
    return Site(opened, span, shape, False, points, baseline_mm)
