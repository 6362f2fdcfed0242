"""The verb that presses: touches with a reference beside them."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar
from ruffini.cli.device import open_sensor

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.device import Connection
    from ruffini.rig.collect import Bench
    from ruffini.rig.guarded_stage import Limits
    from ruffini.rig.reference import Reference
    from ruffini.rig.stage import Place, Stage

NO_REFERENCE = "FLAG_NO_REFERENCE"
BAD_FLAGS = (NO_REFERENCE, "FLAG_MARKERS_LOST", "FLAG_SATURATED", "FLAG_OVER_RANGE", "FLAG_DARK", "FLAG_OVEREXPOSED")
REST_MARGIN_MM = (3.0, -1.5)  # of the simulated bench: above and below the pad


def collect(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Log (HDF5) to write; run again after a stop to go on with it.")],
    rig: Annotated[str, typer.Option("--rig", help="File of the bench (host/ruffini/rig/README.md), or sim.")],
    program: Annotated[str, typer.Option(help="grid (depth and shear) or balls (straight presses).")] = "grid",
    n: Annotated[int, typer.Option("--n", min=1, help="Touches.")] = 20,
    depth_mm: Annotated[float, typer.Option(min=0.05, max=10, help="Deepest press below the contact.")] = 0.8,
    shear_mm: Annotated[float, typer.Option(min=0, max=5, help="How far it goes sideways (grid).")] = 0.3,
    seed: Annotated[int, typer.Option(help="The plan follows from it.")] = 1,
    calibration: Annotated[Path | None, typer.Option(help="Flashed first (--rig sim: needed for forces).")] = None,
    ball_mm: Annotated[float, typer.Option(help="Diameter of the simulated ball.")] = 6.0,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check the plan against the limits, move nothing.")
    ] = False,
    json_: JsonFlag = False,
) -> None:
    """Press the pad along a plan and keep what sensor and reference saw."""
    from ruffini.boards import find_board
    from ruffini.rig import collect as collecting
    from ruffini.rig.log_file import LogWriter
    from ruffini.rig.program import plan, span_of

    found = find_board(board)
    touches = plan(program, span_of(found, depth_mm * 1e-3, shear_mm * 1e-3), n, seed)
    limits = _limits(rig, found, depth_mm, shear_mm)
    least_s = collecting.rehearse(touches, limits)
    result: dict[str, Any] = {"file": str(out), "touches": n, "program": program, "simulated": rig == "sim"}
    if dry_run:
        emit({**result, "state": "dry-run", "least_s": least_s}, json_,
             f"{n} touches, {least_s:.0f} s at least, none out of the limits; nothing moved")  # fmt: skip
        return
    log = LogWriter(out, {"board": found.name, "program": program, "seed": seed, "n": n, "depth_mm": depth_mm,
                          "shear_mm": shear_mm, "rig": rig})  # fmt: skip
    n_before = len(log.done())
    with _bench(rig, found, limits, calibration, ball_mm, seed) as bench, progress_bar("touches") as bar:

        def tell(p: collecting.Progress) -> None:
            bar(p.n_done / p.n_total)
            note(f"{p.n_done}/{p.n_total} {p.text}")

        n_redone = collecting.collect(bench, touches, log, tell=tell)
    mark = ", SIMULATED" if rig == "sim" else ""
    emit({**result, "state": "complete", "kept": n_before, "redone": n_redone}, json_,
         f"{out}: {n} touches ({n_before} were there, {n_redone} done again){mark}")  # fmt: skip


def _limits(rig: str, board: Board, depth_mm: float, shear_mm: float) -> Limits:
    from ruffini.rig.guarded_stage import Limits
    from ruffini.rig.settings import load_rig
    from ruffini.rig.twin_bench import MAX_FORCE_N

    if rig != "sim":
        return load_rig(Path(rig)).limits.limits
    half = (board.pad.size_x_um * 0.5e-6, board.pad.size_y_um * 0.5e-6)
    top_m, bottom_m = (1e-3 * v for v in REST_MARGIN_MM)
    return Limits(*half, top_m, bottom_m - 1e-3 * depth_mm, 1e-3 * depth_mm, MAX_FORCE_N)


@contextlib.contextmanager
def _bench(
    rig: str, board: Board, limits: Limits, calibration: Path | None, ball_mm: float, seed: int
) -> Iterator[Bench]:
    """The bench, homed, tared and at rest."""
    from ruffini.rig.collect import Bench
    from ruffini.rig.guarded_stage import GuardedStage, force_guard
    from ruffini.rig.stop_key import stop_key
    from ruffini.rig.stream_watch import StreamWatch
    from ruffini.rig.watch import Watch

    with contextlib.ExitStack() as stack:
        parts = _simulated(stack, board, ball_mm, seed) if rig == "sim" else _real(stack, Path(rig))
        sensor, reference, stage, origin = parts
        if calibration is not None:
            sensor.flash(calibration.read_bytes())
        names = {1 << i: sensor.schema.enum_names("FlagBit", 1 << i) for i in range(32)}
        bits = {found[0]: bit for bit, found in names.items() if found and found[0] in BAD_FLAGS}
        stream = stack.enter_context(StreamWatch(sensor))
        watch = stack.enter_context(Watch(reference))
        stage.home()
        stream.wait_for_rest(bits[NO_REFERENCE])
        watch.tare()
        key = stack.enter_context(stop_key())
        guards = [key, force_guard("the sensor", stream.force, limits.max_force_n)]
        guarded = GuardedStage(stage, origin, limits, lambda: watch.latest().wrench, guards,
                               fresh_force_of=lambda: watch.fresh().wrench)  # fmt: skip
        yield Bench(guarded, watch, stream, {bit: name.removeprefix("FLAG_").lower() for name, bit in bits.items()})


Parts = tuple["Connection", "Reference", "Stage", "Place"]


def _real(stack: contextlib.ExitStack, path: Path) -> Parts:
    from ruffini.rig.settings import load_rig

    settings = load_rig(path)
    sensor = stack.enter_context(open_sensor())
    stage = settings.stage.open()
    stack.callback(stage.close)
    return sensor, settings.reference.open(), stage, settings.stage.origin


def _simulated(stack: contextlib.ExitStack, board: Board, ball_mm: float, seed: int) -> Parts:
    """The real daemon on a pty, the twin as its camera, an emulated machine and force/torque sensor."""
    from ruffini.demo.daemon import running_daemon
    from ruffini.device import Connection
    from ruffini.rig.emulated_dialects import EmulatedMarlin
    from ruffini.rig.marlin import Marlin
    from ruffini.rig.network_cell import NetworkCell
    from ruffini.rig.twin_bench import FULL_SCALE, ORIGIN, SIGMA, build_twin_bench
    from ruffini.sim.indenters import Indenter
    from ruffini.sim.units import build_unit

    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ruffini-")))
    with progress_bar("pad mechanics") as progress:
        unit = build_unit(board, progress=progress)
    machine = stack.enter_context(EmulatedMarlin())
    parts = build_twin_bench(unit, Indenter("sphere", ball_mm / 2e3), machine, folder / "twin", seed)
    stack.enter_context(parts.server)
    cell = stack.enter_context(parts.cell)
    assert board.folder is not None
    port = stack.enter_context(running_daemon(board.folder, f"twin:{folder / 'twin'}", folder / "store"))
    sensor = stack.enter_context(Connection(port))
    stage = Marlin(machine.port)
    stack.callback(stage.close)
    note(f"SIMULATED bench of {board.name}")
    reference = NetworkCell("127.0.0.1", FULL_SCALE, SIGMA, settings=cell.settings, port=cell.port)
    return sensor, reference, stage, ORIGIN
