"""Perceptrons with one hidden layer of tanh units: fitted in float, tabulated for firmware/estimators/perceptron.h."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.container import Tensors

Array = npt.NDArray[np.float64]

STEPS_PER_UNIT, LAST = 64, 8  # of the tanh table
MAX_ENTRY, MAX_SHIFT = 1 << 30, 40
INPUT_ONE, UNIT_ONE, SUM_ONE = 14, 15, 12  # fraction bits of the constant input, of a unit, of a unit's sum
LEAST_SPREAD = 0.05  # of the strongest direction of the inputs: weaker ones are not blown up further
MAX_STEPS = 500


@dataclass(frozen=True)
class Perceptron:
    """y = out . (tanh(hidden . (x, 1)), 1): hidden (h, n + 1), out (k, h + 1)."""

    hidden: Array
    out: Array

    def __call__(self, x: Array) -> Array:
        """(t, k) of inputs (t, n)."""
        return np.asarray(_with_one(np.tanh(_with_one(x) @ self.hidden.T)) @ self.out.T)

    @classmethod
    def fit(
        cls, x: Array, y: Array, *, weights: Array | None = None, n_units: int = 10, n_directions: int = 18,
        decay: float = 1e-4, seed: int = 0,
    ) -> Perceptron:  # fmt: skip
        """Least squares with weight decay, on the strongest directions of the inputs, by L-BFGS.

        x (t, n), y (t, k); the error of each row and output counts `weights` (t, k) times.
        """
        from scipy.optimize import minimize

        mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-12
        _, sizes, axes = np.linalg.svd((x - mean) / spread, full_matrices=False)
        n = min(n_directions, len(axes))
        reach = sizes[:n] / np.sqrt(len(x))
        turn = axes[:n].T / np.maximum(reach, LEAST_SPREAD * reach[0]) / spread[:, None]
        scale, middle = y.std(axis=0) + 1e-12, y.mean(axis=0)
        z, aim = (x - mean) @ turn, (y - middle) / scale
        count = np.ones_like(aim) if weights is None else weights / np.sqrt((weights**2).mean(axis=0))
        loss = _Loss(z, aim, count, n_units, decay)
        weight = minimize(loss, loss.start(seed), jac=True, method="L-BFGS-B",
                          options={"maxiter": MAX_STEPS, "maxfun": 2 * MAX_STEPS}).x  # fmt: skip
        inner, bias, outer, offset = loss.parts(weight)
        hidden = np.column_stack([inner.T @ turn.T, bias - mean @ turn @ inner])
        return cls(hidden, np.column_stack([outer.T * scale[:, None], offset * scale + middle]))

    @classmethod
    def mean_of(cls, parts: list[Perceptron]) -> Perceptron:
        """One perceptron that says the mean of several: their units side by side."""
        n = len(parts)
        offset = np.mean([p.out[:, -1] for p in parts], axis=0)
        outer = np.concatenate([p.out[:, :-1] / n for p in parts], axis=1)
        return cls(np.concatenate([p.hidden for p in parts]), np.column_stack([outer, offset]))

    def tables(self, name: str, input_step: Array, output_step: Array) -> Tensors:
        """Integers of inputs that come in `input_step` (n,), of outputs in `output_step` (k,)."""
        hidden = self.hidden * np.append(input_step, 2.0**-INPUT_ONE) * 2.0**SUM_ONE
        hidden[:, -1] = self.hidden[:, -1] * 2.0 ** (SUM_ONE - INPUT_ONE)
        out = self.out / output_step[:, None] * 2.0**-UNIT_ONE
        shifts = [_shift_of(hidden), _shift_of(out)]
        return {
            f"{name}_hidden": np.round(hidden * 2.0 ** shifts[0]).astype(np.int32),
            f"{name}_out": np.round(out * 2.0 ** shifts[1]).astype(np.int32),
            f"{name}_shift": np.array(shifts, np.uint8),
        }


def tanh_table() -> npt.NDArray[np.int16]:
    """tanh from 0 to LAST, Q15."""
    at = np.arange(LAST * STEPS_PER_UNIT + 1) / STEPS_PER_UNIT
    return np.asarray(np.minimum(np.round(np.tanh(at) * 2**UNIT_ONE), 2**UNIT_ONE - 1), dtype=np.int16)


def run_tables(tensors: Tensors, name: str, x: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """What the integers say of raw inputs (t, n): for the stated error of the tables."""
    table = tanh_table().astype(np.int64)
    hidden, out = (np.asarray(tensors[f"{name}_{part}"], np.int64) for part in ("hidden", "out"))
    s, t = (int(shift) for shift in tensors[f"{name}_shift"])
    a = _rounded(x @ hidden[:, :-1].T + (hidden[:, -1] << INPUT_ONE), s)
    size = np.minimum(np.abs(a), LAST * STEPS_PER_UNIT << 6)
    i = np.minimum(size >> 6, LAST * STEPS_PER_UNIT - 1)
    part = size - (i << 6)
    h = np.sign(a) * _rounded(table[i] * (64 - part) + table[i + 1] * part, 6)
    return _rounded(h @ out[:, :-1].T + (out[:, -1] << UNIT_ONE), t)


def _rounded(x: npt.NDArray[np.int64], shift: int) -> npt.NDArray[np.int64]:
    return np.asarray((x + (1 << (shift - 1))) >> shift, dtype=np.int64)


def _shift_of(values: Array) -> int:
    return int(np.clip(np.floor(np.log2(MAX_ENTRY / max(float(np.abs(values).max()), 1e-12))), 1, MAX_SHIFT))


def _with_one(x: Array) -> Array:
    return np.column_stack([x, np.ones(len(x))])


@dataclass(frozen=True)
class _Loss:
    x: Array
    y: Array
    count: Array
    n_units: int
    decay: float

    def start(self, seed: int) -> Array:
        """Small random weights."""
        n, k, h = self.x.shape[1], self.y.shape[1], self.n_units
        rng = np.random.default_rng(seed)
        inner, outer = rng.normal(size=n * h) / np.sqrt(n), rng.normal(size=h * k) / np.sqrt(h)
        return np.concatenate([inner, rng.normal(size=h) * 0.1, outer, np.zeros(k)])

    def parts(self, weight: Array) -> tuple[Array, Array, Array, Array]:
        n, k, h = self.x.shape[1], self.y.shape[1], self.n_units
        at = np.cumsum([n * h, h, h * k])
        inner, bias, outer, offset = np.split(weight, at)
        return inner.reshape(n, h), bias, outer.reshape(h, k), offset

    def __call__(self, weight: Array) -> tuple[float, Array]:
        inner, bias, outer, offset = self.parts(weight)
        units = np.tanh(self.x @ inner + bias)
        error = (units @ outer + offset - self.y) * self.count
        n = len(self.x)
        value = float((error**2).sum() / n + self.decay * ((inner**2).sum() + (outer**2).sum()))
        back = 2 * error * self.count / n
        before = (back @ outer.T) * (1 - units**2)
        slopes = (self.x.T @ before + 2 * self.decay * inner, before.sum(axis=0),
                  units.T @ back + 2 * self.decay * outer, back.sum(axis=0))  # fmt: skip
        return value, np.concatenate([s.ravel() for s in slopes])
