"""The small network of a fingertip: principal components, two hidden layers, means and deviations of seven numbers.

Trained by the likelihood of double exponential errors, so that what cannot be told (where a flat tool's edge is before
it touches) widens its deviation instead of bending the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

N_COMPONENTS = 64
HIDDEN = (128, 128)
BATCH = 512
RATE, DECAY = 3e-3, 1e-4  # largest learning rate; part of each weight that a step of rate 1 takes away
MOMENTUM, MEMORY = (0.95, 0.85), 0.999  # of the gradient, at the least and at the largest rate; of its squares
RISING_PART, FIRST_RATE, LAST_RATE = 0.3, 1 / 25, 4e-6  # of the steps; of the largest rate
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
        out = _levels(self.components(features), self.weights, self.biases)[-1]
        n = out.shape[1] // 2
        return out[:, :n], 2.0 ** np.clip(out[:, n:], LEAST_LOG2, MOST_LOG2)


def _projection(features: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Mean and half whitened principal components, (k, n)."""
    mean = features.mean(axis=0)
    some = rng.permutation(len(features))[:6000]
    _, size, rows = np.linalg.svd(features[some] - mean, full_matrices=False)
    n = min(N_COMPONENTS, int((size > 1e-6 * size[0]).sum()))
    deviation = size[:n] / np.sqrt(len(some))
    return mean, rows[:n] / np.sqrt(deviation * deviation[0])[:, None]


def _levels(z: npt.NDArray[Any], weights: list[Any], biases: list[Any]) -> list[npt.NDArray[Any]]:
    """Input, what each hidden layer passes on, and the output."""
    levels = [z]
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        level = levels[-1] @ weight.T + bias
        levels.append(np.maximum(level, 0) if i + 1 < len(weights) else level)
    return levels


def _slope(out: Floats, wanted: Floats, *, is_first: bool) -> Floats:
    """Derivative of the loss by the outputs (b, 2 m): means, then log2 of deviations.

    At first the loss is the mean of squares; then -log of the density of a double exponential of deviation s,
    sqrt 2 |off| / s + log s.
    """
    n = wanted.shape[1]
    off, log2 = out[:, :n] - wanted, np.clip(out[:, n:], LEAST_LOG2, MOST_LOG2)
    if is_first:
        by_mean, by_log2 = 2 * off, 2e-3 * log2
    else:
        per_s = np.float32(2**0.5) * np.exp2(-log2)
        by_mean, by_log2 = per_s * np.sign(off), np.float32(np.log(2)) * (1 - per_s * np.abs(off))
    by_log2 = np.where(log2 == out[:, n:], by_log2, 0)
    return np.asarray(np.concatenate([by_mean, by_log2], axis=1) / np.float32(off.size))


class _AdamW:
    """Adam with decoupled weight decay (Loshchilov and Hutter, 2019); one cycle of rate and momentum (Smith, 2018)."""

    def __init__(self, parameters: list[Floats], n_steps: int) -> None:
        self._parameters, self._n_steps, self._step = parameters, n_steps, 0
        self._first = [np.zeros_like(p) for p in parameters]
        self._second = [np.zeros_like(p) for p in parameters]
        self._first_weight = 0.0  # of the gradients in `_first`, all together

    def _rate_and_momentum(self) -> tuple[float, float]:
        """Cosines from the first rate to the largest, and from there to the last."""
        rising = RISING_PART * self._n_steps - 1
        if self._step <= rising:
            part, low = 0.5 - 0.5 * np.cos(np.pi * self._step / max(rising, 1)), FIRST_RATE
        else:
            part, low = 0.5 + 0.5 * np.cos(np.pi * (self._step - rising) / (self._n_steps - 1 - rising)), LAST_RATE
        return RATE * (low + (1 - low) * part), MOMENTUM[0] + (MOMENTUM[1] - MOMENTUM[0]) * part

    def step(self, gradients: list[Floats]) -> None:
        rate, momentum = self._rate_and_momentum()
        self._step += 1
        self._first_weight = momentum * self._first_weight + 1 - momentum
        second_weight = 1 - MEMORY**self._step
        for p, g, first, second in zip(self._parameters, gradients, self._first, self._second, strict=True):
            first += (1 - momentum) * (g - first)
            second += (1 - MEMORY) * (g * g - second)
            p *= 1 - rate * DECAY
            p -= rate / self._first_weight * first / (np.sqrt(second / second_weight) + np.float32(1e-8))


def train(features: Array, labels: Array, *, rounds: int, noise: float, seed: int = 0) -> TipNetwork:
    """Fit features (t, n) to labels (t, m) of about unit size; `noise` is added to the features, of this deviation."""
    rng = np.random.default_rng(seed)
    mean, projection = _projection(features, rng)
    spread = (noise * np.linalg.norm(projection, axis=1)).astype(np.float32)
    z, wanted = ((features - mean) @ projection.T).astype(np.float32), labels.astype(np.float32)
    sizes = [z.shape[1], *HIDDEN, 2 * labels.shape[1]]
    weights = [_uniform(rng, n_in, (n_out, n_in)) for n_in, n_out in pairwise(sizes)]
    biases = [_uniform(rng, n_in, (n_out,)) for n_in, n_out in pairwise(sizes)]
    adam = _AdamW([*weights, *biases], rounds * -(-len(z) // BATCH))
    for number in range(rounds):
        order = rng.permutation(len(z))
        for start in range(0, len(z), BATCH):
            some = order[start : start + BATCH]
            levels = _levels(
                z[some] + spread * rng.standard_normal((len(some), len(spread)), np.float32), weights, biases
            )
            slope = _slope(levels[-1], wanted[some], is_first=number < SQUARE_PART * rounds)
            by_weights: list[Floats] = []
            by_biases: list[Floats] = []
            for i in reversed(range(len(weights))):
                by_weights.insert(0, slope.T @ levels[i])
                by_biases.insert(0, slope.sum(axis=0))
                slope = (slope @ weights[i]) * (levels[i] > 0)
            adam.step([*by_weights, *by_biases])
    return TipNetwork(mean, projection, [w.astype(float) for w in weights], [b.astype(float) for b in biases])


def _uniform(rng: np.random.Generator, n_in: int, shape: tuple[int, ...]) -> Floats:
    """Weights at the start: within one over the root of the number of inputs."""
    return np.asarray(rng.uniform(-1, 1, shape) / np.sqrt(n_in), dtype=np.float32)
