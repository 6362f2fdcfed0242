"""Contacts of balls in a skin of one colour: the disc that is darker than at rest, to the edge where it is not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.estimators.photometric.change import Change
from ruffini.estimators.photometric.circle import SECTORS, Circle
from ruffini.estimators.photometric.find_balls import NotFound

Array = npt.NDArray[np.float64]

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
