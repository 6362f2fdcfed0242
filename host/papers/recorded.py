"""Recordings of a paper's bench, as its method reads them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.sim.reproduce.runs import Run, runs_of
from ruffini.sim.reproduce.settings import load_reproduce

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Progress = Callable[[float], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Recorded:
    """One run of the bench. What the method may read is in `rig` and the pictures; `truth` is for judging."""

    run: Run
    folder: Path

    @property
    def set_name(self) -> str:
        return self.run.settings.name

    @property
    def part(self) -> str:
        return self.run.settings.part

    @cached_property
    def truth(self) -> dict[str, Array]:
        return _arrays(self.folder / "truth.npz")

    @cached_property
    def rig(self) -> dict[str, Array]:
        return _arrays(self.folder / "rig.npz")

    @property
    def touched(self) -> npt.NDArray[np.intp]:
        """Numbers of the frames in which something touches or loads."""
        return np.flatnonzero(self.truth["judged"].astype(bool))

    def picture(self, frame: int) -> Picture:
        """Frame by number, (h, w, 3) uint8 B G R."""
        import cv2

        return np.asarray(cv2.imread(str(self.folder / "frames" / f"{frame:06d}.png")), dtype=np.uint8)

    def rest(self) -> Array:
        """Mean of the untouched frames before the first touch, (h, w, 3)."""
        first = int(self.touched[0])
        return np.asarray(np.mean([self.picture(i) for i in range(first)], axis=0, dtype=np.float64))


def _arrays(path: Path) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def recorded_runs(board: Board, folder: Path, *, quick: bool) -> list[Recorded]:
    """Every run that is there; those that found no solution are not."""
    runs = runs_of(load_reproduce(board), quick=quick)
    return [Recorded(run, folder / run.key) for run in runs if (folder / run.key / "run.json").is_file()]


def each_played(
    play: Callable[[Recorded], T], runs: Sequence[Recorded], n_workers: int, progress: Progress = lambda _: None
) -> list[T]:
    """`play` of every run, in their order. Threads: the core and the reading of pictures leave the interpreter free."""
    out: list[T] = []
    with ThreadPoolExecutor(n_workers) as pool:
        try:
            for played in pool.map(play, runs):
                out.append(played)
                progress(len(out) / len(runs))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # Ctrl-C does not wait for what has not begun
            raise
    return out


def shape_of(recorded: Recorded) -> str:
    """Its indenter, as the set's list names it."""
    chosen: dict[str, Any] = json.loads((recorded.folder / "run.json").read_text())["chosen"]
    return str(chosen["indenter"])
