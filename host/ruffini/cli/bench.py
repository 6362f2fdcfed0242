"""Verbs that judge methods on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar
from ruffini.errors import InputError


def ifem(
    board: BoardOption,
    quick: Annotated[bool, typer.Option("--quick", help="One depth, one seed, no model errors.")] = False,
    truth: Annotated[
        str, typer.Option(help="Strain of the true pad: linear, or finite (half an hour once; then from a cache).")
    ] = "linear",
    only: Annotated[
        str | None,
        typer.Option(
            help="resolution: lines told apart, and response by spatial frequency; objects: a screw, a coin and a key; "
            "steady: what averaging the field of an unchanging contact gains and costs."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Picture (PNG) of the fields beside the truth; with --only resolution, of the response; with --only "
            "objects, also an animation of each beside it.",
        ),
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """Inverse FEM: raw, sparse and ridge as in the papers, the optimal linear estimate, and the board's default."""
    note(f"bench ifem: board {board}")
    if truth not in ("linear", "finite"):
        raise InputError(f"unknown truth {truth!r}: linear or finite")
    if only is not None:
        if only not in IFEM_PARTS:
            raise InputError(f"unknown part {only!r}: {' or '.join(IFEM_PARTS)}")
        if truth != "linear":
            raise InputError(f"--only {only} is measured on a linear pad: leave --truth out")
        IFEM_PARTS[only](board, out, json_, quick=quick)
        return
    from ruffini.bench import ifem as benchmark
    from ruffini.boards import find_board

    chosen: Literal["linear", "finite"] = "finite" if truth == "finite" else "linear"
    found = find_board(board)
    with progress_bar("benchmark") as progress:
        result = benchmark.run(found, quick=quick, truth=chosen, progress=progress)
    text = benchmark.tables(result)
    if out is not None:
        from ruffini.bench.pictures import pictures

        result["pictures"] = [str(path) for path in pictures(out, found)]
        text += "\n" + "\n".join(result["pictures"])
    emit(result, json_, text)


def _resolution(board: str, out: Path | None, json_: bool, *, quick: bool) -> None:
    """`bench ifem --only resolution`."""
    from ruffini.bench import resolution
    from ruffini.boards import find_board

    with progress_bar("resolution") as progress:
        result = resolution.run(find_board(board), quick=quick, progress=progress)
    text = resolution.table(result)
    if out is not None:
        from ruffini.bench.resolution_picture import curves

        result["picture"] = str(curves(out, [result]))
        text += f"\n{out}"
    emit(result, json_, text)


def _objects(board: str, out: Path | None, json_: bool, *, quick: bool) -> None:
    """`bench ifem --only objects`."""
    from ruffini.bench import fine_objects
    from ruffini.boards import find_board

    if quick:
        raise InputError("--only objects has no quick form: leave --quick out")
    if out is not None and out.suffix != ".png":
        raise InputError(f"--out {out}: give a .png")
    found = find_board(board)
    with progress_bar("objects") as progress:
        objects = fine_objects.measure(found, progress)
    result = fine_objects.result_of(found, objects)
    text = fine_objects.table(result)
    if out is not None:
        from ruffini.bench.fine_objects_picture import animation, sheet

        made = [sheet(out, found, objects)]
        made += [animation(out.with_name(f"{out.stem}-{n}.webp"), found, n, touch) for n, touch in objects.items()]
        result["pictures"] = [str(path) for path in made]
        text += "\n" + "\n".join(result["pictures"])
    emit(result, json_, text)


def _steady(board: str, out: Path | None, json_: bool, *, quick: bool) -> None:
    """`bench ifem --only steady`."""
    from ruffini.bench import steady
    from ruffini.boards import find_board

    if out is not None:
        raise InputError("--only steady draws nothing: leave --out out")
    with progress_bar("steady") as progress:
        result = steady.run(find_board(board), quick=quick, progress=progress)
    emit(result, json_, steady.table(result))


IFEM_PARTS = {"resolution": _resolution, "objects": _objects, "steady": _steady}


