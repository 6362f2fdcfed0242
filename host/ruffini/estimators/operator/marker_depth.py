"""Depth from the markers' motion alone, for boards without side light: the `marker_depth` kind of a calibration file.

A camera that looks straight at a pad sees, of the displacement u of a place X,

    d = H (X + u_xy) / (H + u_z) - X  ~  u_xy - X u_z / H,

H its distance. A layer bonded at its back and nearly incompressible spreads where it is pressed, so d tells of u_z
twice: by that spreading, and by perspective. Which of the two a motion is cannot be told at one place, but over the
whole pad only touches make it. So the estimate is the best linear one over simulated touches,

    u_z = D d,   D = E[u_z d^T] (E[d d^T] + R)^-1,

R the noise of the markers as the nodes see it. There is no free constant in it: the gauge is the places that did not
move. A dent that is sharp against the pad's thickness spreads next to nothing and is taken for shallower than it is;
how far off D is gets measured on other touches and goes to the operator as the noise of its depth, larger by what real
contacts err more than simulated touches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.linalg as la
from scipy.interpolate import make_interp_spline

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.operator.marker_lattice import NodesOnLattice, marker_places
from ruffini.fem.operators import Noise
from ruffini.fem.slab import Slab
from ruffini.fem.touches import MaterialSpread, TouchMaker

Array = npt.NDArray[np.float64]

N_TOUCHES, BATCH = 1000, 50  # drawn to fit, four times as many with their mirror images
N_JUDGED = 240  # drawn to say how far off it is
SEED = 40_000
# The twin's contacts (states TUNED and FRESH) are off by this many times what simulated touches are: their edges are
# sharper. `tests/bench/marker_depth.py --development` prints it.
DISCREPANCY = 1.3
LEAST_M = 1e-6  # of any uncertainty: rounding of the displacement and of the markers' places


@dataclass(frozen=True)
class View:
    """How the camera sees the observed nodes by their markers: places (.., 2) from the pad's centre, metres."""

    standoff_m: float
    place_m: Array  # (n_y, n_x, 2) of the observed nodes
    marker_m: Array  # (rows, columns, 2)
    at_markers: tuple[Array, Array]  # along y and x: from all nodes of the pad to the markers
    at_nodes: tuple[Array, Array]  # from the markers to the observed nodes

    @classmethod
    def of(cls, board: Board) -> View:
        """Of a board whose markers are a lattice, where it says they are."""
        if board.markers is None:
            raise InputError(f"board {board.name!r} has no markers to take depth from")
        pad, grid = board.pad, board.grid
        rows, columns = board.observed
        x, y = (np.linspace(-0.5, 0.5, n) * size * 1e-6
                for n, size in ((grid.n_x, pad.size_x_um), (grid.n_y, pad.size_y_um)))  # fmt: skip
        marker_x, marker_y = marker_places(board, board.markers)
        lattice = NodesOnLattice(board, board.markers)
        return cls(
            board.camera.standoff_um * 1e-6,
            np.stack(np.meshgrid(x[columns], y[rows]), axis=-1),
            np.stack(np.meshgrid(marker_x, marker_y), axis=-1),
            (_spline(y, marker_y), _spline(x, marker_x)),
            (lattice.y[rows], lattice.x[columns]),
        )

    def seen(self, u: Array, white_m: Array | None = None) -> Array:
        """d at the observed nodes (k, n_y, n_x, 2) of displacements of the whole pad (k, rows, columns, 3), metres.

        `white_m` is added to what each marker shows.
        """
        marker = np.einsum("aj,bi,kjic->kabc", *self.at_markers, u, optimize=True)
        moved = self._projected(self.marker_m, marker)
        if white_m is not None:
            moved = moved + white_m
        return np.asarray(np.einsum("aj,bi,kjic->kabc", *self.at_nodes, moved, optimize=True))

    def noise_covariance(self, sigma_m: tuple[float, float, float]) -> Array:
        """R of white noise at the markers, of d at the observed nodes, x and y interleaved."""
        weights = np.kron(*self.at_nodes)
        n = len(weights)
        spread = np.zeros((n, 2, n, 2))
        for axis in range(2):
            spread[:, axis, :, axis] = weights @ weights.T * sigma_m[axis] ** 2 + np.eye(n) * LEAST_M**2
        return spread.reshape(2 * n, 2 * n)

    def _projected(self, place_m: Array, u: Array) -> Array:
        return np.asarray(self.standoff_m * (place_m + u[..., :2]) / (self.standoff_m + u[..., 2:]) - place_m)


