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

from ruffini.calibrate.contact_circle import SECTORS, Circle
from ruffini.calibrate.find_balls import NotFound
from ruffini.calibrate.press_change import Change
from ruffini.calibrate.presses import Press, PressSet, relative_change
from ruffini.errors import InputError
from ruffini.frames import read_image

Array = npt.NDArray[np.float64]

N_LINES = 257  # of the board's table, from -1 to +1; firmware: PhotometricTable::kDepthSize
N_NODES = 33  # of the fit, from -1 to 0
STIFFNESS = 1e-3  # bending in mm^2 a node, over the mean square misfit in mm^2
FITTED_INSIDE = 0.95  # of the contact radius: light strays into its edge
ANCHOR = 1e3  # weight of T(0) = 0
LSB_PER_MM = 8e3  # 1/8 um
MOST_CHROMA = 0.25  # spread of the channels' changes over their mean: side light of several colours has above 1
DARK_SHARE = 0.3  # of the darkest: what is surely inside the contact
SMOOTH_PX = 1.5
LEAST_CHANGE = 0.03  # of light at its darkest: less is no press
LEAST_NOISES = 8.0  # of the smoothed picture
SECOND_DISC = 0.4  # of the largest dark disc's area: another contact
EDGE_ANGLES = 64
LEAST_EDGES = 0.6  # of those that are in the picture


def is_monochrome(changes: list[Change]) -> bool:
    """Whether all channels change alike where the skin is pressed."""
    chroma, mean = [], []
    for change in changes:
        size = np.linalg.norm(change.light, axis=2)
        pressed = change.light[size > 0.5 * np.quantile(size, 0.995)]
        chroma.append(float(pressed.std(axis=1).mean()))
        mean.append(float(np.abs(pressed.mean(axis=1)).mean()))
    return bool(changes) and float(np.median(chroma)) < MOST_CHROMA * float(np.median(mean))


def find_discs(changes: list[Change]) -> list[Circle | NotFound]:
    """The contact in each picture: the circle at which the skin, dark inside, is as it is at rest."""
    return [_disc(change) for change in changes]


def _disc(change: Change) -> Circle | NotFound:
    import cv2

    light = cv2.GaussianBlur(change.light.mean(axis=2), (0, 0), SMOOTH_PX)
    least = max(LEAST_CHANGE, LEAST_NOISES * float(change.noise.mean()))
    darkest = float(np.quantile(light, 0.002))
    if darkest > -least:
        return NotFound(f"nothing is darker by {100 * least:.0f} % than the reference")
    _, _, stats, centres = cv2.connectedComponentsWithStats((light < DARK_SHARE * darkest).astype(np.uint8))
    order = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])
    if len(order) > 1 and stats[order[1], cv2.CC_STAT_AREA] > SECOND_DISC * stats[order[0], cv2.CC_STAT_AREA]:
        return NotFound("there are two contacts: press with one ball at a time")
    x, y = centres[order[0]]
    edge = _edges(light, float(x), float(y))
    known = np.isfinite(edge)
    if known.sum() < LEAST_EDGES * EDGE_ANGLES:
        return NotFound("the dark disc has no edge inside the picture")
    return _circle(float(x), float(y), edge, change.px)


def _edges(light: Array, x: float, y: float) -> Array:
    """How far from (x, y) the light is back at rest, along each of `EDGE_ANGLES` ways; NaN outside the picture."""
    import cv2

    height, width = light.shape
    angle = 2 * np.pi * np.arange(EDGE_ANGLES) / EDGE_ANGLES
    away = np.arange(0, max(height, width), 0.5)
    columns, rows = x + np.cos(angle)[:, None] * away, y + np.sin(angle)[:, None] * away
    seen = cv2.remap(light.astype(np.float32), columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0)  # fmt: skip
    out = np.full(EDGE_ANGLES, np.nan)
    for i, line in enumerate(seen):
        back = np.flatnonzero(line >= 0)
        if len(back) and 0 <= columns[i, back[0]] <= width - 1 and 0 <= rows[i, back[0]] <= height - 1:
            before = back[0] - 1
            step = line[back[0]] - line[before] if back[0] else 1.0
            out[i] = away[back[0]] - 0.5 * line[back[0]] / max(step, 1e-9)
    return out


def _circle(x: float, y: float, edge: Array, px: float) -> Circle:
    """The circle of edge distances round a first centre, robust; in the picture's own pixels."""
    angle = 2 * np.pi * np.arange(EDGE_ANGLES) / EDGE_ANGLES
    known = np.isfinite(edge)
    terms = np.stack([np.ones(EDGE_ANGLES), np.cos(angle), np.sin(angle)], axis=1)[known]
    weight = np.ones(len(terms))
    found = np.zeros(3)
    for _ in range(10):
        weighted = terms * weight[:, None]
        found = np.linalg.solve(weighted.T @ terms, weighted.T @ edge[known])
        left = edge[known] - terms @ found
        scale = max(1.4826 * float(np.median(np.abs(left))), 0.1)
        weight = 1 / (1 + (left / (2 * scale)) ** 2)
    sector = np.flatnonzero(known) * 2 * SECTORS // EDGE_ANGLES
    pull = weighted * left[:, None]
    sums = np.stack([np.bincount(sector, pull[:, i], minlength=2 * SECTORS) for i in range(3)], axis=1)
    inverse = np.linalg.inv(weighted.T @ terms)
    sigma = np.sqrt(np.diag(inverse @ (sums.T @ sums) @ inverse))
    right, down, radius = map(float, (found[1], found[2], found[0]))
    return Circle((x + right + 0.5) * px - 0.5, (y + down + 0.5) * px - 0.5, radius * px,
                  float(np.hypot(sigma[1], sigma[2]) / np.sqrt(2)) * px, float(sigma[0]) * px)  # fmt: skip


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
