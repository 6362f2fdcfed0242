"""ruffini cal fit --only camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit_judged
from ruffini.errors import InputError

if TYPE_CHECKING:
    from ruffini.boards import Board
    from ruffini.estimators.camera.targets import Target


def camera(
    images: Annotated[list[Path], typer.Argument(help="Pictures of the target from several sides, or a folder.")],
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    target: Annotated[Literal["chessboard", "dots", "charuco"], typer.Option(help="What the pictures show.")],
    size: Annotated[str, typer.Option(help="Inner corners (chessboard), dots, or squares (ChArUco): COLUMNSxROWS.")],
    pitch_mm: Annotated[float, typer.Option(help="Distance of neighbouring points.")],
    fisheye: Annotated[bool, typer.Option("--fisheye", help="A fisheye lens.")] = False,
    on_pad: Annotated[
        Path | None, typer.Option(help="Picture of the target lying on the pad: where the camera stands.")
    ] = None,
    views: Annotated[
        str | None,
        typer.Option(help="Views side by side in a frame, left first, e.g. straight,straight or straight,mirrored."),
    ] = None,
    index: Annotated[float, typer.Option(min=1.0, max=2.5, help="Refractive index of a clear pad.")] = 1.0,
    dictionary: Annotated[str, typer.Option(help="ChArUco markers.")] = "4X4_50",
    json_: JsonFlag = False,
) -> None:
    """Fit lens, mounting and refraction to pictures of a flat target."""
    from ruffini.boards import find_board
    from ruffini.calibrate.gates import write_judged
    from ruffini.estimators.camera.fit import fit_camera, tables
    from ruffini.estimators.camera.stage import CAMERA
    from ruffini.estimators.camera.targets import Target
    from ruffini.frames import image_files

    found = find_board(board)
    columns, _, rows = size.partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise InputError(f"--size {size!r}: give COLUMNSxROWS, e.g. 9x6")
    paths = image_files(images[0]) if len(images) == 1 and images[0].is_dir() else images
    shown = Target(target, int(columns), int(rows), pitch_mm, dictionary)
    if views is not None:
        _several(paths, shown, found, views, fisheye, on_pad, index, out, json_)
        return
    fit = fit_camera(paths, shown, found, is_fisheye=fisheye, on_pad=on_pad, index=index)
    tensors, metadata = tables(fit.model, found)
    report = fit.report()
    gates = write_judged(out, CAMERA.name, CAMERA.gates(report, found), found, {**tensors}, report, metadata)
    skipped = f", none in {', '.join(report['skipped'])}" if report["skipped"] else ""
    emit_judged({"file": str(out), **report}, gates, json_,
         f"{out}: {report['model']} lens from {report['views']} views, {report['points']} points{skipped}; "
         f"residual {report['residual_px']:.3f} px = {report['residual_um']:.1f} um of pad, worst view "
         f"{report['worst_view_px']:.3f} px; mounting "
         + ("measured on the pad" if report["is_measured_on_pad"] else "as in board.toml"))  # fmt: skip


def _several(
    paths: list[Path], shown: Target, board: Board, views: str, fisheye: bool, on_pad: Path | None, index: float,
    out: Path, json_: bool,
) -> None:  # fmt: skip
    from ruffini.calibrate.gates import write_judged
    from ruffini.estimators.camera.stage import CAMERA
    from ruffini.estimators.camera.views import fit_views, tables, view_kinds

    kinds = view_kinds(views)
    if on_pad is None:
        raise InputError("--views needs --on-pad: one picture in which all views see the target lying on the pad")
    fit = fit_views(paths, shown, board, kinds, is_fisheye=fisheye, on_pad=on_pad, index=index)
    tensors, metadata = tables(fit, board)
    report = fit.report()
    gates = write_judged(out, CAMERA.name, CAMERA.gates(report, board), board, {**tensors}, report, metadata)
    each = "; ".join(f"{v['kind']}: {v['pictures']} pictures, {v['residual_px']:.3f} px" for v in report["views"])
    emit_judged({"file": str(out), **report}, gates, json_,
         f"{out}: {each}; on the pad the rays of two views meet {report['height_um']:.1f} um off its height (RMS of "
         f"{report['points']} points), {report['gap_um']:.1f} um apart")  # fmt: skip
