"""The free constant of depth from light, by what touches do to a pad: the `gauge` kind of a calibration file.

Light tells slopes, so depth has a constant of its own: u_z = z + c, and the motion of the markers, whose perspective is
taken off with z, is off by X c / H. What does not depend on c tells m, the mean of the true u_z over the nodes:

    spacing   u_xy - X mean(z) / H     nearness moves the markers outwards; the rubber spreads only where it is touched
    volume    z - mean(z)              nearly incompressible rubber that sinks in one place rises around it
    both

as the best linear estimate over simulated touches, m = w . f, w = (E[f f^T] + R)^-1 E[f m], R what the noise of markers
and depth makes of f, and what light gets wrong in the size of a dent. On the board it is one row on the displacement
that it has, whatever constant is in that:

    c = w . f - mean(z) = row . u.

Margin and mean (`gauge`) need no table: zero is the mean over the window's rim, or over all of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.linalg as la

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.operator.marker_depth import BATCH, LEAST_M, View, with_mirror_images
from ruffini.fem.operators import Noise, depth_modes
from ruffini.fem.slab import Slab
from ruffini.fem.touches import MaterialSpread, TouchMaker

Array = npt.NDArray[np.float64]

N_TOUCHES = 300  # drawn to fit, four times as many with their mirror images
N_JUDGED = 120
SEED = 50_000
# Standard deviation of what light gets wrong in the size of a dent, as a share: by it the volume of the twin's rendered
# presses is off (`tests/bench/depth_gauge.py --development`). Steep walls are seen too flat.
DENT_ERROR = 0.2
FAR_M = 1e3  # camera without perspective
LARGEST_WEIGHT = 32_767
MAX_SHIFT = 40
AXES = {"spacing": (0, 1), "volume": (2,), "both": (0, 1, 2)}


@dataclass(frozen=True)
class DepthGauge:
    """`row` (n_y, n_x, 3) without unit: the constant that a displacement of the observed nodes lacks.

    `gauge_m`: how far it is off on other touches of pads that are not quite this one, root mean square.
    """

    row: Array
    view: View
    gauge_m: float

    def constant(self, u: Array) -> Array:
        """c of displacements (k, n_y, n_x, 3), metres."""
        return np.asarray(np.einsum("abc,kabc->k", self.row, u))

    def lift(self, u: Array) -> Array:
        """Displacements (k, n_y, n_x, 3) with their constant."""
        c = self.constant(u)[:, None, None, None]
        sideways = u[..., :2] + (self.view.place_m + u[..., :2]) * c / self.view.standoff_m
        return np.concatenate([sideways, u[..., 2:] + c], axis=-1)

    def tables(self) -> tuple[dict[str, npt.NDArray[np.int16]], dict[str, str]]:
        """Tensor and metadata of the kind `gauge` (proto/CALIBRATION.md)."""
        shift = min(int(np.log2(LARGEST_WEIGHT / np.abs(self.row).max())), MAX_SHIFT)
        if shift < 1:
            raise InputError("the depth's gauge is no estimate: its weights are too large for the board's integers")
        weight = np.round(self.row * 2.0**shift).astype(np.int16)
        return {"gauge.weight": weight.reshape(-1, 3)}, {
            "gauge.shift": str(shift), "gauge.sigma_um": str(int(np.ceil(self.gauge_m * 1e6)))
        }  # fmt: skip


class LitNodes:
    """What the nodes show of touches under lamps, all but the depth's constant, and the covariance of its noise."""

    def __init__(self, board: Board, slab: Slab, noise: Noise) -> None:
        self.view, self.noise, self.observed = View.of(board), noise, board.observed
        self._far = replace(self.view, standoff_m=FAR_M)  # perspective is corrected, up to the constant
        modes = depth_modes(slab, replace(noise, gauge_m=0.0)).reshape(slab.n_y, slab.n_x, 3, -1)
        self._modes = modes[board.observed][..., 2, :]
        n = self.view.place_m[..., 0].size
        centre = np.eye(n) - 1 / n
        tilt = self._modes.reshape(n, -1)
        depth = centre @ (np.eye(n) * noise.sigma_m[2] ** 2 + tilt @ tilt.T) @ centre
        place = self.view.place_m.reshape(n, 2) / self.view.standoff_m
        self.shows = np.concatenate([place, np.ones((n, 1))], axis=1)  # of an error of depth, in x, y and z
        covariance = self.of_depth(depth)
        covariance[:, :2, :, :2] += self.view.noise_covariance(noise.sigma_m).reshape(n, 2, n, 2)
        covariance[:, 2, :, 2] += np.eye(n) * LEAST_M**2
        self.covariance = covariance

    def of_depth(self, covariance: Array) -> Array:
        """What an error of the depth's shape (nodes, nodes) does to all that is seen, (nodes, 3, nodes, 3)."""
        return np.asarray(np.einsum("ia,ij,jb->iajb", self.shows, covariance, self.shows))

    def mean(self, u: Array) -> Array:
        """m of displacements of the whole pad (k, rows, columns, 3)."""
        rows, columns = self.observed
        return np.asarray(u[:, rows, columns, 2].mean(axis=(1, 2)))

    def seen(self, u: Array, rng: np.random.Generator | None = None) -> Array:
        """(k, n_y, n_x, 3) with a mean depth of zero; with noise where `rng` is given."""
        rows, columns = self.observed
        z, white = u[:, rows, columns, 2], None
        sideways = (self.view.place_m / self.view.standoff_m)[None]
        off = np.zeros_like(z)
        if rng is not None:
            white = rng.normal(size=(len(u), *self.view.marker_m.shape)) * self.noise.sigma_m[:2]
            off = rng.normal(size=z.shape) * self.noise.sigma_m[2]
            off += np.einsum("abm,km->kab", self._modes, rng.normal(size=(len(u), self._modes.shape[-1])))
        off -= (z + off).mean(axis=(1, 2), keepdims=True)
        xy = self._far.seen(u, white) + sideways * off[..., None]
        return np.concatenate([xy, (z + off)[..., None]], axis=-1)


