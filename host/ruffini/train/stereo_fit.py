"""Training of the stereo paper's network: AdamW, a checkpoint after every pass; a run that was cut goes on.

With a trunk that was trained elsewhere only the dense layers are trained: the trunk's features are computed once and
kept on disk. The pass that is best on presses left out is the one that is exported, as in the paper.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from ruffini.errors import InputError
from ruffini.files import write_whole
from ruffini.sim.cache import cache_folder
from ruffini.train import checkpoint
from ruffini.train.stereo_frames import UNITS, Samples
from ruffini.train.stereo_network import PLANS, StereoNet, load_trunk
from ruffini.version import __version__

Progress = Callable[[float], None]
Index = npt.NDArray[np.int64]

CHECKPOINT = "stereo-checkpoint.pt"
BATCH = 16
RATE = {"vgg16": 1e-4, "eighth": 1e-3}  # learning rate at its highest
DECAY = 1e-2
WARM = 0.3  # of the steps, until the rate is at its highest
HELD_OUT = 10  # every tenth press is for validation


@dataclass(frozen=True)
class Choice:
    """What the weights follow from, beside the samples. weights : SHA-256 of the trunk's file; none: trained here."""

    plan: str
    mode: int
    n_passes: int
    seed: int
    weights: str | None = None


@dataclass(frozen=True)
class Pass:
    """After one pass: mean loss, and mean absolute error on presses left out: N, mm x 3, degrees x 2."""

    number: int
    loss: float
    error: tuple[float, ...]
    score: float  # mean over the labels, each over its range

    def text(self) -> str:
        force, way, x, y, roll, pitch = self.error
        return f"{force:.3f} N, {way:.3f} mm deep, {x:.2f} and {y:.2f} mm aside, {roll:.2f} and {pitch:.2f} degrees"


