"""Verbs of calibration files, and `cal zero`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit
from ruffini.cli.device import open_sensor

FILE = typer.Argument(help="Calibration file.")


def merge(
    files: Annotated[list[Path], typer.Argument(help="Calibration files; later ones win.")],
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    json_: JsonFlag = False,
) -> None:
    """One file with the kinds of several."""
    from ruffini.calibrate import container, keys

    merged = container.merge([keys.read_verified(f) for f in files])
    container.write(out, merged)
    emit({"file": str(out), "kinds": merged.kinds}, json_, f"{out}: {', '.join(merged.kinds)}")


def verify(
    file: Annotated[Path, FILE],
    board: Annotated[str | None, typer.Option(help="Also: is it for this board, and does the core take it?")] = None,
    json_: JsonFlag = False,
) -> None:
    """Check a file's layout and signature, and that the core can prove it."""
    from ruffini.calibrate import container, keys
    from ruffini.core import Pipeline

    read = container.read(file)
    signer = keys.verify(read)
    if board is not None:
        Pipeline(container.board_of(read, board), read.data).close()
    emit({"file": str(file), "ok": True, "kinds": read.kinds, "board": read.metadata["board"],
          "signer": signer}, json_,
         f"{file}: {', '.join(read.kinds)} for {read.metadata['board']}, signed by {signer}")  # fmt: skip


def show(file: Annotated[Path, FILE], json_: JsonFlag = False) -> None:
    """Print what a calibration file says of itself."""
    from ruffini.calibrate import container

    read = container.read(file)
    tensors = {k: f"{v.dtype} {list(v.shape)}" for k, v in read.tensors.items()}
    text = "\n".join(
        [*(f"{k} = {v}" for k, v in read.metadata.items()), "", *(f"{k}: {v}" for k, v in tensors.items())]
    )
    emit({"metadata": read.metadata, "tensors": tensors, "sha256": read.sha256.hex()}, json_, text)


def zero(
    n: Annotated[int, typer.Option("--n", min=0, help="Frames to average (0 = the board's own number).")] = 0,
    touched: Annotated[
        bool, typer.Option("--even-if-touched", help="Make what presses on the pad now part of rest.")
    ] = False,
    wait: Annotated[bool, typer.Option("--wait/--no-wait", help="Wait until it is learned.")] = True,
    json_: JsonFlag = False,
) -> None:
    """Learn the untouched image again. Clear the pad: a press is refused, but not seen under flags like FLAG_LIGHT."""
    from ruffini.device.zeroing import learn_rest

    with open_sensor() as sensor:
        learn_rest(sensor, n, even_if_touched=touched, waits=wait)
    emit({"ok": True}, json_, f"{sensor.port}: {'rest is learned' if wait else 'learning rest'}")