@dataclass(frozen=True)
class MarkerDepth:
    """`matrix` D (nodes, 2 nodes) without unit, of the observed nodes, and how far off it is on other touches.

    `white_m`: noise of the markers along x and y. `sigma_m`: root mean square where something presses, DISCREPANCY
    times that of simulated touches; `gauge_m`: of the mean over all nodes; `pressed_m`: of the true u_z where something
    presses, to hold the first against.
    """

    matrix: Array
    view: View
    white_m: tuple[float, float]
    sigma_m: float
    gauge_m: float
    pressed_m: float

    def observe(self, u: Array, rng: np.random.Generator) -> Array:
        """The observed nodes' displacement that the board would find of one of the whole pad (n_y, n_x, 3), metres."""
        white = rng.normal(size=self.view.marker_m.shape) * self.white_m
        return self.displacement(self.view.seen(u[None], white)[0])

    def noise(self, noise: Noise) -> Noise:
        """The operator's noise with this depth in the place of one from light."""
        x_m, y_m, _ = noise.sigma_m
        return replace(noise, sigma_m=(x_m, y_m, self.sigma_m), gauge_m=self.gauge_m)

    def displacement(self, seen: Array) -> Array:
        """The whole displacement (n_y, n_x, 3) of what the nodes saw with u_z = 0 (n_y, n_x, 2), metres."""
        uz = (self.matrix @ seen.ravel()).reshape(seen.shape[:2])
        sideways = seen + (self.view.place_m + seen) * uz[..., None] / self.view.standoff_m
        return np.concatenate([sideways, uz[..., None]], axis=-1)


def fit_marker_depth(board: Board, slab: Slab, noise: Noise) -> MarkerDepth:
    """D for one board and pad, and how far off it is on touches of pads that are not quite this one.

    Parameters
    ----------
    noise : Noise
        Of the markers: `sigma_m` along x and y counts.

    Raises
    ------
    InputError
        The board's markers are no lattice, or no touch presses beyond the contact threshold.
    """
    view, maker = View.of(board), TouchMaker(slab, SEED)
    rows, columns = board.observed
    square = view.noise_covariance(noise.sigma_m)
    cross = np.zeros((len(square) // 2, len(square)))
    for _ in range(N_TOUCHES // BATCH):
        u = with_mirror_images(np.array([maker.draw().displacement for _ in range(BATCH)]))
        seen, depth = view.seen(u).reshape(len(u), -1), u[:, rows, columns, 2].reshape(len(u), -1)
        cross += depth.T @ seen / (4 * N_TOUCHES)
        square += seen.T @ seen / (4 * N_TOUCHES)
    matrix = np.asarray(la.solve(square, cross.T, assume_a="pos").T)
    return _judged(board, slab, MarkerDepth(matrix, view, noise.sigma_m[:2], 0.0, 0.0, 0.0))


def _judged(board: Board, slab: Slab, depth: MarkerDepth) -> MarkerDepth:
    """With what touches of pads off by the material's spread say of it."""
    rng, threshold_n = np.random.default_rng(SEED), board.contact.threshold_un * 1e-6
    off, mean, pressed = [], [], []
    pads = MaterialSpread().pads(slab)
    for i, pad in enumerate(pads):
        maker = TouchMaker(pad, SEED + 1 + i)
        for _ in range(N_JUDGED // len(pads)):
            touch = maker.draw()
            found = depth.observe(touch.displacement, rng)[..., 2]
            true = touch.displacement[board.observed][..., 2]
            is_pressed = touch.force[board.observed][..., 2] < -threshold_n
            off.append((found - true)[is_pressed])
            pressed.append(true[is_pressed])
            mean.append((found - true).mean())
    if not sum(len(o) for o in off):
        raise InputError(
            "depth from markers: no simulated touch presses beyond [contact] threshold_un: is it far from this pad's "
            "forces?"
        )
    parts = (np.concatenate(off), np.array(mean), np.concatenate(pressed))
    sigma, gauge, size = (max(float(np.sqrt(np.mean(part**2))), LEAST_M) for part in parts)
    return replace(depth, sigma_m=DISCREPANCY * sigma, gauge_m=gauge, pressed_m=size)


def with_mirror_images(u: Array) -> Array:
    """Displacements (k, n_y, n_x, 3) and their images under x -> -x, y -> -y and both: the pad's own symmetry."""
    along_x = u[:, :, ::-1] * [-1, 1, 1]
    both = np.concatenate([u, along_x])
    return np.concatenate([both, both[:, ::-1] * [1, -1, 1]])


def _spline(nodes: Array, at: Array) -> Array:
    """Weights (at, nodes) of a cubic spline through values at the nodes."""
    order = min(3, len(nodes) - 1)
    return np.asarray(make_interp_spline(nodes, np.eye(len(nodes)), k=order)(at))
