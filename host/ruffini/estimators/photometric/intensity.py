"""Skins of one colour that darken where they are pressed: brightness -> depth, fitted on ball presses.

    z = T(d), d = the mean of the three channels' relative change, T(0) = 0

Inside the contact the depth is the ball's below the contact's edge, z = sqrt(R^2 - a^2) - sqrt(R^2 - r^2). T is a line
of nodes, linear between, held straight by its second differences and run on linearly beyond the darkest press. Where a
press makes the skin brighter (a ring of raised gel round the contact) nobody knows the depth: T is zero there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.container import CalibrationFile
from ruffini.errors import InputError
from ruffini.estimators.photometric.presses import Press, PressSet, relative_change
from ruffini.frames import read_image

Array = npt.NDArray[np.float64]

N_LINES = 257  # of the board's table, from -1 to +1; firmware: PhotometricTable::kDepthSize
N_NODES = 33  # of the fit, from -1 to 0
STIFFNESS = 1e-3  # bending in mm^2 a node, over the mean square misfit in mm^2
FITTED_INSIDE = 0.95  # of the contact radius: light strays into its edge
ANCHOR = 1e3  # weight of T(0) = 0
LSB_PER_MM = 8e3  # 1/8 um


@dataclass(frozen=True)
class IntensityFit:
    """T at the nodes, millimetres (negative: pressed in), and the RMS of each press about its ball, offset removed."""

    node_mm: Array
    fitted_rms_mm: list[float]
    held_out_rms_mm: list[float]  # by a table without that press; empty for one press

    def depth_mm(self, change: Array) -> Array:
        """T(d)."""
        return np.asarray(_weights(change) @ self.node_mm)

    def report(self) -> dict[str, Any]:
        """Residuals for the manifest and the screen."""
        held_out = self.held_out_rms_mm
        return {
            "source": "intensity",
            "n_presses": len(self.fitted_rms_mm),
            "fitted_cap_rms_mm": round(float(np.median(self.fitted_rms_mm)), 4),
            "held_out_cap_rms_mm": round(float(np.median(held_out)), 4) if held_out else None,
        }

    def tabulate(self) -> dict[str, npt.NDArray[Any]]:
        """The table of proto/CALIBRATION.md."""
        z = self.depth_mm(np.linspace(-1, 1, N_LINES)) * LSB_PER_MM
        return {"photometric.depth": np.clip(np.floor(z + 0.5), -32767, 32767).astype(np.int16)}


def has_depth_table(file: CalibrationFile) -> bool:
    """True if a file makes depth of brightness, not slopes of colours."""
    return "photometric.depth" in file.tensors


def _weights(change: Array) -> Array:
    """(n, nodes), linear between; zero where the skin is brighter."""
    at = np.clip((change + 1) * (N_NODES - 1), 0, N_NODES - 1)
    low = np.minimum(at.astype(int), N_NODES - 2)
    out = np.zeros((len(change), N_NODES))
    rows = np.arange(len(change))
    out[rows, low], out[rows, low + 1] = 1 - (at - low), at - low
    return out


def fit_intensity(presses: PressSet) -> IntensityFit:
    """Least squares over all presses; each left out in turn where there are several."""
    samples = [_samples(press, presses) for press in presses.presses]
    node = _solve(samples)
    held_out = []
    if len(samples) > 1:
        for i, sample in enumerate(samples):
            held_out.append(_rms(_solve(samples[:i] + samples[i + 1 :]), sample))
    return IntensityFit(node, [_rms(node, s) for s in samples], held_out)


def _samples(press: Press, presses: PressSet) -> tuple[Array, Array]:
    """Change (n,) and depth (n,) in millimetres of the pixels inside the contact."""
    image = read_image(press.path).astype(float)
    if image.shape != presses.reference.shape:
        raise InputError(f"{press.path}: is of another size than the reference: one size is needed")
    rows, columns = np.indices(image.shape[:2])
    away_mm = np.hypot(columns - press.center_x_px, rows - press.center_y_px) / presses.px_per_mm
    contact_mm, ball_mm = press.radius_px / presses.px_per_mm, presses.ball_mm / 2
    inside = away_mm < FITTED_INSIDE * min(contact_mm, ball_mm)
    if inside.sum() < 50:
        raise InputError(f"{press.path}: only {int(inside.sum())} pixels inside the contact: is its circle right?")
    edge = np.sqrt(max(ball_mm**2 - contact_mm**2, 0.0))
    depth = edge - np.sqrt(ball_mm**2 - away_mm[inside] ** 2)
    return relative_change(image, presses.reference, presses.dark).mean(axis=2)[inside], depth


def _solve(samples: list[tuple[Array, Array]]) -> Array:
    second = np.diff(np.eye(N_NODES), n=2, axis=0)
    gram = STIFFNESS * second.T @ second
    right = np.zeros(N_NODES)
    for change, depth in samples:
        weights = _weights(change)
        gram += weights.T @ weights / len(depth) / len(samples)
        right += weights.T @ depth / len(depth) / len(samples)
    gram[-1, -1] += ANCHOR
    return np.asarray(np.linalg.solve(gram, right), dtype=np.float64)


def _rms(node: Array, sample: tuple[Array, Array]) -> float:
    return float((_weights(sample[0]) @ node - sample[1]).std())
