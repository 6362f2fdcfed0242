"""Verbs that judge the device's arithmetic on anybody's data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, note_start, progress_bar
from ruffini.errors import InputError
from ruffini.estimators.wrench.command import (
    ColumnsOption,
    FeaturesOption,
    RecordingOption,
    TimeOption,
    TouchOption,
    UnitOption,
    WrenchOption,
    WrenchUnitOption,
    columns_of,
)

PictureOption = Annotated[Path | None, typer.Option("--out", help="Picture (PNG).")]


def markers(
    video: Annotated[Path, typer.Argument(help="Video file, or folder of images; it starts untouched.")],
    board: BoardOption,
    fields: Annotated[int, typer.Option(min=1, help="Known fields that the first frame is moved by.")] = 20,
    out: PictureOption = None,
    json_: JsonFlag = False,
) -> None:
    """The marker tracker: known warps beside Lucas-Kanade, noise at rest, identity, frames left out or shuffled."""
    note(f"eval markers: board {board}")
    from ruffini.boards import find_board
    from ruffini.evaluate import markers as judge
    from ruffini.frames import read_frames

    found = find_board(board)
    frames = list(read_frames(video))
    with progress_bar("markers") as progress:
        result, tracks = judge.evaluate(found, frames, n_fields=fields, progress=progress)
    text = judge.table(result)
    if out is not None:
        from ruffini.evaluate.pictures import marker_tracks

        result["picture"] = str(marker_tracks(out, frames, tracks, result))
        text += f"\n{out}"
    emit(result, json_, text)


def wrench(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="HDF5 or CSV with a force sensor's columns.")],
    columns: ColumnsOption = None,
    time: TimeOption = None,
    features: FeaturesOption = None,
    unit: UnitOption = None,
    wrench_columns: WrenchOption = None,
    wrench_unit: WrenchUnitOption = None,
    touch: TouchOption = None,
    recording: RecordingOption = None,
    peers: Annotated[bool, typer.Option("--peers/--no-peers", help="Fit scikit-learn's on the same rows.")] = True,
    json_: JsonFlag = False,
) -> None:
    """The wrench of named columns, in the board's integers: touches and recordings left out, beside scikit-learn."""
    note("eval wrench: fits for each part that is left out, minutes")
    from ruffini.calibrate.log.columns import read_column_logs
    from ruffini.evaluate import wrench as judge

    named = columns_of(columns, time, features, unit, wrench_columns, wrench_unit, touch, recording)
    if named is None:
        raise InputError(f"{logs[0]}: name its columns: --columns FILE, or --time, --features, --wrench")
    read = read_column_logs(logs, named)
    if peers and not judge.has_peers():
        note("scikit-learn is not installed: no peers")
    with progress_bar("fits") as progress:
        found = judge.evaluate(read, peers=peers and judge.has_peers(), progress=progress)
    flagged = judge.beyond(read)
    emit(judge.as_json(found, flagged), json_, judge.table(found, flagged))


def real(
    folder: Annotated[
        Path | None, typer.Argument(metavar="DIR", help="Recordings of real sensors (default: $RUFFINI_RECORDED_DATA).")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Page of the same with pictures (HTML).")] = Path("out/real.html"),
    table: Annotated[Path | None, typer.Option("--table", help="The table as Markdown.")] = None,
    json_: JsonFlag = False,
) -> None:
    """One table of what was measured on recordings of real sensors, with peers on the same rows; one page."""
    note("eval real: fits for each part that is left out, minutes")
    import os

    from ruffini.evaluate import real as judge
    from ruffini.files import write_whole

    named = folder or Path(os.environ.get("RUFFINI_RECORDED_DATA", ""))
    with progress_bar("real data") as progress:
        rows = judge.evaluate(named, out, progress=progress)
    if table is not None:
        table.parent.mkdir(parents=True, exist_ok=True)
        write_whole(table, f"{judge.table(rows)}\n".encode())
    emit({"rows": [row._asdict() for row in rows], "page": str(out)}, json_, f"{judge.table(rows)}\n{out}")


def photometric(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Ball presses that were not fitted on, reference.png.")],
    calibration: Annotated[Path, typer.Option("--calibration", help="File with a photometric table.")],
    truth: Annotated[
        Path | None, typer.Option(help="CSV of contact circles (default: DIR/presses.csv; without it they are found).")
    ] = None,
    ball_mm: Annotated[float | None, typer.Option(help="Diameter of the ball (default: presses.toml).")] = None,
    px_per_mm: Annotated[float | None, typer.Option(help="Scale of the images (default: presses.toml).")] = None,
    untouched: Annotated[Path | None, typer.Option(help="Folder of further untouched images.")] = None,
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    out: PictureOption = None,
    json_: JsonFlag = False,
) -> None:
    """Normals, cap shape and height of ball presses with the device's own arithmetic; depth of untouched images."""
    note_start("eval photometric", board)
    from ruffini.calibrate import container
    from ruffini.estimators.photometric.presses import load_presses, reference_images
    from ruffini.estimators.photometric.stage import PHOTOMETRIC
    from ruffini.evaluate import photometric as judge
    from ruffini.frames import image_files

    file = container.read(calibration)
    found = container.board_of(file, board)
    PHOTOMETRIC.need(file, calibration)
    presses = load_presses(folder, ball_mm=ball_mm, px_per_mm=px_per_mm, truth=truth, at_least=1, may_find=True)
    still = image_files(untouched) if untouched is not None else []
    with progress_bar("presses") as progress:
        result, surfaces = judge.evaluate(presses, file, found, still, reference_images(folder), progress=progress)
    text = judge.table(result)
    if out is not None:
        from ruffini.evaluate.pictures import press_depths, save

        result["picture"] = str(save(press_depths(presses, surfaces, result), out))
        text += f"\n{out}"
    emit(result, json_, text)


def flow(
    picture: Annotated[
        Path | None,
        typer.Argument(help="Picture of an untouched textured pad; default: generated speckle and glitter."),
    ] = None,
    board: Annotated[str | None, typer.Option("--board", help="A textured board; default: a patch every 8 px.")] = None,
    fields: Annotated[int, typer.Option(min=1, help="Known fields that the texture is moved by.")] = 8,
    out: PictureOption = None,
    json_: JsonFlag = False,
) -> None:
    """The texture flow on known warps, beside OpenCV's dense inverse search in the same run."""
    note_start("eval flow", board)
    from ruffini.boards import find_board
    from ruffini.evaluate import flow as judge
    from ruffini.frames import read_image

    found = find_board(board) if board is not None else None
    still = read_image(picture) if picture is not None else None
    with progress_bar("flow") as progress:
        result = judge.evaluate(still, found, n_fields=fields, progress=progress)
    text = judge.table(result)
    if out is not None:
        from ruffini.evaluate.pictures import flow_errors

        result["picture"] = str(flow_errors(out, still, found, result))
        text += f"\n{out}"
    emit(result, json_, text)
