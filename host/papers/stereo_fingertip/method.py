"""Force, position and angle from a stereo pair: "Vision-Based Tactile Sensor Mechanism for the Estimation of Contact
Position and Force Distribution Using Deep Learning" (Kakani, Cui, Ma, Kim), section 3.4. A STAND-IN, not the paper's
network.

As in the paper: region of interest rows 24 to 216 and columns 47 to 271 of each 320 x 240 view, the four input modes,
pictures scaled to [-1, 1], labels to [0, 1] by eq. (1), one regression for all labels. In place of VGG16 with its two
layers of 4,096 units, which takes days to train without a graphics processor: means over 16 x 16 px, their principal
components, and one hidden layer of tanh units, trained by L-BFGS with weight decay. It is told nothing of pins or
stereo, as VGG16 is not; it has far less capacity, and it needs far less data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

ROWS, COLUMNS = slice(24, 216), slice(47, 271)
BLOCK_PX = 16
BINARY_LEVEL = 90  # of modes 2 and 3; the paper prints none
N_COMPONENTS = 20
N_HIDDEN = 24
DECAY = 1e-5  # of the weights
MAX_ROUNDS = 600


def inputs(picture: Picture, mode: int = 1) -> Array:
    """Block means of a frame of two views side by side, (n,), in [-1, 1].

    mode : 0 left; 1 left and right; 2 left binarised; 3 both binarised. The paper infers with mode 1.
    """
    import cv2

    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.float64)
    width = grey.shape[1] // 2
    views = [grey[:, :width], grey[:, width:]][: 1 if mode in (0, 2) else 2]
    parts = []
    for view in views:
        seen = view[ROWS, COLUMNS]
        if mode in (2, 3):
            seen = np.where(seen > BINARY_LEVEL, 255.0, 0.0)
        blocks = seen.reshape(seen.shape[0] // BLOCK_PX, BLOCK_PX, seen.shape[1] // BLOCK_PX, BLOCK_PX)
        parts.append(blocks.mean(axis=(1, 3)).ravel() / 127.5 - 1)
    return np.concatenate(parts)


@dataclass(frozen=True)
class Regression:
    """The fitted stand-in."""

    mean: Array
    components: Array
    low: Array
    high: Array
    weights: Array

    @classmethod
    def fit(cls, rows: Array, labels: Array, *, seed: int = 0) -> Regression:
        """From inputs (n, k) and labels (n, m)."""
        from scipy.optimize import minimize

        mean = rows.mean(axis=0)
        _, size, axes = np.linalg.svd(rows - mean, full_matrices=False)
        n_kept = min(N_COMPONENTS, len(size))
        components = axes[:n_kept].T / (size[:n_kept] / np.sqrt(len(rows)))
        low, high = labels.min(axis=0), labels.max(axis=0)
        x, y = (rows - mean) @ components, (labels - low) / np.maximum(high - low, 1e-12)
        n_weights = N_HIDDEN * (n_kept + 1) + labels.shape[1] * (N_HIDDEN + 1)
        start = np.random.default_rng(seed).normal(0, 0.2, n_weights)
        done = minimize(_loss, start, args=(x, y), jac=True, method="L-BFGS-B", options={"maxiter": MAX_ROUNDS})
        return cls(mean, components, low, high, done.x)

    def __call__(self, rows: Array) -> Array:
        """Labels (n, m) of inputs (n, k)."""
        x = (rows - self.mean) @ self.components
        hidden, outer = _split(self.weights, x.shape[1], len(self.low))
        y = np.tanh(x @ hidden[:-1] + hidden[-1]) @ outer[:-1] + outer[-1]
        return np.asarray(self.low + y * (self.high - self.low))


def _split(weights: Array, n_in: int, n_out: int) -> tuple[Array, Array]:
    size = N_HIDDEN * (n_in + 1)
    return weights[:size].reshape(n_in + 1, N_HIDDEN), weights[size:].reshape(N_HIDDEN + 1, n_out)


def _loss(weights: Array, x: Array, y: Array) -> tuple[float, Array]:
    """Mean square error with decay, and its gradient."""
    hidden, outer = _split(weights, x.shape[1], y.shape[1])
    level = np.tanh(x @ hidden[:-1] + hidden[-1])
    error = level @ outer[:-1] + outer[-1] - y
    back = (error @ outer[:-1].T) * (1 - level**2)
    gradient = [x.T @ back, back.sum(axis=0)[None], level.T @ error, error.sum(axis=0)[None]]
    flat = np.concatenate([g.ravel() for g in gradient]) * 2 / error.size
    return float((error**2).mean() + DECAY * (weights**2).sum()), flat + 2 * DECAY * weights
