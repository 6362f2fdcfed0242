"""Training of the displacement network: AdamW, falling rate, a checkpoint after every pass; a run that was cut goes on.

The same seed gives the same weights on one machine with one thread, cut and taken up again or not.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.train import checkpoint
from ruffini.train.network import DisplacementNet
from ruffini.train.presses import Picture, Samples, shrink_factor
from ruffini.version import __version__

CHECKPOINT = "checkpoint.pt"
BATCH = 16
RATE = 3e-3  # learning rate at its highest, after WARM of the steps
WARM = 0.05
DECAY = 1e-3
HELD_OUT = 10  # every tenth press is for validation
TOUCHED_M = 20e-6  # displacement from which a node counts in the reported error


@dataclass(frozen=True)
class Plan:
    """What the weights follow from, beside the board and its twin."""

    n_presses: int
    n_passes: int
    seed: int


@dataclass(frozen=True)
class Pass:
    """After one pass over the samples: mean loss, and error of moved nodes of presses left out, rms, micrometres."""

    number: int
    loss: float
    error_um: tuple[float, float, float]

    def text(self) -> str:
        return "{:.1f}, {:.1f}, {:.1f} um rms".format(*self.error_um)


class Trainer:
    """One training run in a folder.

    Raises
    ------
    InputError
        The folder holds the checkpoint of another run, or one that cannot be read.
    """

    def __init__(self, board: Board, plan: Plan, rest: Picture, samples: Samples, folder: Path) -> None:
        self._plan, self._folder = plan, folder
        torch.manual_seed(plan.seed)
        is_held = samples.press % HELD_OUT == HELD_OUT - 1
        if is_held.all() or not is_held.any():
            raise InputError(f"{plan.n_presses} presses leave none to validate on: at least {HELD_OUT} are needed")
        self._train, self._held = np.flatnonzero(~is_held), np.flatnonzero(is_held)
        self._picture = torch.from_numpy(samples.picture)
        self._rest = torch.from_numpy(rest)
        observed = samples.displacement[(slice(None), *board.observed)]
        self._target = torch.from_numpy(np.ascontiguousarray(np.moveaxis(observed * 1e6, -1, 1)).astype(np.float32))
        moved = observed[np.abs(observed).max(axis=-1) > TOUCHED_M].astype(np.float64)
        scale_um = 1e6 * np.sqrt((moved**2).mean(axis=0))
        self.net = DisplacementNet(board, rest.shape[:2], shrink_factor(board), scale_um)
        self._optimizer = torch.optim.AdamW(self.net.parameters(), lr=RATE, weight_decay=DECAY)
        told = json.dumps([asdict(plan), board.text, __version__, [list(p.shape) for p in self.net.parameters()]])
        self._told = hashlib.sha256(told.encode()).hexdigest()
        self.passes: list[Pass] = []
        self._resume()

    def run(self, progress: Callable[[float], None] = lambda _: None) -> Iterator[Pass]:
        """The passes that are left, each kept on disk before it is given."""
        n_batches = -(-len(self._train) // BATCH)
        n_steps = n_batches * self._plan.n_passes
        for number in range(len(self.passes), self._plan.n_passes):
            order = np.random.default_rng([self._plan.seed, number]).permutation(self._train)
            self.net.train()
            total = 0.0
            for k in range(n_batches):
                step = number * n_batches + k
                for group in self._optimizer.param_groups:
                    group["lr"] = RATE * _rate_at(step / n_steps)
                total += self._step(order[k * BATCH : (k + 1) * BATCH])
                progress((step + 1) / n_steps)
            self.passes.append(Pass(number + 1, total / n_batches, self._error_um()))
            self._keep()
            yield self.passes[-1]

    def _batch(self, chosen: npt.NDArray[np.int64]) -> tuple[Any, Any]:
        index = torch.from_numpy(chosen)
        frame = self._picture[index]
        both = torch.cat([frame, self._rest.expand_as(frame)], dim=-1)
        return both.permute(0, 3, 1, 2).float().contiguous(), self._target[index]

    def _step(self, chosen: npt.NDArray[np.int64]) -> float:
        pictures, target = self._batch(chosen)
        self._optimizer.zero_grad()
        scale = self.net.scale_um
        loss = torch.nn.functional.smooth_l1_loss(self.net(pictures) / scale, target / scale, beta=0.1)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), 1.0)
        self._optimizer.step()
        return float(loss.detach())

    def _error_um(self) -> tuple[float, float, float]:
        self.net.eval()
        square, n = np.zeros(3), 0
        with torch.no_grad():
            for k in range(0, len(self._held), BATCH):
                pictures, target = self._batch(self._held[k : k + BATCH])
                error = (self.net(pictures) - target).numpy().astype(np.float64)
                moved = np.abs(target.numpy()).max(axis=1) > TOUCHED_M * 1e6
                square += (error**2 * moved[:, None]).sum(axis=(0, 2, 3))
                n += int(moved.sum())
        x, y, z = np.sqrt(square / max(n, 1)).tolist()
        return x, y, z

    def _keep(self) -> None:
        state = {"net": self.net.state_dict(), "optimizer": self._optimizer.state_dict()}
        state["passes"] = [asdict(p) for p in self.passes]
        checkpoint.keep(self._folder / CHECKPOINT, self._told, state)

    def _resume(self) -> None:
        settings = "another board, seed, number of presses or passes, or version"
        state = checkpoint.resume(self._folder / CHECKPOINT, self._told, settings)
        if state is None:
            return
        self.net.load_state_dict(state["net"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.passes = [Pass(p["number"], p["loss"], tuple(p["error_um"])) for p in state["passes"]]


def _rate_at(part: float) -> float:
    """Learning rate over its highest, `part` of the way: a short rise, then a cosine to zero."""
    if part < WARM:
        return part / WARM
    return 0.5 * (1 + float(np.cos(np.pi * (part - WARM) / (1 - WARM))))
