"""The small network of a fingertip: principal components, two hidden layers, means and deviations of seven numbers.

Trained by the likelihood of double exponential errors, so that what cannot be told (where a flat tool's edge is before
it touches) widens its deviation instead of bending the rest. Needs the extra `[train]`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.train import need_torch

Array = npt.NDArray[np.float64]

N_COMPONENTS = 64
HIDDEN = (128, 128)
BATCH = 512
RATE, DECAY = 3e-3, 1e-4
SQUARE_PART = 0.2  # of the rounds, at first, by plain squares
LEAST_LOG2, MOST_LOG2 = -7.0, 2.0


@dataclass(frozen=True)
class TipNetwork:
    """z = projection (f - mean); weights (out, in) and biases of layers; outputs: means, then log2 of deviations."""

    mean: Array
    projection: Array
    weights: list[Array]
    biases: list[Array]

    def components(self, features: Array) -> Array:
        """z (t, k) of features (t, n)."""
        return np.asarray((features - self.mean) @ self.projection.T)

    def __call__(self, features: Array) -> tuple[Array, Array]:
        """Means (t, m) and standard deviations (t, m)."""
        level = self.components(features)
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            level = level @ weight.T + bias
            if i + 1 < len(self.weights):
                level = np.maximum(level, 0)
        n = level.shape[1] // 2
        return level[:, :n], 2.0 ** np.clip(level[:, n:], LEAST_LOG2, MOST_LOG2)


def _projection(features: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Mean and half whitened principal components, (k, n)."""
    mean = features.mean(axis=0)
    some = rng.permutation(len(features))[:6000]
    _, size, rows = np.linalg.svd(features[some] - mean, full_matrices=False)
    n = min(N_COMPONENTS, int((size > 1e-6 * size[0]).sum()))
    deviation = size[:n] / np.sqrt(len(some))
    return mean, rows[:n] / np.sqrt(deviation * deviation[0])[:, None]


def train(features: Array, labels: Array, *, rounds: int, noise: float, seed: int = 0) -> TipNetwork:
    """Fit features (t, n) to labels (t, m) of about unit size; `noise` is added to the features, of this deviation.

    Raises
    ------
    InputError
        PyTorch is not installed.
    """
    need_torch("fitting a fingertip")
    import torch

    torch.manual_seed(seed)
    mean, projection = _projection(features, np.random.default_rng(seed))
    spread = torch.from_numpy(noise * np.linalg.norm(projection, axis=1)).float()
    z = torch.from_numpy((features - mean) @ projection.T).float()
    wanted = torch.from_numpy(labels).float()
    n_labels, width = labels.shape[1], z.shape[1]
    layers: list[torch.nn.Module] = []
    for size in HIDDEN:
        layers += [torch.nn.Linear(width, size), torch.nn.ReLU()]
        width = size
    net = torch.nn.Sequential(*layers, torch.nn.Linear(width, 2 * n_labels))
    optimiser = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=DECAY)
    per_round = (len(z) + BATCH - 1) // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=rounds * per_round)
    for number in range(rounds):
        order = torch.randperm(len(z))
        for start in range(0, len(z), BATCH):
            some = order[start : start + BATCH]
            out = net(z[some] + spread * torch.randn(len(some), len(spread)))
            off, log2 = out[:, :n_labels] - wanted[some], out[:, n_labels:].clamp(LEAST_LOG2, MOST_LOG2)
            if number < SQUARE_PART * rounds:
                loss = (off**2).mean() + 1e-3 * (log2**2).mean()
            else:  # deviation s of a double exponential: density exp(-sqrt 2 |off| / s) / (sqrt 2 s)
                loss = (2**0.5 * off.abs() * torch.exp2(-log2) + 0.6931 * log2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    linear = [layer for layer in net if isinstance(layer, torch.nn.Linear)]
    numbers = [(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in linear]
    return TipNetwork(
        mean,
        projection,
        [np.asarray(w, dtype=float) for w, _ in numbers],
        [np.asarray(b, dtype=float) for _, b in numbers],
    )
