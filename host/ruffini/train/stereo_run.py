"""One run of `ruffini train stereo`: samples, training, export, and what it cost."""

from __future__ import annotations

import hashlib
import json
import resource
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.skin.presses import press_folders
from ruffini.frames import Frames
from ruffini.train.stereo_export import export
from ruffini.train.stereo_fit import Choice, Pass, StereoTrainer
from ruffini.train.stereo_frames import read_samples
from ruffini.train.stereo_network import WEIGHTS_NAME, find_weights

Progress = Callable[[float], None]

NETWORK = "stereo.onnx"
N_CHECKED = 3  # frames by which the exported network is compared


@dataclass(frozen=True)
class Wish:
    """Options of the verb. plan None: VGG16 where its weights are found, else a network an eighth as wide."""

    presses: Path
    only: str
    out: Path
    mode: int
    plan: str | None
    weights: Path | None
    n_passes: int
    seed: int
    most_n: float


@dataclass(frozen=True)
class Run:
    """What came out."""

    file: Path
    result: dict[str, Any]
    best: Pass


def train(board: Board, wish: Wish, note: Callable[[str], None], bar: Callable[[str], Any]) -> Run:
    """Read, train, export. Raises InputError, VerifyError."""
    start = time.monotonic()
    weights, plan = _plan_of(wish, note)
    with bar("presses") as progress:
        samples = read_samples(board, wish.presses, wish.only, most_n=wish.most_n, progress=progress)
    digest = hashlib.sha256(weights.read_bytes()).hexdigest() if weights else None
    choice = Choice(plan, wish.mode, wish.n_passes, wish.seed, digest)
    with bar("features") as progress:
        trainer = StereoTrainer(choice, samples, wish.out, weights, progress)
    n_kept = len(trainer.passes)
    with bar("training") as progress:
        for done in trainer.run(progress):
            note(f"pass {done.number} of {wish.n_passes}: loss {done.loss:.4f}, presses left out {done.text()}")
    net, best = trainer.best()
    pictures, simulated = _some_frames(wish)
    file = wish.out / NETWORK
    off = export(net, board, samples, pictures, file, simulated)
    result = {
        "network": str(file), "simulated": simulated, "plan": plan, "mode": wish.mode,
        "trunk": "torchvision, frozen" if weights else "trained from nothing",
        "weights_sha256": digest, "presses": int(samples.press.max()) + 1, "frames": len(samples.press),
        "weights": sum(p.numel() for p in net.parameters()), "bytes": file.stat().st_size,
        "opencv_off_pytorch": off, "best": asdict(best), "passes": [asdict(p) for p in trainer.passes],
        "passes_kept": n_kept, "took_s": time.monotonic() - start,
        "most_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }  # fmt: skip
    return Run(file, result, best)


def _plan_of(wish: Wish, note: Callable[[str], None]) -> tuple[Path | None, str]:
    """Weights of the trunk, and which network."""
    if wish.plan == "eighth":
        if wish.weights is not None:
            raise InputError("--weights are of VGG16: leave --plan out, or give --plan vgg16")
        return None, "eighth"
    weights = find_weights(wish.weights)
    if weights is None and wish.plan is None:
        note(f"no {WEIGHTS_NAME} in torchvision's cache and no --weights: VGG16's layers, an eighth as wide, "
             "on half the resolution, are trained from nothing; it is not the paper's network")  # fmt: skip
        return None, "eighth"
    if weights is None:
        note("no weights of VGG16 are there: all of it is trained from nothing, which takes days without a GPU")
    elif not weights.is_file():
        raise InputError(f"{weights}: no such file of weights")
    return weights, "vgg16"


def _some_frames(wish: Wish) -> tuple[list[npt.NDArray[np.uint8]], bool]:
    """The last frames of some presses, and whether they are simulated."""
    folders = press_folders(wish.presses, wish.only)
    pictures = [list(Frames(folder / "frames"))[-1] for folder in folders[:N_CHECKED]]
    return pictures, any(_is_simulated(folder) for folder in folders)


def _is_simulated(folder: Path) -> bool:
    card = folder / "run.json"
    return card.is_file() and bool(json.loads(card.read_text("utf-8")).get("simulated", False))
