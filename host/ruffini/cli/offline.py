"""Verbs that run the device's own arithmetic on files."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, note_start, progress_bar
from ruffini.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ruffini.boards import Board


def _read_picture(path: Path, board: Board) -> npt.NDArray[np.uint8]:
    """An image of the board's size."""
    from ruffini.frames import read_image

    picture = read_image(path)
    height, width = picture.shape[:2]
    if (width, height) != (board.camera.width_px, board.camera.height_px):
        raise InputError(f"{path}: is {width}x{height}, board {board.name!r} needs {board.resolution}; "
                         "`ruffini offline depth --px-per-mm` takes other sizes")  # fmt: skip
    return picture


def track(
    video: Annotated[Path, typer.Argument(help="Video file, or folder of images.")],
    board: BoardOption,
    out: Annotated[Path | None, typer.Option("--out", help="NPZ with displacement, rest and lost.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Follow the printed markers of a recording: displacement against rest, in pixels."""
    note(f"track: board {board}")
    import numpy as np

    from ruffini.boards import find_board
    from ruffini.core import Pipeline
    from ruffini.core.faults import count_faults, fault_words, faults
    from ruffini.files import write_whole
    from ruffini.frames import read_frames

    found = find_board(board)
    moved, lost, flags, has_rest = [], [], [], False
    with Pipeline(found) as pipeline, progress_bar("track") as progress:
        frames = read_frames(video)
        for i, frame in enumerate(frames):
            height, width = frame.shape[:2]
            if (width, height) != (found.camera.width_px, found.camera.height_px):
                raise InputError(
                    f"{video}: frame {i} is {width}x{height}, board {found.name!r} needs {found.resolution}"
                )
            result = pipeline.process(frame)
            rest, displacement, state = pipeline.markers()
            has_rest = has_rest or result.has_reference
            if not result.has_reference:
                displacement, state = np.zeros_like(displacement), np.zeros_like(state)
            moved.append(displacement)
            lost.append(state)
            flags.append(result.flags)
            progress((i + 1) / len(frames))
    displacement, state = np.array(moved), np.array(lost)
    if not has_rest:
        raise InputError(
            f"{video} has {len(moved)} pictures, rest is learned from {found.pipeline.n_rest_frames} not dark ones: "
            "record more before the first touch"
        )
    if result.n_markers_at_rest == 0:
        raise InputError(f"{video}: no markers of board {found.name!r} found: is it the right board?")
    if out is not None:
        archive = io.BytesIO()
        np.savez_compressed(archive, displacement_px=displacement, rest_px=rest, lost=state)
        write_whole(out, archive.getvalue())
    learned = found.pipeline.n_rest_frames
    seen = state[learned:] == 0
    length = np.linalg.norm(displacement, axis=-1)
    step = np.linalg.norm(np.diff(displacement[learned:], axis=0), axis=-1)
    per_frame = [
        {"frame": i, "lost": int((s == 1).sum()), "mean_px": d.reshape(-1, 2).mean(axis=0).round(4).tolist(),
         "displacement_px": d.round(4).tolist(), "faults": faults(f)}
        for i, (d, s, f) in enumerate(zip(displacement, state, flags, strict=True))
    ]  # fmt: skip
    summary = {
        "frames": len(displacement), "lattice": list(rest.shape[1::-1]), "markers_at_rest": result.n_markers_at_rest,
        "rest_px": rest.round(4).tolist(), "largest_displacement_px": round(float(length.max()), 3),
        "largest_step_px": round(float(step.max(initial=0.0)), 3),
        "lost_most": int((state == 1).sum(axis=(1, 2)).max()),
        "seen_share": round(float(seen.mean()), 5) if seen.size else None, "faults": count_faults(flags),
    }  # fmt: skip
    wrong = fault_words(summary["faults"])
    emit({**summary, "per_frame": per_frame}, json_,
         f"{summary['frames']} frames, {summary['markers_at_rest']} markers at rest, largest displacement "
         f"{summary['largest_displacement_px']} px, largest step {summary['largest_step_px']} px, "
         f"at most {summary['lost_most']} lost" + (f"; NOT TO BE USED: {wrong}" if wrong else ""))  # fmt: skip


def depth(
    images: Annotated[list[Path], typer.Argument(help="Images of the pressed pad.")],
    calibration: Annotated[Path, typer.Option("--calibration", help="File with a photometric table.")],
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    reference: Annotated[
        Path | None,
        typer.Option(help="Untouched image (default: reference*.png beside the first image or one folder up)."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for <name>.npy (metres, size of the image) and <name>.png."),
    ] = None,
    px_per_mm: Annotated[
        float | None,
        typer.Option(min=0.01, help="Images that are not of the board's size: their scale, and no perspective."),
    ] = None,
    json_: JsonFlag = False,
) -> None:
    """Depth of the surface in single images, against an untouched one."""
    note_start("depth", board)
    import cv2
    import numpy as np

    from ruffini.calibrate import container
    from ruffini.core import Pipeline
    from ruffini.core.faults import faults
    from ruffini.demo.pictures import depth_map
    from ruffini.estimators.photometric.stage import PHOTOMETRIC
    from ruffini.files import write_array
    from ruffini.frames import read_image

    file = container.read(calibration)
    found = container.board_of(file, board)
    PHOTOMETRIC.need(file, calibration)
    beside, above = images[0].parent, images[0].parent.parent
    references = [reference] if reference else next(filter(None, (
        sorted(folder.glob(f"{name}*.png")) for name in ("reference", "press_ref") for folder in (beside, above)
    )), [])  # fmt: skip
    if not references:
        raise InputError(f"no untouched image beside {images[0]}: give one with --reference")
    twice = [p for p, n in Counter(path.stem for path in images).items() if n > 1]
    if out is not None and twice:
        raise InputError(f"several images would be written to {out / twice[0]}.npy: give them other names")
    data = file.data
    if px_per_mm is not None:
        from ruffini.evaluate.photometric import view_of

        view = view_of(found, file, read_image(references[0]).shape, px_per_mm)
        found, data = view.board, view.calibration
    rest = np.mean([_read_picture(p, found).astype(float) for p in references], axis=0)
    rows: list[dict[str, Any]] = []
    with Pipeline(found, data) as pipeline, progress_bar("depth") as progress:
        pipeline.set_rest(rest)
        for i, path in enumerate(images):
            result = pipeline.process(_read_picture(path, found))
            grid = pipeline.depth_m()
            size_px = (found.camera.width_px, found.camera.height_px)
            full = np.asarray(cv2.resize(grid, size_px, interpolation=cv2.INTER_LINEAR), dtype=np.float64)
            if out is not None:
                write_array(out / f"{path.stem}.npy", full)
                depth_map(out / f"{path.stem}.png", full * 1e6, title=path.name)
            rows.append({"image": str(path), "lowest_um": round(float(grid.min() * 1e6), 3),
                         "highest_um": round(float(grid.max() * 1e6), 3), "flags": result.flags,
                         "validity": result.depth_validity, "faults": faults(result.flags)})  # fmt: skip
            progress((i + 1) / len(images))
    text = "\n".join(
        f"{r['image']}: {r['lowest_um']:.1f} to {r['highest_um']:.1f} um"
        + (f"; NOT TO BE USED: {', '.join(r['faults'])}" if r["faults"] else "")
        for r in rows
    )
    emit({"images": rows}, json_, text)


def field(
    calibration: Annotated[Path, typer.Option("--calibration", help="File with an operator.")],
    displacement: Annotated[
        Path,
        typer.Option("--displacement", help="NPY: U[frame, iy, ix, 3] float64, mm, pad's corner, x = ix hx."),
    ],
    out: Annotated[Path, typer.Option("--out", help="NPY to write: F, newtons, NaN at nodes that are not observed.")],
    board: Annotated[str | None, typer.Option(help="Default: the board that the calibration names.")] = None,
    json_: JsonFlag = False,
) -> None:
    """Displacement field -> force field with the device's fixed-point solve."""
    import numpy as np

    from ruffini.calibrate import container
    from ruffini.core import Pipeline
    from ruffini.core.pipeline import DISPLACEMENT_LSB_M
    from ruffini.estimators.operator.stage import OPERATOR
    from ruffini.files import read_array, write_array

    file = container.read(calibration)
    found = container.board_of(file, board)
    OPERATOR.need(file, calibration)
    u = read_array(displacement)
    shape = (found.grid.n_y, found.grid.n_x, 3)
    if u.ndim != 4 or u.shape[1:] != shape or u.dtype.kind != "f":
        raise InputError(
            f"{displacement}: is {u.dtype} {u.shape}, "
            f"board {found.name!r} needs float (frames, {shape[0]}, {shape[1]}, 3)"
        )
    if not np.isfinite(u).all():
        raise InputError(f"{displacement}: holds NaN or infinity: fill lost nodes first")
    steps = np.floor(u.astype(np.float64) * 1e-3 / DISPLACEMENT_LSB_M + 0.5)
    if np.abs(steps).max(initial=0) > 32767:
        raise InputError(
            f"{displacement}: holds more than 4.096 mm, which the board's integers do not: are these millimetres?"
        )
    rows, columns = found.observed
    seen = steps[:, rows, columns].astype(np.int16)
    force = np.full(u.shape, np.nan)
    with Pipeline(found, file.data) as pipeline:
        n_seen = seen.shape[1] * seen.shape[2]
        solved = pipeline.solve(seen.reshape(len(u), n_seen, 3)).reshape(seen.shape)
    force[:, rows, columns] = solved * (found.field.force_lsb_un * 1e-6)
    write_array(out, force)
    total = np.nansum(force, axis=(1, 2))
    emit({"file": str(out), "frames": len(u), "resultant_n": total.round(6).tolist()}, json_,
         f"{out}: {len(u)} frames, largest resultant {np.linalg.norm(total, axis=1).max(initial=0):.4f} N")  # fmt: skip
