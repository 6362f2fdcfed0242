"""Verbs of the digital twin."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, WorkersOption, emit, n_workers_of, note, progress_bar
from ruffini.errors import InputError


def press(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="New folder for the recording.")],
    program: Annotated[
        str,
        typer.Option(
            help="demo, grid (presses for judging), balls (for cal photometric), connector (loads of a tray), "
            "or one indenter's way: press, shear, twist, roll, slide, cycles, walk, limit."
        ),
    ] = "demo",
    n: Annotated[
        int, typer.Option("--n", help="Number of presses (grid, balls), frames of each load (connector).")
    ] = 40,
    seed: Annotated[int, typer.Option(help="Everything random follows from it.")] = 1,
    ball_mm: Annotated[float, typer.Option(help="Diameter of the calibration ball (balls).")] = 5.0,
    indenter: Annotated[str, typer.Option(help="Shape that goes the way: sphere, square, nut, ...")] = "sphere",
    radius_mm: Annotated[float, typer.Option(help="Half of the shape's size.")] = 3.0,
    depth_mm: Annotated[float, typer.Option(help="Depth of the way.")] = 0.8,
    shore_a: Annotated[int | None, typer.Option(help="Hardness of the shape; rigid without.")] = None,
    scenario: Annotated[
        Path | None, typer.Option("--scenario", help="Program, n, seed and faults from a file, instead of options.")
    ] = None,
    strain: Annotated[
        str | None, typer.Option(help="linear, or finite (minutes for a press); as twin.toml says without.")
    ] = None,
    relax: Annotated[
        bool | None, typer.Option("--relax/--no-relax", help="Let the gel relax; as twin.toml says without.")
    ] = None,
    scale_modulus: Annotated[float, typer.Option(help="True modulus over the board's.")] = 1.0,
    scale_poisson: Annotated[float, typer.Option(help="True Poisson's ratio over the board's.")] = 1.0,
    scale_thickness: Annotated[float, typer.Option(help="True thickness over the board's.")] = 1.0,
    json_: JsonFlag = False,
) -> None:
    """Press the simulated pad and record frames and truth."""
    note(f"sim press: board {board}")
    from ruffini.boards import find_board
    from ruffini.sim.recording import record_balls, record_touches
    from ruffini.sim.scenario import load_scenario, scenario_of
    from ruffini.sim.trajectories import TRAJECTORIES
    from ruffini.sim.unit import PadError, TwinUnit
    from ruffini.sim.units import build_unit

    is_balls = program == "balls" and scenario is None
    mechanics = {"strain": strain, "is_relaxing": relax}
    if scenario is not None:
        plan = load_scenario(scenario)
    elif program in ("demo", "grid", "balls", "connector"):
        plan = scenario_of({"program": "demo" if is_balls else program, "n": n, "seed": seed, **mechanics}, "options")
    elif program in TRAJECTORIES:
        touch = {"indenter": indenter, "radius_um": round(radius_mm * 1e3), "depth_um": round(depth_mm * 1e3),
                 "shore_a": shore_a}  # fmt: skip
        plan = scenario_of({"program": program, "seed": seed, "touch": touch, **mechanics}, "options")
    else:
        raise InputError(f"unknown program {program!r}: demo, grid, balls, connector or {', '.join(TRAJECTORIES)}")
    found = find_board(board)
    with progress_bar("pad mechanics") as progress:
        error = PadError(scale_modulus, scale_poisson, scale_thickness)
        unit = build_unit(found, error, twin=plan.twin(found), progress=progress)
    with progress_bar("frames") as progress:
        if is_balls:
            if not isinstance(unit, TwinUnit):
                raise InputError(f"balls calibrate colour on a flat pad: board {found.name!r} has none")
            count = record_balls(unit, plan.n, out, ball_mm=ball_mm, seed=plan.seed, progress=progress)
        else:
            story = plan.story(found)
            count = record_touches(
                unit, story, out, seed=plan.seed, program=plan.program, faults=plan.fault, progress=progress
            )
    emit({"folder": str(out), "frames": count, "simulated": True}, json_, f"{out}: {count} frames, SIMULATED")


def dataset(
    board: BoardOption,
    n: Annotated[int, typer.Option("--n", help="Number of samples: presses, each with its truth.")],
    out: Annotated[Path, typer.Option("--out", help="Folder; run the same command again to go on with it.")],
    seed: Annotated[int, typer.Option(help="Everything random follows from it.")] = 1,
    shard_size: Annotated[int, typer.Option(help="Samples in one HDF5 file.")] = 64,
    workers: WorkersOption = None,
    dask: Annotated[str | None, typer.Option("--dask", help="Address of a Dask scheduler, for --workers.")] = None,
    scale_modulus: Annotated[float, typer.Option(help="True modulus over the board's.")] = 1.0,
    scale_poisson: Annotated[float, typer.Option(help="True Poisson's ratio over the board's.")] = 1.0,
    scale_thickness: Annotated[float, typer.Option(help="True thickness over the board's.")] = 1.0,
    json_: JsonFlag = False,
) -> None:
    """Many presses with their truth, as HDF5 shards with a card."""
    note(f"sim dataset: board {board}")
    from ruffini.boards import find_board
    from ruffini.sim.dataset.make import make_dataset
    from ruffini.sim.dataset.plan import Plan
    from ruffini.sim.unit import PadError

    error = PadError(scale_modulus, scale_poisson, scale_thickness)
    plan = Plan.of(find_board(board), n=n, shard_size=shard_size, seed=seed, error=error)
    with progress_bar("samples") as progress:
        outcome = make_dataset(plan, out, n_workers=n_workers_of(workers), dask=dask, progress=progress)
    rate = outcome.n_samples_made / outcome.took_s if outcome.n_samples_made else None
    result = {
        "folder": str(out), "samples": plan.n, "shards": plan.n_shards, "shards_made": outcome.n_made,
        "shards_kept": outcome.n_kept, "samples_per_s": rate, "simulated": True,
    }  # fmt: skip
    speed = f", {rate:.1f} samples/s" if rate else ""
    text = f"{out}: {plan.n} samples in {plan.n_shards} shards ({outcome.n_kept} were there){speed}, SIMULATED"
    emit(result, json_, text)


def bench(board: BoardOption, json_: JsonFlag = False) -> None:
    """Frames a second of the twin on one core: mechanics and rendering apart."""
    from ruffini.boards import find_board
    from ruffini.sim.speed import measure

    result = measure(find_board(board))
    text = (
        f"{result['board']} {result['resolution']}, one core: rendering {result['rendering_fps']:.1f} frames/s, "
        f"mechanics {result['mechanics_fps']:.1f} frames/s, {result['memory_mb']:.0f} MB"
    )
    emit(result, json_, text)


def serve(
    board: BoardOption,
    socket: Annotated[Path, typer.Option("--socket", help="UNIX socket, for ruffinid --camera twin:SOCKET.")],
    scenario: Annotated[Path | None, typer.Option("--scenario", help="Program and faults; default: demo.")] = None,
    steer: Annotated[
        bool, typer.Option("--steer", help="A ball goes where lines on stdin say: x_mm y_mm depth_mm.")
    ] = False,
    ball_mm: Annotated[float, typer.Option(help="Diameter of the steered ball.")] = 6.0,
    once: Annotated[bool, typer.Option("--once", help="End when the first camera has gone.")] = False,
    json_: JsonFlag = False,
) -> None:
    """The live twin as a camera."""
    import signal
    import threading

    from ruffini.boards import find_board
    from ruffini.sim.contact import Indenter
    from ruffini.sim.optics.renderer import Renderer
    from ruffini.sim.scenario import Scenario, load_scenario
    from ruffini.sim.serve import Resting, Scripted, Steered, TwinServer, steer_from
    from ruffini.sim.settings import load_twin
    from ruffini.sim.units import build_unit

    plan, found = load_scenario(scenario) if scenario else Scenario(), find_board(board)
    frames: Resting | Scripted | Steered
    if plan.program == "rest" and not steer:
        renderer = Renderer.over_chart(found, load_twin(found))
        frames = Resting(renderer, plan.n)
    else:
        with progress_bar("pad mechanics") as progress:
            unit = build_unit(found, twin=plan.twin(found), progress=progress)
        renderer = unit.renderer()
        if steer:
            frames = Steered(unit, Indenter("sphere", ball_mm / 2e3))
            threading.Thread(target=steer_from, args=(sys.stdin, frames), daemon=True).start()
        else:
            with progress_bar("touches") as progress:
                frames = Scripted(unit, plan, progress)
    server = TwinServer(renderer, frames, plan, socket)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.close())
    note(f"SIMULATED {found.name} on {socket}")
    server.run(once=once)
    emit({"frames": server.n_sent, "simulated": True}, json_, f"{server.n_sent} frames sent, SIMULATED")