def fit_depth_gauge(board: Board, slab: Slab, noise: Noise) -> DepthGauge:
    """The row for one board and pad, by the means that [depth] gauge names, and how far it is off.

    Parameters
    ----------
    noise : Noise
        Of the markers and of the depth; `gauge_m` does not count.

    Raises
    ------
    InputError
        The board's gauge needs no table, or its markers are no lattice.
    """
    if not board.depth.has_gauge_table:
        raise InputError(f"[depth] gauge {board.depth.gauge!r} of board {board.name!r} needs no table")
    axes = AXES[board.depth.gauge]
    pad, maker = LitNodes(board, slab, noise), TouchMaker(slab, SEED)
    n = pad.view.place_m[..., 0].size
    square, cross = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    for _ in range(N_TOUCHES // BATCH):
        u = with_mirror_images(np.array([maker.draw().displacement for _ in range(BATCH)]))
        f = pad.seen(u).reshape(len(u), -1)
        square += f.T @ f / (4 * N_TOUCHES)
        cross += f.T @ pad.mean(u) / (4 * N_TOUCHES)
    noise_of_all = pad.covariance + DENT_ERROR**2 * pad.of_depth(square[2::3, 2::3])
    keep = np.isin(np.tile(range(3), n), axes)
    square += noise_of_all.reshape(square.shape)
    solved = np.zeros(3 * n)
    solved[keep] = la.solve(square[np.ix_(keep, keep)], cross[keep], assume_a="pos")
    weight = solved.reshape(n, 3)
    weight[:, 2] -= weight[:, 2].mean() + (1 + (weight[:, :2] * pad.shows[:, :2]).sum()) / n
    row = weight.reshape(*pad.view.place_m.shape[:2], 3)
    gauge = DepthGauge(row, pad.view, 0.0)
    return replace(gauge, gauge_m=_judged(slab, pad, gauge))


def _judged(slab: Slab, pad: LitNodes, gauge: DepthGauge) -> float:
    """How far it is off on touches of pads off by the material's spread, with all that disturbs, metres."""
    rng, off = np.random.default_rng(SEED), []
    pads = MaterialSpread().pads(slab)
    for i, other in enumerate(pads):
        maker = TouchMaker(other, SEED + 1 + i)
        u = np.array([maker.draw().displacement for _ in range(N_JUDGED // len(pads))])
        seen = pad.seen(u, rng)
        wrong = DENT_ERROR * rng.normal(size=(len(u), 1, 1, 1)) * seen[..., 2:]
        seen = seen + wrong * pad.shows.reshape(*seen.shape[1:])
        off.append(gauge.constant(seen) - pad.mean(u))
    return max(float(np.sqrt(np.mean(np.square(np.concatenate(off))))), LEAST_M)
