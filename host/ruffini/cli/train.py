"""Verbs that train networks on the digital twin; they need the extra [train]."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ruffini.cli.common import BoardOption, JsonFlag, emit, note, progress_bar
from ruffini.older_python import StrEnum


class Plans(StrEnum):
    """Networks of `ruffini train stereo`."""

    VGG16 = "vgg16"
    EIGHTH = "eighth"


def _set_threads(threads: int) -> None:
    """Of PyTorch. Raises InputError where it is not installed."""
    from ruffini.train import need_torch

    need_torch("ruffini train")
    import torch

    torch.set_num_threads(threads)


def displacement(
    board: BoardOption,
    out: Annotated[Path, typer.Option("--out", help="Folder; run the same command again to go on with it.")],
    presses: Annotated[int, typer.Option(min=10, help="Simulated presses, every frame of each a sample.")] = 400,
    passes: Annotated[int, typer.Option(min=1, help="Passes over all samples.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 5,
    threads: Annotated[int, typer.Option(min=1, help="Threads of PyTorch; 1 gives the same weights every time.")] = 1,
    json_: JsonFlag = False,
) -> None:
    """A U-Net from pictures to the displacement of all nodes, the iFEM 2.0 paper's way; ONNX for OpenCV."""
    note(f"train displacement: board {board}")
    _set_threads(threads)
    from ruffini.boards import find_board
    from ruffini.train.export import export
    from ruffini.train.fit import Plan, Trainer
    from ruffini.train.presses import make_samples

    found = find_board(board)
    with progress_bar("presses") as progress:
        rest, samples = make_samples(found, presses, seed, progress=progress)
    trainer = Trainer(found, Plan(presses, passes, seed), rest, samples, out)
    start, n_kept = time.monotonic(), len(trainer.passes)
    with progress_bar("training") as progress:
        for done in trainer.run(progress):
            note(f"pass {done.number} of {passes}: loss {done.loss:.4f}, presses left out {done.text()}")
    file = export(trainer.net, (rest.shape[0], rest.shape[1]), out)
    result = {
        "network": str(file), "simulated": True, "frames": len(samples.press), "passes_kept": n_kept,
        "took_s": time.monotonic() - start, "passes": [asdict(p) for p in trainer.passes],
    }  # fmt: skip
    text = (
        f"{file}: {len(samples.press)} frames, moved nodes of presses left out {trainer.passes[-1].text()}, SIMULATED"
    )
    emit(result, json_, text)


def stereo(
    board: BoardOption,
    presses: Annotated[
        Path, typer.Option("--presses", help="Folder of presses, as `ruffini cal fit --only fingertip` takes it.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder; run the same command again to go on with it.")],
    only: Annotated[str, typer.Option(help="Pattern of the folders below --presses that are used.")] = "*",
    mode: Annotated[
        int, typer.Option(min=0, max=3, help="The paper's input: left, both, left or both in black and white.")
    ] = 1,
    plan: Annotated[Plans | None, typer.Option(help="VGG16, or its layers at an eighth of the width.")] = None,
    weights: Annotated[
        Path | None, typer.Option(help="torchvision's weights of VGG16 with batch norm; else those in its cache.")
    ] = None,
    passes: Annotated[int, typer.Option(min=1, help="Passes over all frames.")] = 40,
    most_n: Annotated[float, typer.Option(help="Frames of more force are left out: the paper's 1 N, or 10 N.")] = 1.05,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 1,
    threads: Annotated[int, typer.Option(min=1, help="Threads of PyTorch; 1 gives the same weights every time.")] = 1,
    json_: JsonFlag = False,
) -> None:
    """The stereo paper's network: force, place and angles from two views; ONNX for the board and OpenCV."""
    note(f"train stereo: board {board}")
    _set_threads(threads)
    from ruffini.boards import find_board
    from ruffini.train.stereo_run import Wish, train

    wish = Wish(presses, only, out, mode, None if plan is None else plan.value, weights, passes, seed, most_n)
    run = train(find_board(board), wish, note, progress_bar)
    r, tag = run.result, ", SIMULATED" if run.result["simulated"] else ""
    emit(r, json_, f"{run.file}: {r['plan']} ({r['trunk']}), {r['weights'] / 1e6:.2f} million weights, "
         f"{r['bytes'] / 1e6:.1f} MB, {r['frames']} frames of {r['presses']} presses, {r['took_s']:.0f} s, "
         f"{r['most_memory_mb']} MB of memory; OpenCV within {r['opencv_off_pytorch']:.1e} of PyTorch; "
         f"pass {run.best.number}, presses left out {run.best.text()}{tag}")  # fmt: skip
