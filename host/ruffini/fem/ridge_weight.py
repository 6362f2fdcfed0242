"""The weight of iFEM 2.0's ridge regression, chosen by L-curve or by generalised cross-validation.

Eq. (2) of the paper minimises |K_21 U_1 + K_22 U_2|^2 + w |U_2|^2. With K_22 = V diag(k) V^T and
b = -V^T K_21 U_1 both norms are sums over the modes,

    residual^2 = sum (w b / (k^2 + w))^2,   size^2 = sum (k b / (k^2 + w))^2,

and so is the score of generalised cross-validation (Golub, Heath and Wahba 1979), what leaving out one equation
after the other would err by: n residual^2 / (sum w / (k^2 + w))^2. The L-curve's corner is its point of largest
curvature in logarithms (Hansen 1992). U_1 are simulated touches (`touches`) with the sensor's noise; neither rule is
told the true forces, but how far off they are at each weight is shown beside. The paper names no rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy.linalg as la

from ruffini.errors import InputError
from ruffini.fem.condense import CondensedSlab, Progress, condense
from ruffini.fem.operators import Noise
from ruffini.fem.slab import Slab
from ruffini.fem.touches import TouchMaker

Array = npt.NDArray[np.float64]
Rule = Literal["lcurve", "cv"]
RULES: tuple[str, ...] = get_args(Rule)

WEIGHTS = np.logspace(-12, 0, 97)  # of the largest eigenvalue squared, as `ridge_operator` takes them
SMALLEST_BEND = 1e-3  # of a corner: a straight line has none but for rounding
N_TOUCHES = 8
SEED = 2


@dataclass(frozen=True)
class WeightCurve:
    """Over WEIGHTS: what the rules see, `residual` (N), `size` (m) and `score` (N^2), and what they do not.

    `error` is the relative L2 error of the nodal forces, `raw_error` that without any ridge.
    """

    weights: Array
    residual: Array
    size: Array
    score: Array
    error: Array
    raw_error: float

    def error_at(self, weight: float) -> float:
        """Error at the nearest weight of the curve; of raw where it is 0."""
        return float(self.error[self.index_of(weight)]) if weight > 0 else self.raw_error

    def index_of(self, weight: float) -> int:
        """Of the nearest weight above 0."""
        return int(np.argmin(np.abs(np.log(self.weights / weight))))

    def chosen(self, rule: str) -> float:
        """The weight that a rule chooses; 0 where cross-validation is best without ridge.

        Raises
        ------
        InputError
            Unknown rule; no corner in the L-curve; a score that still falls at the largest weight.
        """
        if rule not in RULES:
            raise InputError(
                f"unknown rule {rule!r} for the ridge weight: choose one of {', '.join(RULES)}, or a number"
            )
        bend = self.curvature()
        at = int(np.argmax(bend)) if rule == "lcurve" else int(np.argmin(self.score))
        if rule == "cv" and at == 0:
            return 0.0
        if at == len(self.weights) - 1 or (rule == "lcurve" and bend[at] < SMALLEST_BEND):
            raise InputError(
                f"{rule} finds no ridge weight between {self.weights[0]:g} and {self.weights[-1]:g} for this pad and "
                "noise: give --weight a number"
            )
        return float(self.weights[at])

    def curvature(self) -> Array:
        """Of log size over log residual along log weight, positive where it bends as an L does; 0 at both ends."""
        x, y = np.log(self.residual), np.log(self.size)
        t = np.log(self.weights)
        dx, dy = np.gradient(x, t), np.gradient(y, t)
        bend = dx * np.gradient(dy, t) - dy * np.gradient(dx, t)
        out = bend / np.maximum((dx**2 + dy**2) ** 1.5, 1e-300)
        out[:2] = out[-2:] = 0.0
        return np.asarray(out)


def weight_curve(slab: Slab, noise: Noise, *, progress: Progress = lambda _: None) -> WeightCurve:
    """Both rules' curves of a pad, for simulated touches with this noise on every node."""
    condensed = condense(slab, progress=lambda done: progress(0.3 * done))
    maker = TouchMaker(slab, SEED)
    progress(0.6)
    rng = np.random.default_rng(SEED)
    shape = (slab.n_y, slab.n_x, 3)
    touches = [maker.draw() for _ in range(N_TOUCHES)]
    noisy = [touch.displacement + rng.normal(size=shape) * noise.sigma_m for touch in touches]
    progress(0.7)
    return curve_of(
        condensed,
        np.stack([u.ravel() for u in noisy], axis=1),
        np.stack([touch.force.ravel() for touch in touches], axis=1),
    )


