"""ruffini cal auto: collect, fit, report, flash, judge."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note
from ruffini.cli.device import open_sensor
from ruffini.errors import InputError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.calibrate.container import CalibrationFile
    from ruffini.demo.auto import Opened, Site
    from ruffini.demo.twin_session import TwinOptions

SIMULATED = "sim"


def auto(
    board: BoardOption,
    rig: Annotated[str, typer.Option("--rig", help="File of the bench (host/ruffini/rig/README.md), or sim.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Folder for logs, calibrations and the page; given again, goes on. Default: a new one."
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few touches: for a first look and for CI.")] = False,
    depth_mm: Annotated[float, typer.Option(min=0.05, max=10, help="Deepest press below the contact.")] = 0.8,
    shear_mm: Annotated[float, typer.Option(min=0, max=5, help="How far it goes sideways.")] = 0.3,
    seed: Annotated[int, typer.Option(help="Plans follow from it.")] = 1,
    unit: Annotated[int, typer.Option(help="--rig sim: unit of a fleet, off its board file.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Flash also what fails its gates.")] = False,
    json_: JsonFlag = False,
) -> None:
    """Collect, fit, report, flash; then press where nothing was pressed before, and say the error before and after."""
    from ruffini.boards import find_board
    from ruffini.demo.auto import QUICK, WHOLE, Auto, need_estimators

    found = find_board(board)
    need_estimators(found)
    folder = Path(tempfile.mkdtemp(prefix="ruffini-auto-")) if out is None else out
    folder.mkdir(parents=True, exist_ok=True)
    if rig == SIMULATED:
        site = _simulated(found, depth_mm, shear_mm, seed, unit)
    else:
        site = _real(found, Path(rig), depth_mm, shear_mm)
    result = Auto(found, site, folder, QUICK if quick else WHOLE, seed, note, force).run()
    before, after = result["before"], result["after"]
    n_presses = sum(n for name, n in result["presses"].items() if name != "error_touches")
    mark = "SIMULATED, " if site.is_simulated else ""
    emit(
        {**result, "quick": quick}, json_,
        f"{found.name}, {mark}{after['touches']} touches that were not collected, against {after['against']}: force "
        f"off by {1e3 * before['force_rmse_n']:.1f} mN RMS before, {1e3 * after['force_rmse_n']:.1f} mN after "
        f"(up to {after['largest_force_n']:.2f} N); {n_presses} presses, {result['total_s']:.0f} s; "
        f"{folder / 'report.html'}",
    )  # fmt: skip


def _simulated(board: Board, depth_mm: float, shear_mm: float, seed: int, number: int) -> Site:
    from ruffini.demo.auto import Opened, Site, Truth
    from ruffini.demo.twin_session import TwinOptions, limits_of, open_simulated, reach_of
    from ruffini.rig.program import span_of
    from ruffini.rig.session import ready_bench
    from ruffini.sim.units import build_unit, fleet_error

    options: TwinOptions = TwinOptions(seed=seed)
    span = span_of(board, depth_mm * 1e-3, shear_mm * 1e-3, reach_of(board))
    unit = build_unit(board, fleet_error(board, number))
    limits = limits_of(board, span, options.ball_mm)

    @contextlib.contextmanager
    def opened(program: str, calibration: CalibrationFile) -> Iterator[Opened]:
        with contextlib.ExitStack() as stack:
            simulated, truth = open_simulated(stack, board, program, options, unit), Truth()
            simulated.twin.twin.listeners.append(truth.note)
            simulated.parts.sensor.flash(calibration.data)
            yield Opened(stack.enter_context(ready_bench(simulated.parts, board, limits)), truth)

    return Site(opened, span, {"shape": "sphere", "radius_m": options.ball_mm / 2e3}, True)


def _real(board: Board, path: Path, depth_mm: float, shear_mm: float) -> Site:
    from ruffini.demo.auto import Opened, Site
    from ruffini.rig.person import TerminalPerson
    from ruffini.rig.program import span_of
    from ruffini.rig.session import open_real, ready_bench
    from ruffini.rig.settings import load_rig
    from ruffini.rig.stop_key import stop_key

    settings = load_rig(path)
    if settings.tip is None or settings.tip.shape != "sphere":
        raise InputError(f"{path}: `cal auto` learns the colours from a ball: give [tip] shape = 'sphere', diameter_mm")
    span = span_of(board, depth_mm * 1e-3, shear_mm * 1e-3, settings.limits.reach_m)

    @contextlib.contextmanager
    def opened(_: str, calibration: CalibrationFile) -> Iterator[Opened]:
        with contextlib.ExitStack() as stack:
            parts = open_real(stack, settings, stack.enter_context(open_sensor()), TerminalPerson(note))
            parts.sensor.flash(calibration.data)
            key = stack.enter_context(stop_key())
            yield Opened(stack.enter_context(ready_bench(parts, board, settings.limits.limits, key)), None)

    return Site(opened, span, {"shape": "sphere", "radius_m": settings.tip.diameter_mm / 2e3}, False)