def slip(
    board: BoardOption,
    quick: Annotated[bool, typer.Option("--quick", help="Four contacts, two seeds, one noise.")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Picture (PNG) of one contact until it slides.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Stick and slip: foreseen how long before a contact slides, false alarms, friction."""
    note(f"bench slip: board {board}")
    from ruffini.bench import slip as benchmark
    from ruffini.boards import find_board

    found = find_board(board)
    with progress_bar("slip") as progress:
        result = benchmark.run(found, quick=quick, progress=progress)
    text = benchmark.tables(result)
    if out is not None:
        from ruffini.bench.slip_picture import shear_until_it_slides

        result["picture"] = str(shear_until_it_slides(out, found))
        text += f"\n{out}"
    emit(result, json_, text)


def held(board: BoardOption, json_: JsonFlag = False) -> None:
    """A gel that relaxes: the force of held touches before and after `cal fit --only relaxation` on other ones."""
    note(f"bench held: board {board}")
    from ruffini.bench import held as benchmark
    from ruffini.boards import find_board

    found = find_board(board)
    with progress_bar("held") as progress:
        result = benchmark.run(found, progress=progress)
    emit(result, json_, benchmark.table(result))


def touch(board: BoardOption, json_: JsonFlag = False) -> None:
    """First touch: frames and newtons until it is reported, and false contacts on the untouched pad."""
    note(f"bench touch: board {board}")
    from ruffini.bench import first_touch as benchmark
    from ruffini.boards import find_board

    with progress_bar("touch") as progress:
        result = benchmark.run(find_board(board), progress=progress)
    emit(result, json_, benchmark.table(result))


def light(board: BoardOption, json_: JsonFlag = False) -> None:
    """Drifting lamps before and after they are followed, a contact held for minutes, and how late a touch is seen."""
    note(f"bench light: board {board}")
    from ruffini.bench import light as benchmark
    from ruffini.boards import find_board

    found = find_board(board)
    with progress_bar("light") as progress:
        result = benchmark.run(found, progress=progress)
    emit(result, json_, benchmark.table(result))


def health(
    board: BoardOption,
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration file; without one the flags alone are judged.")
    ] = None,
    full_scale_n: Annotated[float, typer.Option(min=0.001, help="Largest force of this sensor, newtons.")] = 4.0,
    json_: JsonFlag = False,
) -> None:
    """Faults of camera, light and pad one by one: frames until each is flagged, wrong forces that pass as valid."""
    note(f"bench health: board {board}")
    from ruffini.bench import health as benchmark
    from ruffini.boards import find_board
    from ruffini.calibrate import container
    from ruffini.sim.units import build_unit

    unit = build_unit(find_board(board))
    with progress_bar("health") as progress:
        result = benchmark.run(
            unit,
            container.read(calibration).data if calibration else None,
            full_scale_n=full_scale_n,
            progress=progress,
        )
    emit(result, json_, benchmark.table(result))
    if result["n_silent"]:
        raise typer.Exit(1)


def presses(
    folder: Annotated[
        Path, typer.Argument(help="Ball presses (reference.png, presses.csv, images); with --board videos.")
    ],
    ball_mm: Annotated[
        float | None, typer.Option(help="Diameter of the ball, where presses.toml does not say.")
    ] = None,
    px_per_mm: Annotated[float | None, typer.Option(help="Scale, where presses.toml does not say.")] = None,
    board: Annotated[
        str | None, typer.Option("--board", help="Board that took videos, with FOLDER.videos.toml in its folder.")
    ] = None,
    object_: Annotated[
        str | None, typer.Option("--object", help="With --board: which object is a rigid ball, of --ball-mm.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Picture (PNG): recorded and rendered.")] = None,
    json_: JsonFlag = False,
) -> None:
    """The twin's pictures beside recorded ones: ball presses, lamps fitted on half of them, or a board's videos."""
    note("bench presses ...")
    if board is not None:
        _videos(folder, board, object_, ball_mm, out, json_)
        return
    from ruffini.bench import presses as comparison
    from ruffini.estimators.photometric.presses import load_presses

    recorded = load_presses(folder, ball_mm=ball_mm, px_per_mm=px_per_mm)
    with progress_bar("presses") as progress:
        result, text = comparison.run(recorded, out, progress)
    emit(result, json_, text)


def _videos(
    folder: Path, board: str, object_: str | None, ball_mm: float | None, out: Path | None, json_: bool
) -> None:
    """`bench presses --board`."""
    from ruffini.bench import video_presses
    from ruffini.boards import find_board
    from ruffini.calibrate.log.videos import VideoColumns
    from ruffini.sim.unit import TwinUnit

    if object_ is None or ball_mm is None or not ball_mm > 0:
        raise InputError("--board needs --object NAME and --ball-mm: which object is a rigid ball, and its diameter")
    found = find_board(board)
    mapping = (found.folder or Path()) / f"{folder.resolve().name}.videos.toml"
    if not mapping.is_file():
        raise InputError(f"{mapping} does not exist: it names the columns of the recordings in {folder}")
    with progress_bar("videos") as progress:
        unit = TwinUnit.build(found)
        columns = VideoColumns.read(mapping)
        result, text = video_presses.run(folder, found, unit, columns, (object_, ball_mm), out, progress)
    emit(result, json_, text)


def rig(
    board: BoardOption,
    n: Annotated[int | None, typer.Option("--n", min=1, help="Touches. Default: 20, with --quick 4.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few touches.")] = False,
    machine: Annotated[str, typer.Option(help="marlin or grbl.")] = "marlin",
    calibration: Annotated[
        Path | None, typer.Option(help="Flashed first. Default: made on the twin, where the board measures force.")
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """The simulated calibration bench: time for its presses, and the error of the clock offset that its log finds."""
    note(f"bench rig: board {board}")
    from ruffini.bench import rig as benchmark
    from ruffini.boards import find_board
    from ruffini.calibrate import container

    data = None if calibration is None else container.read(calibration).data
    with progress_bar("rig") as progress:
        result = benchmark.run(
            find_board(board), n=n, quick=quick, machine=machine, calibration=data, progress=progress
        )
    emit(result, json_, benchmark.table(result))


def auto(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="--out of finished runs of `cal auto`.")],
    json_: JsonFlag = False,
) -> None:
    """Runs of `cal auto` in one table: presses, time, error before and after, clocks."""
    note("bench auto ...")
    from ruffini.calibrate.auto.page import table_of

    results, text = table_of(folders)
    emit({"runs": results}, json_, text)


def fleet(
    board: BoardOption,
    recordings: Annotated[Path, typer.Option("--recordings", help="Folder of the units' recordings; kept there.")],
    units: Annotated[int, typer.Option(min=6, help="Simulated units, each with a pad of its own.")] = 20,
    modulus: Annotated[
        float, typer.Option(min=0.3, max=3, help="Factor on the board's modulus: what a datasheet has wrong.")
    ] = 1.0,
    json_: JsonFlag = False,
) -> None:
    """Units of a simulated fleet before and after `cal fleet`, few presses with the fleet's prior, and the time."""
    note(f"bench fleet: board {board}")
    from ruffini.bench import fleet as benchmark
    from ruffini.boards import find_board

    with progress_bar("fleet") as progress:
        result = benchmark.run(find_board(board), recordings, units, modulus=modulus, progress=progress)
    emit(result, json_, benchmark.table(result))