def curve_of(condensed: CondensedSlab, displacement: Array, force: Array) -> WeightCurve:
    """The same for surface displacements and true forces (3 n, m), metres and newtons, one column each."""
    weights = np.concatenate([[0.0], WEIGHTS])
    k2_parts, b2_parts = [], []
    largest = max(float(la.eigvalsh(k, subset_by_index=[len(k) - 1, len(k) - 1])[0]) for k in condensed.k_22) ** 2
    error2 = np.zeros(len(weights))
    for k_11, k_12, k_22, q in zip(condensed.k_11, condensed.k_12, condensed.k_22, condensed.bases, strict=True):
        values, vectors = la.eigh(k_22)
        u = q.T @ displacement
        b = -vectors.T @ (k_12.T @ u)
        off, to_force = k_11 @ u - q.T @ force, k_12 @ vectors
        for i, w in enumerate(weights * largest):
            error2[i] += float(((off + to_force @ ((values / (values**2 + w))[:, None] * b)) ** 2).sum())
        k2_parts.append(values**2)
        b2_parts.append((b**2).sum(axis=1))
    k2, b2 = np.concatenate(k2_parts), np.concatenate(b2_parts)
    w = WEIGHTS[:, None] * largest
    residual2 = (b2 * (w / (k2 + w)) ** 2).sum(axis=1)
    size2 = (b2 * k2 / (k2 + w) ** 2).sum(axis=1)
    score = len(k2) * residual2 / (w / (k2 + w)).sum(axis=1) ** 2
    error = np.sqrt(error2) / np.linalg.norm(force)
    return WeightCurve(WEIGHTS, np.sqrt(residual2), np.sqrt(size2), score, error[1:], float(error[0]))


def picture(path: Path, curve: WeightCurve, weight: float, title: str) -> Path:
    """The L-curve, the score, and the error that no rule sees; the weight in use in all three."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4))
    left.loglog(curve.residual, curve.size, color="#2166ac")
    for power in range(-4, 1):
        k = curve.index_of(10.0**power)
        left.annotate(f"1e{power}", (curve.residual[k], curve.size[k]), fontsize=8)
    if weight > 0:
        at = curve.index_of(weight)
        left.plot(curve.residual[at], curve.size[at], "o", color="#d6604d", label=f"w = {weight:.2g}")
        left.legend()
    left.set(xlabel="|K_21 U_1 + K_22 U_2|, N", ylabel="|U_2|, m", title="L-curve", xlim=(1e-3, None))
    middle.loglog(curve.weights, curve.score, color="#2166ac")
    middle.set(ylabel="N^2", title="generalised cross-validation")
    right.semilogx(curve.weights, curve.error, color="#2166ac")
    right.axhline(curve.raw_error, color="grey", linestyle=":", label="raw")
    right.set(ylabel="relative L2 error of the forces", title="what no rule sees", ylim=(0, 3 * curve.raw_error))
    right.legend()
    for axis in (middle, right):
        axis.set(xlabel="w over the largest eigenvalue squared")
        if weight > 0:
            axis.axvline(weight, color="#d6604d")
    figure.suptitle(title, fontsize=11)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