class StereoTrainer:
    """One training run in a folder.

    Raises
    ------
    InputError
        The folder holds the checkpoint of another run, or no press is left to validate on.
    """

    def __init__(
        self, choice: Choice, samples: Samples, folder: Path, weights: Path | None, progress: Progress = lambda _: None
    ) -> None:
        self._choice, self._folder = choice, folder
        torch.manual_seed(choice.seed)
        is_held = samples.press % HELD_OUT == HELD_OUT - 1
        if is_held.all() or not is_held.any():
            raise InputError(f"{samples.press.max() + 1} presses leave none to validate on: at least 10 are needed")
        self._train, self._held = np.flatnonzero(~is_held), np.flatnonzero(is_held)
        low = np.nanmin(samples.labels, axis=0)
        high = np.maximum(np.nanmax(samples.labels, axis=0), low + 1)  # a label that is always the same has no range
        self.net = StereoNet(PLANS[choice.plan], choice.mode, low, high)
        if weights is not None:
            load_trunk(self.net, weights)
        self._is_frozen = weights is not None
        self._wanted = torch.from_numpy((samples.labels - low) / (high - low)).float()
        self._input = torch.from_numpy(samples.views)
        self._unit = (high - low) / UNITS
        self._told = samples.digest(json.dumps([asdict(choice), __version__]).encode())
        if self._is_frozen:
            self.net.trunk.requires_grad_(False)
            self._input = torch.from_numpy(self._features(progress))
        self._optimizer = torch.optim.AdamW(
            [p for p in self.net.parameters() if p.requires_grad], lr=RATE[choice.plan], weight_decay=DECAY
        )
        self.passes: list[Pass] = []
        self._best: dict[str, torch.Tensor] = {}
        self._resume()

    def run(self, progress: Progress = lambda _: None) -> Iterator[Pass]:
        """The passes that are left, each kept on disk before it is given."""
        n_batches = -(-len(self._train) // BATCH)
        n_steps = n_batches * self._choice.n_passes
        for number in range(len(self.passes), self._choice.n_passes):
            torch.manual_seed(self._choice.seed + number)  # of dropout
            order = np.random.default_rng([self._choice.seed, number]).permutation(self._train)
            self._learn(True)
            total = 0.0
            for k in range(n_batches):
                step = number * n_batches + k
                for group in self._optimizer.param_groups:
                    group["lr"] = RATE[self._choice.plan] * _rate_at(step / n_steps)
                total += self._step(order[k * BATCH : (k + 1) * BATCH])
                progress((step + 1) / n_steps)
            self._judge(number + 1, total / n_batches)
            self._keep()
            yield self.passes[-1]

    def best(self) -> tuple[StereoNet, Pass]:
        """The network of the pass that erred least on presses left out."""
        self.net.load_state_dict(self._best, strict=False)
        self.net.eval()
        return self.net, min(self.passes, key=lambda p: p.score)

    def _learn(self, is_learning: bool) -> None:
        self.net.train(is_learning)
        if self._is_frozen:
            self.net.trunk.eval()

    def _out(self, chosen: Index) -> torch.Tensor:
        given = self._input[torch.from_numpy(chosen)].float()
        return self.net.head(given) if self._is_frozen else self.net.from_views(given)

    def _step(self, chosen: Index) -> float:
        wanted = self._wanted[torch.from_numpy(chosen)]
        is_told = wanted.isfinite()
        self._optimizer.zero_grad()
        loss = torch.nn.functional.smooth_l1_loss(self._out(chosen)[is_told], wanted[is_told], beta=0.05)
        loss.backward()
        self._optimizer.step()
        return float(loss.detach())

    def _judge(self, number: int, loss: float) -> None:
        self._learn(False)
        with torch.no_grad():
            out = torch.cat([self._out(self._held[k : k + BATCH]) for k in range(0, len(self._held), BATCH)])
        off = np.nanmean(np.abs((out - self._wanted[torch.from_numpy(self._held)]).numpy()), axis=0)
        self.passes.append(Pass(number, loss, tuple((off * self._unit).tolist()), float(off.mean())))
        if self.passes[-1].score == min(p.score for p in self.passes):
            self._best = {name: value.clone() for name, value in self._own_state().items()}

    def _features(self, progress: Progress) -> npt.NDArray[np.float16]:
        """Of every sample, from the disk where they are kept."""
        hashed = hashlib.sha256(f"{self._choice.weights} {self._choice.mode} ".encode())
        hashed.update(self._input.numpy().data)
        path = cache_folder().parent / "train" / f"features-{hashed.hexdigest()[:32]}.npy"
        try:
            kept = np.load(path, allow_pickle=False)
            os.utime(path)
            return np.asarray(kept, dtype=np.float16)
        except (OSError, ValueError):
            pass  # not there, or not whole
        self.net.eval()
        parts = []
        with torch.no_grad():
            for k in range(len(self._input)):
                parts.append(self.net.features(self._input[k : k + 1].float()).numpy().astype(np.float16))
                progress((k + 1) / len(self._input))
        file = io.BytesIO()
        np.save(file, np.concatenate(parts))
        write_whole(path, file.getvalue(), remedy="make room and run the same command again", is_durable=False)
        return np.concatenate(parts)

    def _own_state(self) -> dict[str, torch.Tensor]:
        """What this run trains: without a trunk that comes from elsewhere."""
        state: dict[str, torch.Tensor] = self.net.state_dict()
        return {name: v for name, v in state.items() if not (self._is_frozen and name.startswith("trunk."))}

    def _keep(self) -> None:
        state = {"net": self._own_state(), "best": self._best, "optimizer": self._optimizer.state_dict()}
        state["passes"] = [asdict(p) for p in self.passes]
        checkpoint.keep(self._folder / CHECKPOINT, self._told, state)

    def _resume(self) -> None:
        settings = "other presses, mode, plan, seed, weights, number of passes, or version"
        state = checkpoint.resume(self._folder / CHECKPOINT, self._told, settings)
        if state is None:
            return
        self.net.load_state_dict(state["net"], strict=False)
        self._best = state["best"]
        self._optimizer.load_state_dict(state["optimizer"])
        self.passes = [Pass(p["number"], p["loss"], tuple(p["error"]), p["score"]) for p in state["passes"]]


def _rate_at(part: float) -> float:
    """Learning rate over its highest, `part` of the way: up and down by cosines."""
    way = part / WARM if part < WARM else 1 + (part - WARM) / (1 - WARM)
    return 0.5 - 0.5 * float(np.cos(np.pi * way)) + 1e-3
